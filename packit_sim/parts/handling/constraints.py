"""Constraints of packings: each better packing of the search is checked, and parts are taken out.

A constraint looks at one box. It says which items to take out so that the others fulfil it; the
items that remain are checked again until nothing is taken out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from packit_sim.parts.packings.packing import Packing


class Constraint(Protocol):
    """What a packing must fulfil in addition to being valid."""

    def taken_out(self, packing: Packing) -> Mapping[int, str]:
        """Choose the items to take out.

        Parameters
        ----------
        packing : Packing
            The items in one box, in its coordinates. The types are those of all parts, by name.

        Returns
        -------
        mapping of int to str
            The reason for each item to take out, by the number of its placement; empty if the
            packing fulfils the constraint.
        """


def filtered(
    packing: Packing, constraints: Sequence[Constraint]
) -> tuple[Packing, tuple[tuple[int, str], ...]]:
    """Take items out of a packing until it fulfils all constraints.

    Parameters
    ----------
    packing : Packing
        The items in one box.
    constraints : sequence of Constraint
        The constraints.

    Returns
    -------
    packing : Packing
        The items that remain.
    dropped : tuple of (int, str)
        The type and the reason of each item that was taken out.
    """
    dropped: list[tuple[int, str]] = []
    while True:
        reasons: dict[int, str] = {}
        for constraint in constraints:
            reasons = dict(constraint.taken_out(packing))
            if reasons:
                break
        if not reasons:
            return packing, tuple(dropped)
        dropped += [(packing.placements[n].type, why) for n, why in sorted(reasons.items())]
        kept = [one for n, one in enumerate(packing.placements) if n not in reasons]
        packing = replace(packing, placements=tuple(kept))
