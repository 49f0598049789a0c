"""Lengths with units as text, such as "300x200x150mm"."""

from __future__ import annotations

import re

from packit_sim.core.checks import shown
from packit_sim.core.errors import ArgumentError
from packit_sim.core.length_units import UNITS_CM, Unit, check_unit
from packit_sim.parts.packings.bounds import DISTANCES

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"

_LENGTHS = re.compile(rf"({_NUMBER}(?:\s*[xX*]\s*{_NUMBER})*)\s*([a-zA-Zµ\"']*)")


def factor(unit: Unit, other: Unit) -> float:
    """Return the length of a unit in another one; 1 exactly for the same unit."""
    return 1.0 if unit == other else UNITS_CM[unit] / UNITS_CM[other]


def lengths(text: str, count: int, unit: Unit, plain: Unit | None = None) -> tuple[float, ...]:
    """Read lengths.

    Parameters
    ----------
    text : str
        Such as "300x200x150mm" or "1"; a unit after the last number is that of all.
    count : int
        How many lengths there must be.
    unit : str
        The unit of the result.
    plain : str, optional
        The unit of a text without one; by default that of the result.

    Returns
    -------
    tuple of float
        The lengths.

    Raises
    ------
    ArgumentError
        If the text is something else, its unit is not known, or a length is out of bounds.
    """
    match = _LENGTHS.fullmatch(text.strip())
    numbers = re.split(r"\s*[xX*]\s*", match[1]) if match else []
    if match is None or len(numbers) != count:
        example = {1: "1mm", 2: "220x300mm"}.get(count, "300x200x150mm")
        what = f"{count} lengths" if count > 1 else "a length"
        raise ArgumentError(f"{shown(text)} is not {what} with a unit, such as {example}")
    own = check_unit(match[2]) if match[2] else plain or unit
    found = tuple(float(number) * factor(own, unit) for number in numbers)
    if not all(abs(each) in DISTANCES for each in found):
        raise ArgumentError(f"{shown(text)} is not possible: lengths are {DISTANCES} {unit}")
    return found


def unit_of(text: str) -> Unit | None:
    """Return the unit at the end of a length, if there is a known one."""
    name = re.split(r"[\d.\s]", text.partition("=")[0].strip())[-1]
    return next((unit for unit in UNITS_CM if unit == name), None)
