"""What cells tell of a location before any mesh is asked: blocked, free, or open.

Blocked: a fine cell is inner for one item and outer for another. Free: no outer fine cell is
shared. Both are proofs (DESIGN: Feasible); what is open, the meshes decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.compilation import kernel
from packit_sim.engine.occupancy import Occupancy, PlacedItem
from packit_sim.geometry.bits import count_bits, lowest_bit
from packit_sim.geometry.lattice import STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import Voxels

FREE, OPEN, BLOCKED = 0, 1, 2
"""In this order: what several placed items tell of a location is the largest of what each does."""

States = npt.NDArray[np.uint8]
Locations = npt.NDArray[np.int64]

_1 = np.uint64(1)


def locations(cells: Triple, item: Item) -> Triple:
    """How many locations an axis the item has inside a box of so many cells; it must fit."""
    x, y, z = ((c - own) // STEP + 1 for c, own in zip(cells, item.cells, strict=True))
    nodes = grid_nodes(cells)
    return min(x, nodes[0]), min(y, nodes[1]), min(z, nodes[2])


def screen(occupancy: Occupancy[Any], item: Item) -> States:
    """The state of every location from (0, 0, 0) to the last at which the item is inside."""
    size = locations(occupancy.cells, item)
    return _screen(*_box(occupancy), *_item(item.voxels), occupancy.spans, size)


def screen_at(occupancy: Occupancy[Any], candidate: PlacedItem) -> int:
    """The state of one location, at which the item is inside the box."""
    voxels = candidate.item.voxels
    return int(_screen_at(*_box(occupancy), *_item(voxels), candidate.location))


def unblocked(
    occupancy: Occupancy[Any], item: Item, start: Triple
) -> Iterator[tuple[Triple, npt.NDArray[np.int64], int]]:
    """The locations that are not blocked, from `start` on, in the order of (z, x, y).

    Each with the numbers of the placed items that leave it open, none where it is free, and with
    how many locations were looked at so far.
    """
    voxels = item.voxels
    size = locations(occupancy.cells, item)
    spans = occupancy.spans
    found = np.empty(len(spans), dtype=np.int64)
    box, own = _box(occupancy), _item(voxels)
    hosts = (spans, occupancy.starts, *occupancy.hosts, voxels.number.shape, found)
    i, j, k = start
    number = (k * size[0] + i) * size[1] + j
    i, j, k, number, count = _next_unblocked(*box, *own, size, number, *hosts)
    while count >= 0:
        yield (i, j, k), found[:count], number
        i, j, k, number, count = _next_unblocked(*box, *own, size, number, *hosts)


def open_pairs(occupancy: Occupancy[Any], item: Item, at: Locations) -> npt.NDArray[np.int64]:
    """(pairs, 2): number of a location (n, 3), and of a placed item that leaves it open.

    By location, and then by placed item; for locations that no item blocks.
    """
    voxels = item.voxels
    hosts = (occupancy.spans, occupancy.starts, *occupancy.hosts, voxels.number.shape)
    return _open_pairs(*_item(voxels), at, *hosts)


def screen_pair(placed: PlacedItem, item: Item, at: Locations) -> States:
    """What the cells of one placed item tell of another's locations: (n,) states for (n, 3)."""
    offsets = at - np.array(placed.location)
    return _screen_pair(*_host(placed.item.voxels), *_item(item.voxels), offsets)


def screen_offsets(a: Item, b: Item) -> States:
    """The states of two items at all offsets at which their bricks meet.

    [x, y, z] for b at x - (bricks of b along x) + 1 and so on, in grid steps from a.
    """
    return _screen_offsets(*_host(a.voxels), *_item(b.voxels), b.voxels.number.shape)


def _box(occupancy: Occupancy[Any]) -> tuple[Any, ...]:
    """What kernels read of a box."""
    nx, ny, _ = grid_nodes(occupancy.cells)
    return occupancy.bricks, occupancy.page, occupancy.fine, nx, ny


def _item(voxels: Voxels) -> tuple[Any, ...]:
    """What kernels read of an item that is asked about."""
    return voxels.bricks, voxels.outer, voxels.inner, voxels.first, voxels.fine


def _host(voxels: Voxels) -> tuple[Any, ...]:
    """What kernels read of an item that another one is held against: "their" arrays."""
    return voxels.number, voxels.outer, voxels.inner, voxels.first, voxels.fine


