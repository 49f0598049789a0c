"""Packings off the grid: items, containers, poses, validity, and their files."""
