"""Shapes, their voxels, and operations on meshes; nothing about boxes or other items."""
