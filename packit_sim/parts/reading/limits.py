"""Limits on the parts in one box: their mass, their number, and their centre of gravity."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from packit_sim.core.checks import Range, as_integer, check_range, shown
from packit_sim.core.errors import ArgumentError, about
from packit_sim.parts.packings.bounds import COUNTS, MASSES, SUM_ROUNDING

GRAMS: Mapping[str, float] = {"g": 1.0, "kg": 1e3, "t": 1e6, "oz": 28.349523125, "lb": 453.59237}
"""Grams in each unit of mass."""

SHARES = Range(0.001, 0.5)
"""Shares of a side from near the middle to a wall."""

_SHARE = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*%")

_MASS = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]+)")


@dataclass(frozen=True)
class Limits:
    """Limits on the parts in one box, without those that are fixed in it.

    Parameters
    ----------
    max_mass : float, optional
        The largest mass of all of them, in grams.
    max_parts : int, optional
        The largest number of parts.
    balance : float, optional
        The largest distance of their centre of gravity from the middle of the box along x and
        along y, as shares of the sides of the container's bounding box: up to 0.5, its walls. The
        centre is that of masses, or of volumes if no part has a mass.

    Raises
    ------
    ArgumentError
        If a limit is not possible.

    Examples
    --------
    >>> from packit_sim import Limits
    >>> Limits(max_mass=20_000, max_parts=12)
    Limits(max_mass=20000, max_parts=12, balance=None)
    """

    max_mass: float | None = None
    max_parts: int | None = None
    balance: float | None = None

    def __post_init__(self) -> None:
        if self.max_mass is not None:
            check_range("max_mass", self.max_mass, MASSES)
        if self.max_parts is not None:
            check_range("max_parts", as_integer("max_parts", self.max_parts), COUNTS)
        if self.balance is not None:
            check_range("balance", self.balance, SHARES)

    @property
    def is_empty(self) -> bool:
        """True if there are none."""
        return self == NO_LIMITS

    def over(self, others: Limits) -> Limits:
        """Return these limits, and those of others that these do not have."""
        return Limits(
            others.max_mass if self.max_mass is None else self.max_mass,
            others.max_parts if self.max_parts is None else self.max_parts,
            others.balance if self.balance is None else self.balance,
        )

    def allow(self, mass: float | None) -> bool:
        """Return whether one part of a mass in grams may be in the box."""
        return self.max_mass is None or (mass or 0.0) <= self.max_mass * (1 + SUM_ROUNDING)

    def sums(self, masses: Sequence[float | None]) -> list[tuple[list[float], float]]:
        """Return each limit as one on a sum: the amount of each part, and the largest sum."""
        found = []
        if self.max_mass is not None:
            found.append(([mass or 0.0 for mass in masses], float(self.max_mass)))
        if self.max_parts is not None:
            found.append(([1.0] * len(masses), float(self.max_parts)))
        return found

    def text(self, masses: Sequence[float | None], off: Sequence[float]) -> str:
        """Return how far parts reach the limits.

        Parameters
        ----------
        masses : sequence of float or None
            Their grams.
        off : sequence of float
            Their centre of gravity along x and y (see `balance`), above 0 beyond the middle.

        Returns
        -------
        str
            The amounts, each with its limit.
        """
        texts = []
        if self.max_mass is not None:
            total = sum(mass or 0.0 for mass in masses)
            texts.append(f"{total:.5g} of {self.max_mass:.5g} g")
        if self.max_parts is not None:
            texts.append(f"{len(masses)} of {self.max_parts} parts")
        if self.balance is not None:
            x, y = (abs(100 * each) for each in off)
            texts.append(f"{x:.5g}% and {y:.5g}% of {100 * self.balance:.5g}% off the middle")
        return ", ".join(texts)

    def faults(self, masses: Sequence[float | None]) -> list[str]:
        """Return how parts of some masses in grams break the limits on sums."""
        found = []
        total = sum(mass or 0.0 for mass in masses)
        if not self.allow(total):
            found.append(f"holds {total:.5g} g: at most {self.max_mass:.5g} g")
        if self.max_parts is not None and len(masses) > self.max_parts:
            found.append(f"holds {len(masses)} parts: at most {self.max_parts}")
        return found

    def beyond(self, off: Sequence[float]) -> float:
        """Return by how much a centre of gravity (see `text`) is too far off; 0 if it is not."""
        if self.balance is None:
            return 0.0
        over = max(map(abs, off)) - self.balance
        return over if over > SUM_ROUNDING else 0.0


NO_LIMITS = Limits()


def grams(text: str) -> float:
    """Read a mass, such as "20kg".

    Returns
    -------
    float
        The mass in grams.

    Raises
    ------
    ArgumentError
        If the text is something else, or has no unit.
    """
    match = _MASS.fullmatch(text.strip())
    if match is None or match[2] not in GRAMS:
        raise ArgumentError(
            f"{shown(text)} is not a mass with a unit, such as 20kg: choose from {', '.join(GRAMS)}"
        )
    return float(match[1]) * GRAMS[match[2]]


def read_limits(
    max_mass: Iterable[str], max_parts: Iterable[str], balance: Iterable[str] = ()
) -> dict[str, Limits]:
    """Read limits from texts, such as "20kg", or "A:20kg" for the boxes named A.

    Returns
    -------
    dict of str to Limits
        The limits by the name of the boxes; those of all others by the name "".

    Raises
    ------
    ArgumentError
        If a text is not a limit, or a box has two of one kind.
    """
    found: dict[str, Limits] = {}
    readers = {"max-mass": _mass, "max-parts": _parts, "balance": _balance}
    for (option, read), texts in zip(readers.items(), (max_mass, max_parts, balance), strict=True):
        known = set()
        with about(option.replace("-", "_")):
            for text in texts:
                name, _, limit = text.rpartition(":")
                if name in known:
                    what = "there are two limits for these boxes"
                    raise ArgumentError(f"{option} {shown(text)}: {what}")
                known.add(name)
                found[name] = read(limit).over(found.get(name, Limits()))
    return found


def _mass(text: str) -> Limits:
    return Limits(max_mass=grams(text))


def _parts(text: str) -> Limits:
    if not re.fullmatch(r"\d{1,30}", text.strip()):
        raise ArgumentError(f"{shown(text)} is not a number of parts, such as 12")
    return Limits(max_parts=int(text))


def _balance(text: str) -> Limits:
    match = _SHARE.fullmatch(text.strip())
    if match is None:
        raise ArgumentError(f"{shown(text)} is not a share of a side, such as 10%")
    return Limits(balance=float(match[1]) / 100)
