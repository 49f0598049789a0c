"""Feasible locations: where an item can stand in a box, exactly (DESIGN: Feasible).

Cheap filters first: cell boxes, then the words of fine cells, and FCL for the few locations that
the words leave open. `oracle` is the slow and obvious statement of the same; the two always agree.
"""

from __future__ import annotations

import operator
import threading
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import fcl
import numba
import numpy as np
import numpy.typing as npt
from cachetools import LRUCache, cached

from packit_sim import rotations
from packit_sim.errors import InfeasibleError
from packit_sim.lattice import (
    CELL,
    CONTACT_TOLERANCE,
    FINE_PER_CELL,
    STEP,
    Triple,
    grid_nodes,
)
from packit_sim.occupancy import Occupancy, Placed
from packit_sim.shapes import Item

Mask = npt.NDArray[np.bool_]

FINE_CACHE_BYTES = 2**30
"""Budget of the process's cache of whole fine arrays, which only the oracle asks for."""

COLLISION_CACHE_TRIANGLES = 1_000_000
"""Budget of the process's cache of collision meshes, roughly 1 kB a triangle."""

_BLOCKED, _FREE, _OPEN = 0, 1, 2


class Contents(Protocol):
    """A box as seen from here: its cells an axis, and what is placed in it, in order."""

    @property
    def cells(self) -> Triple: ...
    @property
    def placed(self) -> tuple[Placed, ...]: ...


def feasible(occupancy: Occupancy, item: Item) -> Mask:
    """The exact mask: bool over the grid's nodes, True where the item is feasible."""
    nodes = grid_nodes(occupancy.cells)
    last = _last_location(occupancy.cells, item)
    if min(last) < 0:
        return np.zeros(nodes, dtype=bool)
    state = _classify(*_query(occupancy, item), np.array(nodes), np.array(last))
    mask: Mask = state == _FREE
    for i, j, k in np.argwhere(state == _OPEN).tolist():
        mask[i, j, k] = not crosses(occupancy, Placed(item, (i, j, k)))
    return mask


def blbf(occupancy: Occupancy, item: Item) -> Triple | None:
    """The bottom-left-back-fill location: the feasible one that is least in (z, x, y), or None."""
    last = _last_location(occupancy.cells, item)
    if min(last) < 0:
        return None
    query = _query(occupancy, item)
    start = 0
    while True:
        i, j, k, state = _next_unblocked(*query, np.array(last), start)
        if state == _BLOCKED:
            return None
        location = (int(i), int(j), int(k))
        if state == _FREE or not crosses(occupancy, Placed(item, location)):
            return location
        start = (k * (last[0] + 1) + i) * (last[1] + 1) + j + 1


def is_feasible(occupancy: Occupancy, candidate: Placed) -> bool:
    """Whether one item is feasible at one location: the mask's value there."""
    if not is_inside(occupancy.cells, candidate):
        return False
    state = _classify_one(*_query(occupancy, candidate.item), np.array(candidate.start))
    return bool(state == _FREE or (state == _OPEN and not crosses(occupancy, candidate)))


def crosses(occupancy: Occupancy, candidate: Placed) -> bool:
    """Whether FCL finds the candidate crossing a placed item, asked where outer fine cells meet."""
    return any(collides(other, candidate) for other in occupancy.touching(candidate))


def is_inside(cells: Triple, candidate: Placed) -> bool:
    """Whether the candidate's cell box is inside a box of so many cells."""
    return all(stop <= c for stop, c in zip(candidate.stop, cells, strict=True))


def oracle(box: Contents, item: Item) -> Mask:
    """The mask by the plain loop of DESIGN: slow, obvious, and always right."""
    mask = np.zeros(grid_nodes(box.cells), dtype=bool)
    for i, j, k in np.ndindex(mask.shape):
        mask[i, j, k] = is_valid(box.cells, box.placed, Placed(item, (i, j, k)))
    return mask


