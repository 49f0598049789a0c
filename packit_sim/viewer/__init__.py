"""A web page that shows a box."""
