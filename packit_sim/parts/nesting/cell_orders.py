"""The orders in which items as cells are placed: each is a list of numbers of items.

What decides is the volume of an item's convex hull: an item of thin walls takes more space than its
own volume, since what is inside can hardly be used.
"""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.tasks import SearchTask

SHORTEST = 1.5
"""How hard an item is to place: its hull's volume times this power of its shortest side."""

TAKEN = 0.4
"""Power of an item's hull volume that stands for the space it takes of a box; it is less than 1,
since large items find no place later."""

CROWDED = 0.75
"""Volume of all items, as a share of the box's, from which on that decides: many stay outside."""


def hardest_first(problem: Problem, task: SearchTask, change: Floats | float = 0.0) -> Ints:
    """Sort large and thick items first, for a container that has to hold all of them.

    Parameters
    ----------
    change : ndarray of float64, shape (n,), optional
        Subtracted from the logarithms of the sizes that are compared.

    Returns
    -------
    ndarray of int64
        The order.
    """
    own = task.numbers[: task.count]
    boxes = problem.lookup.boxes[own, problem.allowed[own, 0]]
    shortest = (boxes[:, 3:] - boxes[:, :3]).min(axis=1)
    sizes = np.log(problem.hulls[own]) + SHORTEST * np.log(shortest)
    return np.argsort(change - sizes, kind="stable")


def most_valuable_first(problem: Problem, task: SearchTask) -> Ints:
    """Return the order in which those items come first that are worth most for what they take.

    This is the order of the task where limits may run out before the space does, and where most
    items fit.
    """
    if task.limits.count or task.volumes.sum() < CROWDED * math.prod(task.size):
        return task.order
    own = task.numbers[: task.count]
    return task.order_by(problem.hulls[own] ** TAKEN)
