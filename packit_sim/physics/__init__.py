"""Shapes as convex pieces, and what becomes of a pack that is let go: gravity, contacts, rest."""
