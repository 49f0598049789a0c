"""The version of the package, and the address of its documentation."""

__version__ = "0.1.0"

DOCUMENTATION = "https://packit-sim.readthedocs.io"
"""The same as `project.urls` in the metadata."""
