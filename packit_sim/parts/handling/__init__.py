"""Handling of packings: removal, supports, stability, and constraints on all of them."""
