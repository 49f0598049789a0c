"""Shapes and their voxels, and what is done to meshes: no box, no items side by side."""
