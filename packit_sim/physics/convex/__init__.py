"""Shapes as convex pieces, as a physics engine needs them."""
