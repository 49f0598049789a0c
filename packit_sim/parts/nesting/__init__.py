"""The nester: the search for dense packings off the grid, and its kernels."""
