"""Powder beds of printers: how much powder a build takes, and how much of it is fresh."""

from __future__ import annotations

import re
from dataclasses import dataclass

from packit_sim.core.checks import Range, check_range, shown
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.packings.bounds import DENSITIES

_POWDER = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(?:g/cm3|g/cm³)?:(\d+(?:\.\d*)?|\.\d+)\s*%")


@dataclass(frozen=True)
class Powder:
    """A powder, and how much of it is replaced.

    Parameters
    ----------
    density : float
        The density of the loose powder in the bed, in g/cm3.
    refresh : float
        The share of fresh powder in what a build takes, above 0 and up to 1.

    Raises
    ------
    ArgumentError
        If a number is not possible.

    Examples
    --------
    >>> from packit_sim import Powder
    >>> powder = Powder(density=0.5, refresh=0.2)
    >>> powder.text(bed=1000.0, parts=100.0, mass=100.0)  # in cm3, and in grams
    '550 g, 18.18% of it parts; 110 g fresh at 20%'
    """

    density: float
    refresh: float

    def __post_init__(self) -> None:
        check_range("the powder's density", self.density, DENSITIES, "g/cm3")
        check_range("the powder's refresh rate", self.refresh, Range(0, 1, "(]"))

    def text(self, bed: float, parts: float, mass: float) -> str:
        """Return how much powder a build takes, in grams.

        Parameters
        ----------
        bed : float
            The volume of the bed up to the highest part, in cm3.
        parts : float
            The volume of the parts in it, in cm3.
        mass : float
            Their mass in grams.

        Returns
        -------
        str
            The mass of the powder, with that which becomes parts; the share of the latter; and the
            mass of fresh powder.
        """
        total = (bed - parts) * self.density + mass
        share = 100 * mass / total if total > 0 else 0.0
        fresh = self.refresh * total
        return (
            f"{total:.4g} g, {share:.4g}% of it parts; {fresh:.4g} g fresh at "
            f"{100 * self.refresh:.4g}%"
        )


def read_powder(text: str) -> Powder:
    """Read a powder, such as "0.45:20%": its density in g/cm3, and the refresh rate.

    Returns
    -------
    Powder
        The powder.

    Raises
    ------
    ArgumentError
        If the text is something else.
    """
    match = _POWDER.fullmatch(text.strip())
    if match is None:
        raise ArgumentError(
            f"{shown(text)} is not a powder's density in g/cm3 and its refresh rate, such as "
            "0.45:20%"
        )
    return Powder(float(match[1]), float(match[2]) / 100)
