"""Contact sheets, films and exported files."""
