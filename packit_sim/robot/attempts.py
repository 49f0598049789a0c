"""Attempts: the arm tries to put one more item into the box, if it can hold and insert it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh

from packit_sim.geometry.items import ItemInBox, PlacedItem, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.physics.settling import fitted_with, moved_parts
from packit_sim.robot.arm import Arm
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.executed_item import ExecutedItem, Outcome
from packit_sim.robot.execution import Execution, execute, tool_path
from packit_sim.robot.grasps import best_grasp, grasp_off_the_grid
from packit_sim.robot.insertion import insertion_shifts
from packit_sim.robot.presentation import presented
from packit_sim.robot.recording import Recording


def attempt(
    tried: Sequence[ExecutedItem],
    chosen: ItemInBox,
    planned: PosedItem,
    *,
    cell: RobotCell,
    cells: Cells,
    arm: Arm,
) -> tuple[ExecutedItem, ...]:
    """Let the arm try to put an item into the box.

    Parameters
    ----------
    tried : sequence of ExecutedItem
        All items that were tried before.
    chosen : ItemInBox
        The placement that was chosen for the item.
    planned : PosedItem
        Where the arm is to release it: straight below.

    Returns
    -------
    tuple of ExecutedItem
        All items that were tried, and last this one, where they are afterwards. It has the outcome
        `no path` if it would meet another item, where that really is, on each of its ways into the
        box (see `insertion_shifts`), or protrude from the box.
    """
    number = len(tried)
    there = [n for n, one in enumerate(tried) if is_over(cells, one.posed)]
    actual = [tried[n].posed for n in there]
    aside = presented(planned, cell, cells, number)
    if isinstance(chosen, PlacedItem):
        grasp = best_grasp(chosen.item, cell)
    else:
        grasp = grasp_off_the_grid(planned, cell)
    route = None
    released = planned.moved(Motion.shift((0.0, 0.0, cell.gap / cell.edge)))
    shifts = None
    if grasp is not None and cell.holds(cells, planned):
        shifts = insertion_shifts(actual, released, grasp, cell=cell, cells=cells)
    if grasp is not None and shifts is not None:
        path = tool_path(actual, aside, planned, grasp, shifts, cell=cell, cells=cells)
        route = arm.route(path, _load(aside, cell), (cell.seed, number))
    parts = [tried[n].parts for n in there] + [()]
    if grasp is None or route is None:
        outcome = Outcome.NO_GRASP if grasp is None else Outcome.NO_PATH
        done = Execution(outcome, (*actual, aside), Recording(np.empty((0, cell.joints))))
    else:
        fitted = fitted_with([tried[n] for n in there], planned, cell.world)
        both = zip(fitted.measured, (*actual, planned), strict=True)
        parts = [moved_parts(own, posed.pose.inverse()) for own, posed in both]
        done = execute(
            actual,
            fitted.pieces,
            [*there, number],
            aside,
            planned,
            grasp.radius,
            route,
            cell=cell,
            cells=cells,
            arm=arm,
        )
    new = ExecutedItem(chosen, planned, done.outcome, aside, done.posed[-1], False, done.recording)
    now = [*tried, new]
    for n, posed, own in zip([*there, number], done.posed, parts, strict=True):
        now[n] = replace(now[n], posed=posed, inside=cell.holds(cells, posed), parts=own)
    return tuple(now)


def is_over(cells: Cells, posed: PosedItem) -> bool:
    """Decide whether an item is in or above a box: others are cleared away."""
    x, y, _ = posed.center
    return bool(0 <= x <= cells[0] * CELL and 0 <= y <= cells[1] * CELL)


def _load(posed: PosedItem, cell: RobotCell) -> trimesh.Trimesh:
    """Return the mesh of an item where it is, in m."""
    vertices = posed.vertices * cell.edge
    return trimesh.Trimesh(vertices, posed.item.shape.mesh.faces, process=False)
