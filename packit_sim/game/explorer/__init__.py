"""The interactive page on which datasets and results are explored."""
