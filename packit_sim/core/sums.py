"""Sums of floats that are the same on every Python."""

from __future__ import annotations

from collections.abc import Iterable


def plain_sum(values: Iterable[float]) -> float:
    """Add floats from left to right; since Python 3.12, `sum` compensates for rounding.

    Parameters
    ----------
    values : iterable of float
        The terms.

    Returns
    -------
    float
        Their sum, rounded after each term; 0.0 if there is none.
    """
    total = 0.0
    for value in values:
        total += value
    return total
