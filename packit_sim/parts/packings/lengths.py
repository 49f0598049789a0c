"""The lengths and poses that files of packings off the grid may have, in any unit."""

from typing import Annotated

from msgspec import Meta

from packit_sim.core.checks import Range

MAX_LENGTH = 1e30
"""Largest length."""

MIN_LENGTH = 1e-30
"""Smallest length of a side."""

LENGTHS = Range(MIN_LENGTH, MAX_LENGTH)
"""All lengths of sides and meshes."""

Extent = Annotated[float, Meta(gt=MIN_LENGTH, lt=MAX_LENGTH)]
"""A side's length in a file."""

_Cell = Annotated[float, Meta(gt=-MAX_LENGTH, lt=MAX_LENGTH)]
_Row = tuple[_Cell, _Cell, _Cell, _Cell]

PoseRows = tuple[_Row, _Row, _Row, _Row]
"""A (4, 4) matrix in a file, row by row."""
