"""Boxes on a local web page: one that follows as it fills, and datasets and results to explore."""