@kernel
def _offsets(bricks, nx, ny):
    """By how much the number in the box of each of an item's bricks exceeds its location's."""
    offsets = np.empty(len(bricks), np.int32)
    for n in range(len(bricks)):
        offsets[n] = (bricks[n, 2] * nx + bricks[n, 0]) * ny + bricks[n, 1]
    return offsets


@kernel
def _state(theirs, page, their_fine, offsets, outer, inner, first, fine, start, hot):
    """The state of the location whose brick has number `start`, and the brick that blocks it.

    hot: the item's brick to look at first, that which blocked the location before.
    """
    at = start + offsets[hot]
    if theirs[at, 0] & inner[hot] | theirs[at, 1] & outer[hot]:
        return BLOCKED, hot
    state = FREE
    for n in range(len(offsets)):
        at = start + offsets[n]
        taken = theirs[at, 0]
        shared = taken & outer[n]
        if not shared:
            continue
        if taken & inner[n] | theirs[at, 1] & outer[n]:
            return BLOCKED, n
        kept = page[at]  # a view of the page would be counted, twice for each brick
        surface = outer[n] & ~inner[n]
        while shared:
            bit = lowest_bit(shared)
            shared &= shared - _1
            own = first[n] + count_bits(surface & (_1 << np.uint64(bit)) - _1)
            if their_fine[kept, bit, 0] & fine[own, 1] | their_fine[kept, bit, 1] & fine[own, 0]:
                return BLOCKED, n
            if their_fine[kept, bit, 0] & fine[own, 0]:
                state = OPEN
    return state, hot


@kernel
def _screen(theirs, page, their_fine, nx, ny, bricks, outer, inner, first, fine, spans, size):
    """The states of locations; spans: (n, 6) first and last brick of each placed item."""
    states = np.full(size, np.uint8(FREE))
    near = np.zeros(size, np.bool_)
    extent = np.zeros(3, np.int64)
    for n in range(len(bricks)):
        for d in range(3):
            extent[d] = max(extent[d], bricks[n, d])
    for n in range(len(spans)):
        for i in range(max(spans[n, 0] - extent[0], 0), min(spans[n, 3] + 1, size[0])):
            for j in range(max(spans[n, 1] - extent[1], 0), min(spans[n, 4] + 1, size[1])):
                for k in range(max(spans[n, 2] - extent[2], 0), min(spans[n, 5] + 1, size[2])):
                    near[i, j, k] = True
    offsets = _offsets(bricks, nx, ny)
    hot = 0
    for k in range(size[2]):
        for i in range(size[0]):
            for j in range(size[1]):
                if near[i, j, k]:
                    start = (k * nx + i) * ny + j
                    states[i, j, k], hot = _state(
                        theirs, page, their_fine, offsets, outer, inner, first, fine, start, hot
                    )
    return states


@kernel
def _screen_at(theirs, page, their_fine, nx, ny, bricks, outer, inner, first, fine, location):
    i, j, k = location
    start = (k * nx + i) * ny + j
    offsets = _offsets(bricks, nx, ny)
    return _state(theirs, page, their_fine, offsets, outer, inner, first, fine, start, 0)[0]


@kernel
def _next_unblocked(
    theirs,
    page,
    their_fine,
    nx,
    ny,
    bricks,
    outer,
    inner,
    first,
    fine,
    size,
    number,
    spans,
    starts,
    host_number,
    host_outer,
    host_inner,
    host_first,
    host_fine,
    extent,
    found,
):
    row, layer = size[1], size[0] * size[1]
    offsets = _offsets(bricks, nx, ny)
    hot = 0
    while number < layer * size[2]:
        k, rest = divmod(number, layer)
        i, j = divmod(rest, row)
        start = (k * nx + i) * ny + j
        state, hot = _state(
            theirs, page, their_fine, offsets, outer, inner, first, fine, start, hot
        )
        number += 1
        if state == BLOCKED:
            continue
        count = 0
        if state == OPEN:
            count = _open_with(
                bricks,
                outer,
                inner,
                first,
                fine,
                (i, j, k),
                spans,
                starts,
                host_number,
                host_outer,
                host_inner,
                host_first,
                host_fine,
                extent,
                found,
            )
        return i, j, k, number, count
    return 0, 0, 0, number, -1


