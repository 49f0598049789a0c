"""Results of packing parts: checks, exports, pages, instructions, films."""
