"""Straight moves that bring an item to its place, past others where they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from trimesh import creation

from packit_sim import placement
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import AxisNumber
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.grasps import Grasp

TURN_STEP = 0.02
"""Box units between two places at which a move may begin."""

_SIDES = 16
"""Sides of the prism around a cup."""

_MOVES: tuple[tuple[AxisNumber, float], ...] = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1))


def insertion_shifts(
    others: Sequence[PosedItem], released: PosedItem, grasp: Grasp, *, cell: RobotCell, cells: Cells
) -> tuple[Floats, ...] | None:
    """Search for the fewest straight moves that bring an item to where it is released.

    Parameters
    ----------
    others : sequence of PosedItem
        The items in the box.
    released : PosedItem
        The item where it is released.
    grasp : Grasp
        Where the cup holds it: the cup and its tube, which goes straight up, must pass, too.

    Returns
    -------
    tuple of ndarray of float64, shape (3,), or None
        The shifts from there at which the moves end, in box units: the first is straight down from
        above, the others are along x, y or z, the last shift is 0. None if `RobotCell.moves` are
        not enough. Exact sweeps of the meshes decide.
    """
    if placement.is_insertable(others, released):
        return (np.zeros(3),)
    if cell.moves == 1:
        return None
    carried = (released, _column(released, grasp, cell, cells))
    paths: list[tuple[Floats, ...]] = [(np.zeros(3),)]
    for _ in range(cell.moves - 1):
        longer: list[tuple[Floats, ...]] = []
        for path in paths:
            for start in _starts(others, carried, path[0], cells):
                if placement.is_insertable(others, _shifted(released, start)):
                    found = (start, *path)
                    if _is_free(others, carried, found):
                        return found
                longer.append((start, *path))
        paths = longer
    return None


def _starts(
    others: Sequence[PosedItem], carried: Sequence[PosedItem], end: Floats, cells: Cells
) -> Iterator[Floats]:
    """Yield the shifts from which a straight move leads to one, the nearest first."""
    reaches = []
    for axis, sign in _MOVES:
        reach = float(max(cells)) * CELL if axis == 2 else _room(carried[0], end, axis, sign, cells)
        reaches.append(min([reach, *(_way(others, body, end, axis, sign) for body in carried)]))
    for count in range(1, int(max(reaches) / TURN_STEP) + 1):
        for (axis, sign), reach in zip(_MOVES, reaches, strict=True):
            if count * TURN_STEP <= reach:
                start = end.copy()
                start[axis] += sign * count * TURN_STEP
                yield start


def _room(posed: PosedItem, shift: Floats, axis: int, sign: float, cells: Cells) -> float:
    """Return how far an item can move along x or y until it meets a wall."""
    along = posed.vertices[:, axis] + shift[axis]
    return float(cells[axis] * CELL - along.max() if sign > 0 else along.min())


def _is_free(
    others: Sequence[PosedItem], carried: Sequence[PosedItem], shifts: Sequence[Floats]
) -> bool:
    """Decide whether moves, whose start is free, meet nothing: also if the end crosses an item."""
    for start, end in pairwise(shifts):
        axis = next(axis for axis, _ in _MOVES if end[axis] != start[axis])
        away = float(end[axis] - start[axis])
        for body in carried[: 1 if axis == 2 else 2]:  # a tube moves up and down within itself
            if _way(others, body, start, axis, away) < abs(away):
                return False
    return True


def _way(
    others: Sequence[PosedItem], body: PosedItem, shift: Floats, axis: AxisNumber, sign: float
) -> float:
    """Return how far a shifted body can move along an axis until it meets an item."""
    here = _shifted(body, shift)
    ways = (placement.free_way(here, other, axis, sign > 0) for other in others)
    return min(ways, default=np.inf)


def _shifted(posed: PosedItem, shift: Floats) -> PosedItem:
    return posed.moved(Motion.shift(shift))


def _column(posed: PosedItem, grasp: Grasp, cell: RobotCell, cells: Cells) -> PosedItem:
    """Return a prism around the cup and its tube, higher than everything in the box."""
    height = 2.0 * float(max(cells)) * CELL
    radius = grasp.radius / cell.edge / np.cos(np.pi / _SIDES)
    mesh = creation.cylinder(radius, height, sections=_SIDES)
    item = Item(Shape.from_mesh(mesh, "cup"), float(np.linalg.norm(mesh.extents)) ** 3)
    middle = posed.center + np.array(grasp.point) + (0.0, 0.0, height / 2)
    return PosedItem.at(item, Motion.shift(middle))