@kernel
def _open_pairs(
    bricks,
    outer,
    inner,
    first,
    fine,
    at,
    spans,
    starts,
    host_number,
    host_outer,
    host_inner,
    host_first,
    host_fine,
    extent,
):
    pairs = np.empty((16, 2), np.int64)
    found = np.empty(len(spans), np.int64)
    total = 0
    for n in range(len(at)):
        count = _open_with(
            bricks,
            outer,
            inner,
            first,
            fine,
            (at[n, 0], at[n, 1], at[n, 2]),
            spans,
            starts,
            host_number,
            host_outer,
            host_inner,
            host_first,
            host_fine,
            extent,
            found,
        )
        if total + count > len(pairs):
            grown = np.empty((2 * (total + count), 2), np.int64)
            grown[:total] = pairs[:total]
            pairs = grown
        for m in range(count):
            pairs[total, 0], pairs[total, 1] = n, found[m]
            total += 1
    return pairs[:total]


@kernel
def _open_with(
    bricks,
    outer,
    inner,
    first,
    fine,
    location,
    spans,
    starts,
    host_number,
    host_outer,
    host_inner,
    host_first,
    host_fine,
    extent,
    found,
):
    """Which placed items leave a location open, into `found`; returns how many."""
    i, j, k = location
    count = 0
    for n in range(len(spans)):
        if (
            i > spans[n, 3]
            or j > spans[n, 4]
            or k > spans[n, 5]
            or i + extent[0] <= spans[n, 0]
            or j + extent[1] <= spans[n, 1]
            or k + extent[2] <= spans[n, 2]
        ):
            continue
        x, y, z = (
            spans[n, 3] - spans[n, 0] + 1,
            spans[n, 4] - spans[n, 1] + 1,
            spans[n, 5] - spans[n, 2] + 1,
        )
        at, brick, cell = starts[n]
        state = _pair_state(
            host_number[at : at + x * y * z].reshape(x, y, z),
            host_outer[brick:],
            host_inner[brick:],
            host_first[brick:],
            host_fine[cell:],
            bricks,
            outer,
            inner,
            first,
            fine,
            (i - spans[n, 0], j - spans[n, 1], k - spans[n, 2]),
        )
        if state == OPEN:
            found[count] = n
            count += 1
    return count


@kernel
def _pair_state(
    number,
    their_outer,
    their_inner,
    their_first,
    their_fine,
    bricks,
    outer,
    inner,
    first,
    fine,
    offset,
):
    """As `_state`, for an item `offset` bricks from another, the host."""
    nx, ny, nz = number.shape
    state = FREE
    for n in range(len(bricks)):
        x, y, z = bricks[n, 0] + offset[0], bricks[n, 1] + offset[1], bricks[n, 2] + offset[2]
        if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
            continue
        m = number[x, y, z]
        if m < 0:
            continue
        shared = their_outer[m] & outer[n]
        if not shared:
            continue
        if their_outer[m] & inner[n] | their_inner[m] & outer[n]:
            return BLOCKED
        surface = outer[n] & ~inner[n]
        their_surface = their_outer[m] & ~their_inner[m]
        while shared:
            bit = lowest_bit(shared)
            shared &= shared - _1
            below = (_1 << np.uint64(bit)) - _1
            own = first[n] + count_bits(surface & below)
            their = their_first[m] + count_bits(their_surface & below)
            if their_fine[their, 0] & fine[own, 1] | their_fine[their, 1] & fine[own, 0]:
                return BLOCKED
            if their_fine[their, 0] & fine[own, 0]:
                state = OPEN
    return state


@kernel
def _screen_pair(
    number,
    their_outer,
    their_inner,
    their_first,
    their_fine,
    bricks,
    outer,
    inner,
    first,
    fine,
    offsets,
):
    states = np.empty(len(offsets), np.uint8)
    for n in range(len(offsets)):
        states[n] = _pair_state(
            number,
            their_outer,
            their_inner,
            their_first,
            their_fine,
            bricks,
            outer,
            inner,
            first,
            fine,
            offsets[n],
        )
    return states


@kernel
def _screen_offsets(
    number,
    their_outer,
    their_inner,
    their_first,
    their_fine,
    bricks,
    outer,
    inner,
    first,
    fine,
    own,
):
    nx, ny, nz = number.shape
    states = np.empty((nx + own[0] - 1, ny + own[1] - 1, nz + own[2] - 1), np.uint8)
    for x in range(states.shape[0]):
        for y in range(states.shape[1]):
            for z in range(states.shape[2]):
                offset = (x - own[0] + 1, y - own[1] + 1, z - own[2] + 1)
                states[x, y, z] = _pair_state(
                    number,
                    their_outer,
                    their_inner,
                    their_first,
                    their_fine,
                    bricks,
                    outer,
                    inner,
                    first,
                    fine,
                    offset,
                )
    return states