def is_valid(cells: Triple, placed: Iterable[Placed], candidate: Placed) -> bool:
    """The oracle's answer for one location, among placed items in a box of so many cells."""
    return is_inside(cells, candidate) and not any(conflicts(other, candidate) for other in placed)


def conflicts(a: Placed, b: Placed) -> bool:
    """Whether two items can't both stand where they are, by the oracle's definition.

    One holds a fine cell inside it that is outer for the other, or their collision meshes cross.
    What lies wholly within the fine cells that another's surface touches, so within 1/400 of that
    surface, and does not cross it, is no conflict, on whichever side of it.
    """
    start = np.maximum(a.start, b.start)
    stop = np.minimum(a.stop, b.stop)
    if (start >= stop).any():
        return False
    window_a, window_b = (
        tuple(
            slice(*s)
            for s in zip(*((np.array((start, stop)) - p.start) * FINE_PER_CELL), strict=True)
        )
        for p in (a, b)
    )
    outer_a, inner_a = _fine_cells(a.item)
    outer_b, inner_b = _fine_cells(b.item)
    return bool(
        (inner_a[window_a] & outer_b[window_b]).any()
        or (outer_a[window_a] & inner_b[window_b]).any()
        or collides(a, b)
    )


def blockers(placed: Iterable[Placed], candidate: Placed) -> list[int]:
    """Numbers of the placed items that a candidate is in conflict with."""
    return [n for n, other in enumerate(placed) if conflicts(other, candidate)]


def collides(a: Placed, b: Placed) -> bool:
    """Whether FCL finds a triangle of one collision mesh that crosses one of the other.

    A fact of the two items and the whole half cells between their centres: the first in a fixed
    order of items stands at the origin, whatever the place in the box or the order of placing.
    """
    if (b.item.key, b.start) < (a.item.key, a.start):
        a, b = b, a
    half_cells = np.add(b.start, b.stop) - np.add(a.start, a.stop)
    at_origin = fcl.Transform(rotations.MATRICES[a.item.rotation].astype(float), np.zeros(3))
    beside = fcl.Transform(
        rotations.MATRICES[b.item.rotation].astype(float), half_cells * (CELL / 2)
    )
    request = fcl.CollisionRequest(num_max_contacts=1, enable_contact=False)
    return bool(
        fcl.collide(
            fcl.CollisionObject(_collision_mesh(a.item), at_origin),
            fcl.CollisionObject(_collision_mesh(b.item), beside),
            request,
            fcl.CollisionResult(),
        )
    )


def checked_location(cells: Triple, location: Sequence[int]) -> Triple:
    """A location as a triple of ints. Raises InfeasibleError where it is no node of the grid."""
    nodes = grid_nodes(cells)
    try:
        i, j, k = (operator.index(n) for n in location)
    except (TypeError, ValueError):
        raise InfeasibleError(
            f"location {location!r} is not possible: it must be three whole numbers"
        ) from None
    if not all(0 <= n < count for n, count in zip((i, j, k), nodes, strict=True)):
        raise InfeasibleError(
            f"location {(i, j, k)} is outside the grid: "
            f"it reaches from (0, 0, 0) to {tuple(n - 1 for n in nodes)}"
        )
    return i, j, k


@cached(
    LRUCache(FINE_CACHE_BYTES, getsizeof=lambda fine: fine[0].nbytes + fine[1].nbytes),
    key=operator.attrgetter("key"),
    lock=threading.RLock(),
)
def _fine_cells(item: Item) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Bool over the fine cells of the item's cell box: outer, and inner."""
    return item.voxels.outer_fine, item.voxels.inner_fine


@cached(
    LRUCache(COLLISION_CACHE_TRIANGLES, getsizeof=lambda model: model.num_tries_()),
    key=lambda item: (item.shape.digest, item.scale),
    lock=threading.RLock(),
)
def _collision_mesh(item: Item) -> fcl.BVHModel:
    """The shape at the item's scale, drawn in by half the contact tolerance on each side."""
    extents = Item(item.shape, item.scale).extents
    drawn_in = np.maximum(extents - CONTACT_TOLERANCE, 0) / extents
    mesh = item.shape.mesh
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(mesh.vertices * (np.cbrt(item.scale) * drawn_in), mesh.faces)
    model.endModel()
    return model


