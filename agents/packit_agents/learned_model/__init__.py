"""A learned model of the game, and searches in it."""
