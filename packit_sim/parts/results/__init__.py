"""Packed parts as results: checks, records, exports, pictures, pages, instructions, films."""
