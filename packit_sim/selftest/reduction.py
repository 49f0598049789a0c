"""Reduction of a case in which answers differ to a smaller one in which they still do."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, STEP, box_cells
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import is_inside
from packit_sim.selftest.cases import Case
from packit_sim.selftest.comparisons import differences

REDUCTION_SECONDS = 60.0
"""Maximum time for the reduction of a case."""


def reduced(case: Case, check: str, seconds: float = REDUCTION_SECONDS) -> Case:
    """Find a smaller case in which a check still fails.

    Parameters
    ----------
    case : Case
        A case in which it fails.
    check : str
        The name of the check.
    seconds : float, default: 60
        Maximum time, approximately.

    Returns
    -------
    Case
        A case with fewer items, simpler rotations and scales, a smaller box and fewer triangles,
        as far as the same comparison still fails. The case itself if it fails no more.
    """
    deadline = time.monotonic() + seconds
    failing = {found.check for found in differences(case, check)}
    gain = True
    while gain:
        gain = False
        for simpler in (
            _fewer_items,
            _fewer_rules,
            _simpler_items,
            _smaller_boxes,
            _fewer_triangles,
        ):
            found: Case | None = case
            while found is not None:
                case = found
                found = _first_failing(simpler(case), check, failing, deadline)
                gain |= found is not None
    return case


def _first_failing(
    candidates: Iterator[Case], check: str, failing: set[str], deadline: float
) -> Case | None:
    """Find the first case in which one of the same comparisons fails; None if time is over."""
    for candidate in candidates:
        if time.monotonic() > deadline:
            return None
        if failing & {found.check for found in differences(candidate, check)}:
            return candidate
    return None


def _fewer_items(case: Case) -> Iterator[Case]:
    for start, stop in _runs(len(case.placed)):
        yield replace(case, placed=case.placed[:start] + case.placed[stop:])


def _fewer_rules(case: Case) -> Iterator[Case]:
    if case.easy:
        yield replace(case, easy=False)
    if case.kinematic:
        yield replace(case, kinematic=False)


def _simpler_items(case: Case) -> Iterator[Case]:
    for item in dict.fromkeys(_items(case)):
        simpler = [item.turned(0)] if item.rotation else []
        for digits in (1, 2, 3):
            scale = float(f"{item.scale:.{digits}g}")
            if len(repr(scale)) < len(repr(item.scale)):
                simpler.append(Item(item.shape, scale, item.rotation))
        for other in simpler:
            new = _with(case, item, other, np.zeros(3))
            if new is not None:
                yield new


def _smaller_boxes(case: Case) -> Iterator[Case]:
    stops = np.max([placed.stop for placed in case.placed] or [(STEP,) * 3], axis=0)
    least = np.maximum(-(-stops // STEP), -(-np.array(case.item.cells) // STEP)) * STEP
    for axis in range(3):
        for share in (0.0, 0.5):
            length = int(least[axis] + share * (case.cells[axis] - least[axis])) // STEP * STEP
            if least[axis] <= length < case.cells[axis]:
                lengths = list(case.cells)
                lengths[axis] = length
                yield replace(case, cells=box_cells(lengths))


def _fewer_triangles(case: Case) -> Iterator[Case]:
    for shape in {item.shape.digest: item.shape for item in _items(case)}.values():
        for start, stop in _runs(len(shape.mesh.faces)):
            kept = np.ones(len(shape.mesh.faces), dtype=bool)
            kept[start:stop] = False
            new = _with_triangles(case, shape, kept)
            if new is not None:
                yield new


def _runs(count: int) -> Iterator[tuple[int, int]]:
    """Generate the runs of numbers to leave out: halves, then quarters, down to single ones."""
    size = count
    while size > 1:
        size = (size + 1) // 2
        for start in range(0, count, size):
            yield start, min(start + size, count)
    if count == 1:
        yield 0, 1


def _items(case: Case) -> list[Item]:
    return [case.item, *(placed.item for placed in case.placed)]


def _with(case: Case, item: Item, other: Item, shift: Floats) -> Case | None:
    """Return the case with another item in place of one; None if it is not inside the box.

    The other item's centre is moved by `shift`, in box units, and rounded to the grid.
    """
    placed = []
    for each in case.placed:
        if each.item != item:
            placed.append(each)
            continue
        corner = each.center + shift - np.array(other.cells) * (CELL / 2)
        i, j, k = np.maximum(np.rint(corner / (STEP * CELL)), 0).astype(int).tolist()
        placed.append(PlacedItem(other, (i, j, k)))
    if not all(is_inside(case.cells, each) for each in placed):
        return None
    new = other if case.item == item else case.item
    return replace(case, placed=tuple(placed), item=new)


def _with_triangles(case: Case, shape: Shape, kept: npt.NDArray[np.bool_]) -> Case | None:
    """Return the case with some triangles of a shape only, where they are; None if impossible."""
    if not kept.any():
        return None
    mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces[kept], process=False)
    mesh.remove_unreferenced_vertices()
    try:
        fewer = Shape.from_mesh(mesh, shape.id)
    except MeshError:  # flat
        return None
    new: Case | None = case
    for item in dict.fromkeys(_items(case)):
        if new is not None and item.shape.digest == shape.digest:
            scale = item.scale * float(np.linalg.norm(mesh.extents)) ** 3
            other = Item(fewer, scale, item.rotation)
            new = _with(new, item, other, item.linear @ mesh.bounds.mean(axis=0))
    return new
