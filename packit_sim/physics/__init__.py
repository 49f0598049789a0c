"""Convex pieces of shapes, and the simulation of packs under gravity until they rest."""
