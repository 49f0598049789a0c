"""An interactive web page that shows a box."""
