"""Parts of a packing that are moved by hand, and what they are in conflict with then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from packit_sim.core.errors import ArgumentError
from packit_sim.core.progress import Progress
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.candidates import candidate, in_order
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.validity import pair_problems
from packit_sim.parts.results.check import check
from packit_sim.parts.results.resuming import ROUNDING, RecordedItem, placed_items

MAX_MOVES = 500
"""Most parts that are moved at a time."""

_Shift = Annotated[float, Meta(ge=-1e9, le=1e9)]

_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class Move(Struct, forbid_unknown_fields=True):
    """A part that is moved: turned about the vertical line through its item's middle, then shifted.

    Attributes
    ----------
    part : int
        The number of its placement in its box.
    shift : tuple of float
        The shift (3,) in the task's unit.
    turns : int
        The number of quarter turns.
    """

    part: Annotated[int, Meta(ge=0)]
    shift: tuple[_Shift, _Shift, _Shift]
    turns: Annotated[int, Meta(ge=0, le=3)] = 0


@dataclass(frozen=True)
class Conflict:
    """Why some parts can't be where they are.

    Attributes
    ----------
    parts : tuple of int
        The numbers of their placements; empty if a rule of all parts is broken.
    """

    parts: tuple[int, ...]
    text: str

    def to_json(self) -> dict[str, Any]:
        """Return it in JSON's types."""
        return {"parts": list(self.parts), "text": self.text}


@dataclass(frozen=True, eq=False)
class MovedParts:
    """A packing of which parts were moved by hand.

    Attributes
    ----------
    packed : PackedParts
        The packing, which may not be valid.
    box : int
        The number of the box of the moved parts.
    numbers : tuple of int
        The numbers of their placements.
    faults : tuple of Conflict
        The parts that can't be where they are, whatever others do.
    """

    packed: PackedParts
    box: int
    numbers: tuple[int, ...]
    faults: tuple[Conflict, ...]

    @classmethod
    def of(cls, packed: PackedParts, box: int, moves: Sequence[Move]) -> MovedParts:
        """Move parts.

        Parameters
        ----------
        box : int
            The number of their box.

        Returns
        -------
        MovedParts
            The packing then.

        Raises
        ------
        ArgumentError
            If there is no such box or part, or a part is moved twice.
        """
        numbers = tuple(move.part for move in moves)
        count = len(packed.packings[box].placements) if 0 <= box < len(packed.packings) else 0
        if not numbers or len(set(numbers)) < len(numbers) or max(numbers) >= count:
            raise ArgumentError(f"there are no such parts to move in box {box}")
        packing = packed.packings[box]
        placements, faults = list(packing.placements), []
        for move in moves:
            placed, fault = _moved(packed, box, move)
            placements[move.part] = placed
            if fault:
                name = packed.part(placed).part.name
                faults.append(Conflict((move.part,), f"{name}: {fault}"))
        own = replace(packing, placements=tuple(placements))
        packings = (*packed.packings[:box], own, *packed.packings[box + 1 :])
        moved = replace(packed, packings=packings, rejected=())
        return cls(moved, box, numbers, tuple(faults))

    def conflicts(self) -> Iterator[Conflict]:
        """Yield the conflicts of the moved parts, decided by the meshes."""
        yield from self.faults
        task, packing = self.packed.task, self.packed.packings[self.box]
        unit, obstacles = packing.container.longest, packing.container.obstacles
        first = len(obstacles)
        around = [CheckedItem(each.name, each, Placement(0), unit) for each in obstacles]
        items = [
            *around,
            *(
                CheckedItem(
                    self.packed.part(one).part.name,
                    packing.types[one.type],
                    one,
                    unit,
                    task.unit,
                )
                for one in packing.placements
            ),
        ]
        low, high = (np.array([getattr(one, end) for one in items]) for end in ("low", "high"))
        done: set[int] = set()
        for number in self.numbers:
            n = first + number
            gaps = np.maximum(low, low[n]) - np.minimum(high, high[n])
            gaps *= (1, 1, task.stretch)
            near = np.flatnonzero((gaps <= task.largest_gap).all(axis=1)).tolist()
            for m in near:
                if m == n or m in done:
                    continue
                problems = pair_problems(
                    items[m], items[n], task.gap, ROUNDING * unit, task.stretch
                )
                for text in problems:
                    parts = (number,) if m < first else (number, m - first)
                    yield Conflict(parts, text)
            done.add(n)

    def accepted(
        self, locked: Sequence[int], progress: Progress
    ) -> tuple[PackedParts, tuple[int, ...]]:
        """Return the packing in an order of packing, if it is valid and meets all constraints.

        Parameters
        ----------
        locked : sequence of int
            The numbers of other parts that stay where they are.
        progress : callable
            Called with each step of the check.

        Returns
        -------
        packed : PackedParts
            The packing.
        stay : tuple of int
            The numbers of the moved and the locked parts in it.

        Raises
        ------
        ArgumentError
            If it is not valid, by the meshes or by the check of the files, or breaks a constraint.
        """
        if found := next(self.conflicts(), None):
            raise ArgumentError(found.text)
        task = self.packed.task
        whole = candidate(task, self.packed.packings, self.packed.searches)
        if whole.rejected:
            number, reason = whole.rejected[0]
            raise ArgumentError(f"{task.parts[number].part.name}: {reason}")
        if problems := check(whole, progress).problems:
            raise ArgumentError(problems[0])
        before = self.packed.packings[self.box].placements
        keys = {_key(before[n]) for n in (*self.numbers, *locked)}

        def staying(packed: PackedParts) -> tuple[int, ...]:
            placements = packed.packings[self.box].placements
            return tuple(n for n, one in enumerate(placements) if _key(one) in keys)

        ordered = in_order(whole)
        if len(staying(ordered)) == len(keys):
            return ordered, staying(ordered)
        return whole, staying(whole)  # gravity would move parts that were put there by hand


def _moved(packed: PackedParts, box: int, move: Move) -> tuple[Placement, str]:
    """Return the placement of a moved part, and why it is not possible, if so."""
    packing = packed.packings[box]
    before = packing.placements[move.part]
    middle = before.apply(packing.types[before.type].middle)
    turn = np.linalg.matrix_power(_QUARTER, move.turns)
    place = turn @ (before.pose.translation - middle) + middle + np.array(move.shift)
    after = replace(before, pose=Motion(turn @ before.pose.rotation, place))
    item = RecordedItem(packed.part(after).part.name, 0, packed.pose(after).tolist())
    ((placed,), faults) = placed_items(packed.task, [item], [packing.container.name])
    if placed:
        return placed[0], ""
    fault = faults[0][1]
    return after, "it may not be turned like this" if fault.startswith("its rotation") else fault


def _key(one: Placement) -> tuple[int, bytes]:
    return one.type, np.round(one.matrix, 9).tobytes()
