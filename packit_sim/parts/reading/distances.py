"""Distances from walls as text, such as "2mm", or "sides=5mm,floor=2mm,top=0"."""

from __future__ import annotations

from packit_sim.core.checks import shown
from packit_sim.core.errors import ArgumentError
from packit_sim.core.length_units import Unit
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.reading.units import lengths

_WALLS = ("sides", "floor", "top")


def read_wall_clearance(text: str, unit: Unit) -> float | WallClearance:
    """Read the distance from all walls, or those from some; the others are 0.

    Parameters
    ----------
    text : str
        A length, or lengths with the names of walls.
    unit : str
        The unit of the result, and of numbers without one.

    Returns
    -------
    float or WallClearance
        The distances.

    Raises
    ------
    ArgumentError
        If the text is something else.
    """
    if "=" not in text:
        return lengths(text, 1, unit)[0]
    found: dict[str, float] = {}
    for each in text.split(","):
        name, _, length = (part.strip() for part in each.partition("="))
        if name not in _WALLS or name in found:
            raise ArgumentError(
                f"wall clearance {shown(text)}: {shown(name)} is not possible: each of "
                f"{', '.join(_WALLS)} once, as in sides=5mm,floor=2mm"
            )
        found[name] = lengths(length, 1, unit)[0]
    return WallClearance(**found)
