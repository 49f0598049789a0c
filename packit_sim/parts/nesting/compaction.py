"""Moves of all items of a strip at once, by linear programs, where no single item can go down."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_matrix

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.contact_kernels import cutting_planes, first_planes
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.pose_kernels import put
from packit_sim.parts.nesting.problem import Problem, State
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask

REACH, LEAST_REACH = 0.01, 0.003
"""Longest way of an item along an axis, as a share of the base's longer side: at first and last."""

ENOUGH = 1e-3
"""Share of the height by which all moving at once must lower a strip, or ways become shorter."""

STEP = 1e-6
"""Step of differences, as such a share too."""

MARGIN, CELLS_MARGIN = 5e-5, 1e-8
"""Distance that is kept beyond the clearance, as such shares: half of a check's tolerance.

Drawing in a hollow moves its inner surface outwards, by other lengths in a check than here; for
items as cells, the clearance allows for that.
"""

LOW, ASIDE = 0.01, 0.001
"""Weights beside the height: of all items' mean height, and of random directions aside, which make
a solution the only one, so that pairs that are far from a change need no new test."""

CUTS = 16
"""Most linear programs for one move."""

AT_ONCE = 25
"""Pairs that are asked about between two looks at the clock."""

SHAKEN = 3e-4, 2e-2
"""Least and longest way of an item that is shaken, as such shares."""

SHARES = 0.5, 0.25, 0.1
"""Shares of ways that are tried if they lead into conflicts in spite of all planes."""


def compacted(
    problem: Problem,
    task: SearchTask,
    poses: Poses,
    boxes: Floats,
    moves: int,
    budget: SearchBudget | None,
) -> Poses:
    """Return the poses of a strip after moves of all its items at once (see `compact`)."""
    state = loaded(problem, task, poses, boxes)
    compact(problem, task, state, moves, budget)
    return Poses.of(state)


def shaken(
    problem: Problem,
    task: SearchTask,
    poses: Poses,
    boxes: Floats,
    choices: np.random.Generator,
    budget: SearchBudget | None,
) -> Poses:
    """Return the poses of a strip after all its items have moved at once, in random directions.

    It is as high as before, or lower, and other moves may lower it then.
    """
    state = loaded(problem, task, poses, boxes)
    reach = math.exp(choices.uniform(*np.log(SHAKEN))) * max(task.size[:2])
    aims = choices.normal(size=(task.count, 3))
    _move(problem, state, _ways(problem, task, state, reach, budget, aims))
    return Poses.of(state)


def _move(problem: Problem, state: State, ways: Floats) -> None:
    for i in np.flatnonzero(ways.any(axis=1)).tolist():
        put(problem.lookup, state, i, state.turned[i], state.places[i] + ways[i])


def compact(
    problem: Problem,
    task: SearchTask,
    state: State,
    moves: int,
    budget: SearchBudget | None = None,
) -> None:
    """Lower a strip by moves of all its items at once.

    Algorithm: compaction (Li and Milenkovic, 1995). The height becomes least while each item goes
    by no more than a reach, stays inside, and pairs stay on their sides of planes; where these let
    pairs get in conflict, there are further planes, and the linear program is solved again.

    Parameters
    ----------
    state : State
        Poses of all items, inside and without conflicts; changed.
    moves : int
        The most moves.
    budget : SearchBudget, optional
        When it is late, the items stay where they are then.
    """
    reach = REACH * max(task.size[:2])
    count = task.count
    for _ in range(moves):
        before = state.bounds[:count, 5].max()
        _move(problem, state, _ways(problem, task, state, reach, budget))
        if state.bounds[:count, 5].max() > before * (1 - ENOUGH):
            reach /= 2
        if reach < LEAST_REACH * max(task.size[:2]) or _is_late(budget):
            break


def _is_late(budget: SearchBudget | None) -> bool:
    return budget is not None and budget.is_late


