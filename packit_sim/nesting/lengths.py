"""The lengths that packings off the grid may have, in any unit."""

from packit_sim.core.checks import Range

MAX_LENGTH = 1e30
"""Largest length."""

MIN_LENGTH = 1e-30
"""Smallest length of a side."""

LENGTHS = Range(MIN_LENGTH, MAX_LENGTH)
"""All lengths of sides and meshes."""
