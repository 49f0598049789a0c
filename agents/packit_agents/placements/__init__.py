"""Choosing among placements: of all shapes, in all rotations, at all locations at once."""
