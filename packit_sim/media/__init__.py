"""What is made of scenes: contact sheets, films, exported files."""
