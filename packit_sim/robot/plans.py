"""Plans: items at poses that are known before, which an arm puts in one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from packit_sim import placement
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.physics.convex.decomposition import require
from packit_sim.physics.world import require_engine
from packit_sim.robot.arms import arm_of
from packit_sim.robot.attempts import attempt, is_over
from packit_sim.robot.cell import INSIDE, Cells, RobotCell
from packit_sim.robot.executed_item import ExecutedItem
from packit_sim.robot.grasps import grasp_off_the_grid
from packit_sim.robot.insertion import insertion_shifts
from packit_sim.robot.measures import inside_volume, measures
from packit_sim.robot.trajectory import Trajectory

SHIFT = 0.010
"""Metres by which an item is released next to its planned place, where others have moved there."""

_SHIFT_STEP = 0.002
"""Metres between two places that are tried."""

_HIGHER = 0.001
"""Metres above its planned place at which an item need not be shifted."""


@dataclass(frozen=True, eq=False)
class ExecutedPlan:
    """A box after an arm packed it as planned.

    Attributes
    ----------
    trajectory : Trajectory
        What the arm and the items did.
    inside : int
        The number of items that are wholly inside the box at the end, below its rim.
    executed : float
        Their volume, relative to that of all items, also of those outside.
    scores : dict of str to number
        The measures (see `robot.measures.measures`).
    """

    trajectory: Trajectory
    inside: int
    executed: float
    scores: dict[str, int | float]


def execute_plan(
    plan: Sequence[PosedItem],
    cells: Cells,
    cell: RobotCell,
    outside: Sequence[Item] = (),
    *,
    tried: tuple[ExecutedItem, ...] = (),
    callback: Callable[[tuple[ExecutedItem, ...]], None] | None = None,
) -> ExecutedPlan:
    """Let an arm put items into a box at planned poses, in their order.

    Parameters
    ----------
    plan : sequence of PosedItem
        The items where they are to be.
    cells : Cells
        The box.
    cell : RobotCell
        The robot cell. In a closed loop each item comes straight down at its planned place, or up
        to `SHIFT` next to it if other items, where they really are, keep it from going as deep
        there. In an open loop it does so among the planned poses.
    outside : sequence of Item
        Items that are not planned.
    tried : tuple of ExecutedItem
        The first items of the plan, as an earlier call passed them to its callback before it was
        interrupted: only the others are put in.
    callback : callable, optional
        Called after each item with all that were tried.

    Returns
    -------
    ExecutedPlan
        The box at the end.

    Raises
    ------
    ArgumentError
        If the arm can't reach the box, or can't lift an item.
    MissingPackageError
        If PyBullet is not installed.
    """
    require_engine()
    require(cell.decomposition)
    arm = arm_of(cell, cells)
    arm.check(cells, cell.edge * max((_longest(one) for one in plan), default=0.0))
    for one in plan:
        cell.check_payload(repr(one.item.shape.id), one.item.volume)
    for wanted in plan[len(tried) :]:
        if cell.open_loop:
            known = [one.planned for one in tried]
        else:
            known = [one.posed for one in tried if is_over(cells, one.posed)]
        planned = _lowered(wanted, known, cells, cell)
        tried = attempt(tried, wanted, planned, cell=cell, cells=cells, arm=arm)
        if callback is not None:
            callback(tried)
    trajectory = Trajectory.of(cell, cells, tried)
    items = [*(one.item for one in tried), *outside]
    return ExecutedPlan(
        trajectory=trajectory,
        inside=sum(one.inside for one in tried),
        executed=inside_volume(trajectory) / plain_sum(item.volume for item in items),
        scores=measures(trajectory, items),
    )


def _longest(posed: PosedItem) -> float:
    return float(np.ptp(posed.bounds, axis=0).max())


def _lowered(
    wanted: PosedItem, known: Sequence[PosedItem], cells: Cells, cell: RobotCell
) -> PosedItem:
    """Return an item where it rests after it came straight down, at the best of the places.

    It is where it was wanted if several moves lead there, or if it would protrude from the box at
    all of the places.
    """
    size = np.array(cells) * CELL
    low, high = wanted.bounds
    steps = np.arange(-SHIFT, SHIFT + _SHIFT_STEP / 2, _SHIFT_STEP) / cell.edge
    shifts = sorted(product(steps.tolist(), repeat=2), key=lambda shift: np.hypot(*shift))
    top = max([float(size[2]), *(float(one.bounds[1, 2]) for one in known)])
    raised = wanted.moved(Motion.shift((0.0, 0.0, top - low[2])))
    best, least = wanted, float(size[2]) + INSIDE / cell.edge - float(high[2] - low[2])
    for shift in shifts[:1] if cell.open_loop else shifts:
        sideways = np.array(shift)
        is_inside = (low[:2] + sideways >= 0).all() and (high[:2] + sideways <= size[:2]).all()
        if sideways.any() and not is_inside:
            continue
        above = raised.moved(Motion.shift((*shift, 0.0)))
        fall = min([top, *(placement.free_way(above, other) for other in known)])
        if top - fall < least:
            best, least = above.moved(Motion.shift((0.0, 0.0, -fall))), top - fall
        if least <= low[2] + _HIGHER / cell.edge:
            break
    if cell.moves > 1 and least > low[2] + _HIGHER / cell.edge:
        return _moved_in(wanted, known, cells, cell) or best
    return best


def _moved_in(
    wanted: PosedItem, known: Sequence[PosedItem], cells: Cells, cell: RobotCell
) -> PosedItem | None:
    """Return an item at its place, or a little above it, if several moves lead there."""
    grasp = grasp_off_the_grid(wanted, cell)
    if grasp is None:
        return None
    for height in np.arange(0.0, SHIFT, _SHIFT_STEP / 2).tolist():
        posed = wanted.moved(Motion.shift((0.0, 0.0, (height + cell.gap) / cell.edge)))
        if insertion_shifts(known, posed, grasp, cell=cell, cells=cells) is not None:
            fall = min([float(posed.bounds[0, 2]), *(placement.free_way(posed, o) for o in known)])
            return posed.moved(Motion.shift((0.0, 0.0, -fall)))
    return None
