"""A local web page to pack user-supplied parts."""
