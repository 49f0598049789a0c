"""A local web page on which people pack their own parts."""
