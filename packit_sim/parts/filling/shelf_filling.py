"""Boxes filled by shelves: packings that are found at once, as far as they are valid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from packit_sim.parts.filling.balance import centred
from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.bounds import SUM_ROUNDING
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.boxes import BoxType


def shelved_boxes(
    nesting: BoxNesting, boxes: Sequence[BoxType], counts: Mapping[int, int]
) -> list[Packing]:
    """Fill box after box, in an order of types.

    Parameters
    ----------
    counts : mapping of int to int
        How many of each part of the task.

    Returns
    -------
    list of Packing
        The packing of each box.
    """
    left = dict(counts)
    found: list[Packing] = []
    for box in boxes:
        stock = math.inf if box.count is None else box.count
        while left and stock > 0:
            packing = shelved_box(nesting, box, left)
            if packing is None:
                break
            found.append(packing)
            stock -= 1
            for n, k in Counter(one.type for one in packing.placements).items():
                left[n] -= k
            left = {n: k for n, k in left.items() if k > 0}
    return found


def shelved_box(nesting: BoxNesting, box: BoxType, counts: Mapping[int, int]) -> Packing | None:
    """Fill a box, if nothing else is in it; return None if that is not valid."""
    if nesting.bodies(box):
        return None
    task = nesting.task
    placements = nesting.shelves(box).fill(allowed(task, box, counts))
    packing = centred(task, task.packing(task.container(box), placements))
    return None if not placements or packing.problems() else packing


def allowed(task: PackTask, box: BoxType, counts: Mapping[int, int]) -> dict[int, int]:
    """Return how many of each part the limits of a box allow, the most valuable first."""
    numbers = list(counts)
    sums = box.limits.sums([task.parts[n].mass for n in numbers])
    if not sums:
        return dict(counts)
    shares = np.array([np.array(own) / most for own, most in sums])
    values = np.array([task.weights[n] for n in numbers])
    left, found = np.full(len(sums), 1 + SUM_ROUNDING), {}
    for k in np.argsort(-values / shares.max(axis=0), kind="stable").tolist():
        copies = int(min(counts[numbers[k]], *(left // np.maximum(shares[:, k], 1e-15))))
        left -= copies * shares[:, k]
        if copies:
            found[numbers[k]] = copies
    return found
