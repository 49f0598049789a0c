"""The numbers that are valid wherever parts, boxes and settings come from.

Command lines, manifests, pages, records and functions of Python have the same bounds.
"""

from typing import Annotated

from msgspec import Meta

from packit_sim.core.checks import Range

MAX_LENGTH = 1e30
"""Largest length, in any unit: volumes of such lengths are finite."""

MIN_LENGTH = 1e-30
"""Smallest length of a side."""

LENGTHS = Range(MIN_LENGTH, MAX_LENGTH)
"""Lengths of sides and meshes."""

DISTANCES = Range(0, MAX_LENGTH)
"""Clearances, and other lengths that may be 0."""

MAX_COUNT = 10_000
"""Most of one part, and most boxes of one size."""

COUNTS = Range(1, MAX_COUNT)

TILTS = Range(0, 180)
"""Degrees."""

PRIORITIES = Range(-1_000_000_000, 1_000_000_000)

VALUES = Range(0, 1e12)

MASSES = Range(1e-9, 1e12)
"""Grams: sums of such masses, and means by them, are precise."""

LOADS = Range(0, 1e12)
"""Grams that may rest on a part."""

AMOUNTS = Range(0, 1e15)
"""Amounts that add up to a limit of a box, such as grams."""

SUM_ROUNDING = 1e-9
"""Relative rounding of sums of amounts that are compared with a limit."""

DENSITIES = Range(1e-9, 1e6)
"""Grams per cubic centimetre."""

SECONDS = Range(0, 1e9, "(]")
"""Times to search: a thread can't wait much longer."""

ITERATIONS = Range(1, 1_000_000_000)

SEEDS = Range(0, 2**63 - 1)

Extent = Annotated[float, Meta(gt=MIN_LENGTH, lt=MAX_LENGTH)]
"""A side's length in a file."""

_Cell = Annotated[float, Meta(gt=-MAX_LENGTH, lt=MAX_LENGTH)]
_Row = tuple[_Cell, _Cell, _Cell, _Cell]

PoseRows = tuple[_Row, _Row, _Row, _Row]
"""A (4, 4) matrix in a file, row by row."""