def _ways(
    problem: Problem,
    task: SearchTask,
    state: State,
    reach: float,
    budget: SearchBudget | None,
    aims: Floats | None = None,
) -> Floats:
    """Return ways (n, 3) of all items that lead to no conflict: of length 0 if it is late.

    They lower the strip, or go in the directions of aims (n, 3) at the same height.
    """
    width = max(task.size[:2])
    margins = STEP * width, (CELLS_MARGIN if problem.by_cells else MARGIN) * width
    pairs = _near(state, reach, task.count)
    chunks = [slice(n, n + AT_ONCE) for n in range(0, len(pairs), AT_ONCE)]
    planes, gaps = np.zeros((len(pairs), 4)), np.zeros(len(pairs))
    free = np.full((len(pairs), 3), np.inf)
    ways = np.zeros((len(state.types), 3))
    farthest = 2 * np.sqrt(3) * reach
    for some in chunks:
        first_planes(problem, state, pairs[some], farthest, *margins, planes[some], gaps[some])
        if _is_late(budget):
            return ways

    def blocked(ways: Floats) -> tuple[Ints, Floats]:
        """Return the pairs that are in conflict after ways, and planes that exclude them."""
        found, cuts = [pairs[:0]], [planes[:0]]
        for some in chunks:
            numbers, own = np.zeros(AT_ONCE, np.int64), np.zeros((AT_ONCE, 4))
            count = cutting_planes(
                problem, state, pairs[some], gaps[some], free[some], ways, *margins, numbers, own
            )
            found.append(pairs[some][numbers[:count]])
            cuts.append(own[:count])
            if _is_late(budget):
                break
        return np.concatenate(found), np.concatenate(cuts)

    has_plane = planes[:, :3].any(axis=1)
    rows, limits = pairs[has_plane], planes[has_plane]
    for _ in range(CUTS):
        seconds = np.inf if budget is None else budget.seconds_left
        ways[: task.count] = _solved(problem, task, state, reach, rows, limits, seconds, aims)
        found, cuts = blocked(ways)
        if _is_late(budget):
            return 0 * ways
        if len(found) == 0:
            return ways
        rows, limits = np.concatenate((rows, found)), np.concatenate((limits, cuts))
    for share in SHARES:
        if len(blocked(share * ways)[0]) == 0 and not _is_late(budget):
            return share * ways
    return 0 * ways


def _near(state: State, reach: float, count: int) -> Ints:
    """Return the pairs (p, 2) of which one may reach the other, the movable one first."""
    low, high = state.bounds[:, :3] - reach, state.bounds[:, 3:] + reach
    pairs = []
    for i in range(count):
        meets = ((low[i + 1 :] < high[i]) & (high[i + 1 :] > low[i])).all(axis=1)
        second = i + 1 + np.flatnonzero(meets)
        pairs.append(np.stack((np.full(len(second), i), second), axis=1))
    return np.concatenate(pairs)


def _solved(
    problem: Problem,
    task: SearchTask,
    state: State,
    reach: float,
    pairs: Ints,
    planes: Floats,
    seconds: float,
    aims: Floats | None,
) -> Floats:
    """Return the ways (n, 3) of the movable items that solve the linear program, 0 if late.

    With thousands of items it takes minutes.
    """
    n, m = task.count, len(pairs)
    own = np.arange(n)
    boxes = problem.lookup.boxes[state.types[:n], state.turned[:n]]
    low, high = state.places[:n] + boxes[:, :3], state.places[:n] + boxes[:, 3:]
    # The variables are the ways and, the last, the height.
    # Planes: normal * (first - second) <= -length; tops: z - height <= -top.
    normals = planes[:, :3]
    is_own = (pairs[:, 1] < n)[:, None]
    columns = 3 * np.minimum(pairs, n - 1)[:, :, None] + np.arange(3)
    at = np.repeat(np.arange(m), 3)
    entries = [
        (normals, at, columns[:, 0]),
        (np.where(is_own, -normals, 0), at, columns[:, 1]),
        (np.ones(n), m + own, 3 * own + 2),
        (-np.ones(n), m + own, np.full(n, 3 * n)),
    ]
    values, in_rows, in_columns = (
        np.concatenate([np.ravel(entry[k]) for entry in entries]) for k in range(3)
    )
    matrix = coo_matrix((values, (in_rows, in_columns)), (m + n, 3 * n + 1)).tocsr()
    if aims is None:
        cost, top, weight = np.empty((n, 3)), np.inf, 1.0
        cost[:, :2] = ASIDE / n * np.random.default_rng(0).uniform(-1, 1, (n, 2))
        cost[:, 2] = LOW / n
    else:
        cost, top, weight = -aims, float(high[:, 2].max()), 0.0
    least = np.clip(-low, -reach, 0)
    most = np.full((n, 3), reach)
    most[:, :2] = np.clip(np.array(task.size[:2]) - high[:, :2], 0, reach)
    found = linprog(
        np.append(cost, weight),
        matrix,
        np.concatenate((-planes[:, 3], -high[:, 2])),
        bounds=np.stack((np.append(least, 0), np.append(most, top)), axis=1),
        method="highs",
        options={"time_limit": seconds},
    )
    return np.zeros((n, 3)) if found.status else np.reshape(found.x[:-1], (n, 3))
