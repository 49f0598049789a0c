"""Balancing: items slide until their centre of gravity is near the middle of the box."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.settling_kernels import slide
from packit_sim.parts.nesting.tasks import Poses, SearchTask

_AIM = 0.98
"""Share of the largest distance from the middle that items slide to: rounding breaks no limit."""

_SLIDES = 4
"""Times that all items slide."""

_LEAST_STEP = 0.05
"""Smallest step of an item, in voxels."""


def balanced(problem: Problem, task: SearchTask, poses: Poses, boxes: Floats) -> Poses:
    """Slide items along x and y until their centre of gravity is as near the middle as it must be.

    At first no item slides farther than all of them would have to: where there is free space at the
    walls, the packing moves as a whole.

    Parameters
    ----------
    poses : Poses
        The items' poses, without conflicts.
    boxes : ndarray of float64, shape (1, 4)
        The box.

    Returns
    -------
    Poses
        The poses, without conflicts; their centre may still be too far off.
    """
    balance = task.balance
    if balance is None or balance.is_kept(poses):
        return poses
    state = loaded(problem, task, poses, boxes)
    items = balance.inside(poses)
    weights = balance.weights[items]
    for number in range(_SLIDES):
        for axis in range(2):
            now = Poses.of(state)
            off, most = balance.off(now)[axis], balance.reach[axis]
            if abs(off) <= most:
                continue
            wanted = -math.copysign(abs(off) - _AIM * most, off)
            ahead = balance.centres(now, items)[:, axis] * math.copysign(1, wanted)
            order = items[np.argsort(-ahead, kind="stable")]
            farthest = abs(wanted) if number == 0 else math.inf
            moment = wanted * float(weights.sum())
            least = _LEAST_STEP * problem.lookup.voxel
            slide(problem, state, boxes, order, axis, balance.weights, moment, farthest, least)
        if balance.is_kept(now := Poses.of(state)):
            return now
    return Poses.of(state)
