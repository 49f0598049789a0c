"""Packings off the grid: meshes with a demand each, at any place of a container."""
