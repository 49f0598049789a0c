"""How pictures look and how they are drawn: cameras, colours, cuts, renderers, plots."""
