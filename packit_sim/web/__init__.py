"""Local web pages: the page server, the viewer of a box, models for pages."""
