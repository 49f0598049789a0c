"""Grids of equal parts, and shelves of several: packings by bounding boxes, found at once.

They are exact: distances are those that the user asked for, without the tolerance that a search
needs, so that parts are packed that fill a box with nothing to spare.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.placements import Placement

_SLACK = 5e-8
"""Rounding of single precision that adds up along a box, relative to its longest side."""

RULES = ("most", "lowest", "highest")
"""How the rotation of each part is chosen: the one of which most fit, or by its height."""


@dataclass(frozen=True)
class _Row:
    """How the copies of a part are turned.

    Attributes
    ----------
    number : int
        The part.
    turn : int
        The number of its rotation.
    sides : tuple of float
        Its sides along row, layer and height.
    """

    number: int
    turn: int
    sides: tuple[float, float, float]


class Shelves:
    """Packings of one box: parts in rows, rows in layers, by their bounding boxes.

    What does not depend on how many of each part there are is computed once, for many equal boxes.

    Parameters
    ----------
    size : sequence of float
        The sides of the box.
    """

    def __init__(self, task: PackTask, size: Sequence[float]) -> None:
        self._task, self._size = task, np.array(size)
        known = [each.sides for each in task.parts]
        counts = [len(each) for each in known]
        self._sides = np.concatenate(known)  # of each part in each rotation
        self._parts = np.repeat(np.arange(len(known)), counts)
        self._turns = np.concatenate([np.arange(count) for count in counts])
        self._known: dict[tuple[tuple[int, ...], str], list[_Row]] = {}

    def fill(self, counts: Mapping[int, int]) -> tuple[Placement, ...]:
        """Put parts into the box.

        Parameters
        ----------
        counts : mapping of int to int
            How many of each part of the task.

        Returns
        -------
        tuple of Placement
            The most valuable of the packings found: with rows and layers along each axis, and parts
            in the rotations of each rule. Equal parts become a grid.
        """
        weights = self._task.weights
        best: tuple[float, list[tuple[_Row, Floats]]] = (0.0, [])
        for axes, rule in product(permutations(range(3)), RULES):
            found = self._places(counts, axes, rule)
            worth = sum(weights[row.number] for row, _ in found)
            if worth > best[0]:
                best = worth, found
            if len(found) == sum(counts.values()):
                break
        return tuple(self._placements(best[1]))

    def _places(
        self, counts: Mapping[int, int], axes: tuple[int, ...], rule: str
    ) -> list[tuple[_Row, Floats]]:
        """Fill rows along the first axis, layers of rows along the second, and then the third."""
        gap_row, gap_layer, gap_height = self._gap(axes)
        limits = self._limits(axes)
        row, layer, height = 0.0, 0.0, 0.0  # where the next part begins along each axis
        deep = high = 0.0  # of this row, and of this layer
        found = []
        for each in self._rows(axes, rule):
            x, y, z = each.sides
            for _ in range(counts.get(each.number, 0)):
                if row + x > limits[0]:
                    row, layer, deep = 0.0, layer + deep + gap_layer, 0.0
                if layer + y > limits[1]:
                    row, layer, height, deep, high = 0.0, 0.0, height + high + gap_height, 0.0, 0.0
                if height + z > limits[2]:
                    break
                place = np.empty(3)
                place[list(axes)] = row, layer, height
                found.append((each, place))
                row, deep, high = row + x + gap_row, max(deep, y), max(high, z)
        return found

    def _rows(self, axes: tuple[int, ...], rule: str) -> list[_Row]:
        """Return how each part that fits is turned, the highest and deepest first."""
        if (axes, rule) not in self._known:
            limits, gap = self._limits(axes), self._gap(axes)
            sides = self._sides[:, list(axes)]
            fits = np.flatnonzero((sides <= limits).all(axis=1))
            own, part = sides[fits], self._parts[fits]
            if rule == "most":
                keys: tuple[Floats, ...] = (-np.floor((limits + gap) / (own + gap)).prod(axis=1),)
            else:
                keys = own[:, 0], own[:, 1], own[:, 2] if rule == "lowest" else -own[:, 2]
            best = np.lexsort((*keys, part))
            best = best[np.unique(part[best], return_index=True)[1]]  # the first of each part
            best = best[np.lexsort((part[best], -own[best, 1], -own[best, 2]))]
            chosen = zip(part[best], self._turns[fits[best]], own[best].tolist(), strict=True)
            self._known[axes, rule] = [
                _Row(int(n), int(k), (x, y, z)) for n, k, (x, y, z) in chosen
            ]
        return self._known[axes, rule]

    def _gap(self, axes: Sequence[int]) -> Floats:
        """Return the distances between parts along the axes."""
        ratios = np.array((1, 1, 1 / self._task.stretch))
        return np.asarray(self._task.largest_gap * ratios[list(axes)])

    def _limits(self, axes: Sequence[int]) -> Floats:
        """Return the lengths of the space for parts along the axes."""
        margin = self._task.margin
        space = self._size - margin.lower - margin.upper + _SLACK * self._size.max()
        return np.asarray(space[list(axes)])

    def _placements(self, found: Sequence[tuple[_Row, Floats]]) -> Iterator[Placement]:
        for row, place in found:
            own = self._task.parts[row.number].item_type
            rotation = Motion(searched_rotations(own)[row.turn], np.zeros(3))
            low = rotation.apply(own.vertices).min(axis=0)
            yield Placement(row.number, rotation.at(place + self._task.margin.lower - low))
