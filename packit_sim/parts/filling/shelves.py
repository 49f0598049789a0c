"""Grids of equal parts, and shelves of several: packings by bounding boxes, found at once.

They are exact: distances are those that the user asked for, without the tolerance that a search
needs, so that parts are packed that fill a box with nothing to spare.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def shelved(
    task: PackTask, counts: Mapping[int, int], size: Sequence[float]
) -> tuple[Placement, ...]:
    """Put parts into rows, rows into layers, and layers into a box, by their bounding boxes.

    Parameters
    ----------
    counts : mapping of int to int
        How many of each part of the task.
    size : sequence of float
        The sides of the box.

    Returns
    -------
    tuple of Placement
        The most valuable of the packings found: with rows and layers along each axis, and parts
        in the rotations of each rule. Equal parts become a grid.
    """
    best: tuple[float, list[Placement]] = (0.0, [])
    for axes, rule in product(permutations(range(3)), RULES):
        found = _placements(task, counts, np.array(size), axes, rule)
        worth = sum(task.weights[one.type] for one in found)
        if worth > best[0]:
            best = worth, found
        if len(found) == sum(counts.values()):
            break
    return tuple(best[1])


def _placements(
    task: PackTask, counts: Mapping[int, int], size: Floats, axes: Sequence[int], rule: str
) -> list[Placement]:
    """Fill rows along the first axis, layers of rows along the second, and then the third."""
    margin, order = task.margin, list(axes)
    gap_row, gap_layer, gap_height = gap = (
        task.largest_gap * np.array((1, 1, 1 / task.stretch))[order]
    )
    limits = (size - margin.lower - margin.upper + _SLACK * size.max())[order]
    chosen = []
    for n in counts:
        sides = task.parts[n].sides[:, order]
        if (fits := np.flatnonzero((sides <= limits).all(axis=1))).size:
            turn = int(fits[_choice(sides[fits], limits, gap, rule)])
            chosen.append((-sides[turn, 2], -sides[turn, 1], n, turn, sides[turn].tolist()))
    row, layer, height = 0.0, 0.0, 0.0  # where the next part begins along each axis
    deep = high = 0.0  # of this row, and of this layer
    placements = []
    for _, _, n, turn, (x, y, z) in sorted(chosen):
        own = task.parts[n].item_type
        rotation = Motion(searched_rotations(own)[turn], np.zeros(3))
        low = rotation.apply(own.vertices).min(axis=0)
        for _ in range(counts[n]):
            if row + x > limits[0]:
                row, layer, deep = 0.0, layer + deep + gap_layer, 0.0
            if layer + y > limits[1]:
                row, layer, height, deep, high = 0.0, 0.0, height + high + gap_height, 0.0, 0.0
            if height + z > limits[2]:
                break
            place = np.empty(3)
            place[order] = row, layer, height
            placements.append(Placement(n, rotation.at(place + margin.lower - low)))
            row, deep, high = row + x + gap_row, max(deep, y), max(high, z)
    return placements


def _choice(sides: Floats, limits: Floats, gap: Floats, rule: str) -> int:
    """Return the number of a rotation, by the sides (m, 3) along row, layer and height."""
    if rule == "most":
        return int(np.floor((limits + gap) / (sides + gap)).prod(axis=1).argmax())
    heights = sides[:, 2] if rule == "lowest" else -sides[:, 2]
    return int(np.lexsort((sides[:, 0], sides[:, 1], heights))[0])