def _last_location(cells: Triple, item: Item) -> Triple:
    """The largest location at which the item is inside the box; negative where it is too large."""
    x, y, z = ((c - own) // STEP for c, own in zip(cells, item.cells, strict=True))
    nodes = grid_nodes(cells)
    return min(x, nodes[0] - 1), min(y, nodes[1] - 1), min(z, nodes[2] - 1)


def _query(occupancy: Occupancy, item: Item) -> tuple[Any, ...]:
    """What the kernels read of the box and of the item, cells by their C-order index in the box."""
    voxels = item.voxels
    return (
        occupancy.outer.ravel(),
        occupancy.inner.ravel(),
        occupancy.filled,
        np.array(occupancy.cells),
        occupancy.spans,
        np.array(item.cells),
        _cell_index(voxels.coords, occupancy.cells),
        voxels.outer,
        voxels.inner,
    )


@numba.njit(cache=True, nogil=True)
def _cell_index(coords, cells):
    index = np.empty(len(coords), np.int64)
    for n in range(len(coords)):
        index[n] = (coords[n, 0] * cells[1] + coords[n, 1]) * cells[2] + coords[n, 2]
    return index


@numba.njit(cache=True, nogil=True)
def _classify_one(
    box_outer, box_inner, filled, box_cells, spans, cells, index, outer, inner, start
):
    """What the fine cells tell of one location: blocked, free, or open."""
    apart = True
    for n in range(len(spans)):
        if (
            start[0] < spans[n, 3]
            and spans[n, 0] < start[0] + cells[0]
            and start[1] < spans[n, 4]
            and spans[n, 1] < start[1] + cells[1]
            and start[2] < spans[n, 5]
            and spans[n, 2] < start[2] + cells[2]
        ):
            apart = False
            break
    if apart:
        return _FREE
    state = _FREE
    first = (start[0] * box_cells[1] + start[1]) * box_cells[2] + start[2]
    for n in range(len(index)):
        at = first + index[n]
        if not filled[at >> 6] >> np.uint64(at & 63) & np.uint64(1):
            continue
        if (box_outer[at] & inner[n]) | (box_inner[at] & outer[n]):
            return _BLOCKED
        if box_outer[at] & outer[n]:
            state = _OPEN
    return state


@numba.njit(cache=True, nogil=True)
def _classify(
    box_outer, box_inner, filled, box_cells, spans, cells, index, outer, inner, nodes, last
):
    """The state of every location, in an array over the grid's nodes."""
    state = np.zeros((nodes[0], nodes[1], nodes[2]), np.uint8)
    start = np.zeros(3, np.int64)
    for i in range(last[0] + 1):
        start[0] = i * STEP
        for j in range(last[1] + 1):
            start[1] = j * STEP
            for k in range(last[2] + 1):
                start[2] = k * STEP
                state[i, j, k] = _classify_one(
                    box_outer,
                    box_inner,
                    filled,
                    box_cells,
                    spans,
                    cells,
                    index,
                    outer,
                    inner,
                    start,
                )
    return state


@numba.njit(cache=True, nogil=True)
def _next_unblocked(
    box_outer, box_inner, filled, box_cells, spans, cells, index, outer, inner, last, first
):
    """The first location in the order of (z, x, y), from number `first` on, that is not blocked."""
    row, layer = last[1] + 1, (last[0] + 1) * (last[1] + 1)
    start = np.zeros(3, np.int64)
    for number in range(first, layer * (last[2] + 1)):
        k, rest = divmod(number, layer)
        i, j = divmod(rest, row)
        start[0], start[1], start[2] = i * STEP, j * STEP, k * STEP
        state = _classify_one(
            box_outer, box_inner, filled, box_cells, spans, cells, index, outer, inner, start
        )
        if state != _BLOCKED:
            return i, j, k, state
    return 0, 0, 0, _BLOCKED
