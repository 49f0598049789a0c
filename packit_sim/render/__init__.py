"""Pictures of boxes: cameras, colours, cuts, renderers, contact sheets, films, mesh exports."""
