"""Units of length, by the names that files and people use."""

from collections.abc import Mapping
from typing import Literal

from packit_sim.core.errors import ArgumentError

Unit = Literal["micron", "mm", "cm", "in", "ft", "m"]

UNITS_CM: Mapping[Unit, float] = {
    "micron": 1e-4,
    "mm": 0.1,
    "cm": 1.0,
    "in": 2.54,
    "ft": 30.48,
    "m": 100.0,
}
"""Centimetres in a unit of length."""


def check_unit(unit: str) -> Unit:
    """Return a unit of length.

    Parameters
    ----------
    unit : str
        Its name.

    Returns
    -------
    str
        The same name.

    Raises
    ------
    ArgumentError
        If there is no such unit.
    """
    for known in UNITS_CM:
        if unit == known:
            return known
    raise ArgumentError(f"unit {unit!r} is not known: choose from {', '.join(UNITS_CM)}")
