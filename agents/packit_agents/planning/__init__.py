"""Searches that play ahead with the model of the environment (paper, section 5, and beyond)."""
