"""Kernels that compare the bricks of an item with those of a box, or of another item.

Two levels of bits decide most locations without meshes: words of 64 cells are compared by AND, and
only cells that are surface for both by their words of 64 fine cells. Inner against outer proves a
conflict (`BLOCKED`), no shared outer fine cell proves that there is none (`FREE`); between them the
location is `OPEN`, and surfaces decide. The result does not depend on the order in which bricks
are compared, but its cost does: an item's bricks are shuffled (`Voxels`), and the brick that
blocked the last location comes first. The method is our own. No kernel here writes to its box.

A location's *state* is `FREE`, `OPEN` or `BLOCKED` (see `screening`). The arguments `box`,
`placed`, `item` and `fixed` are the fields of `BoxArrays`, `PlacedArrays`, `ItemArrays` and
`FixedArrays`; `size` counts the item's locations along x, y and z.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inlined, inner_kernel, kernel
from packit_sim.engine.occupancy_kernels import BoxArrays, PlacedArrays
from packit_sim.geometry.bits import FULL
from packit_sim.geometry.voxel_kernels import FixedArrays, ItemArrays
from packit_sim.geometry.word_kernels import count_bits, lowest_bit

FREE, OPEN, BLOCKED = 0, 1, 2
"""Ordered: the state for several placed items is the largest of those for each of them."""

_1 = np.uint64(1)

_LAYERS = np.array([0xFFFF, 0x000F_000F_000F_000F, 0x1111_1111_1111_1111], np.uint64)
"""The fine cells of the first layer of a word along x, y and z."""

_SHIFTS = 16, 4, 1
"""Bits from one layer to the next."""


@kernel
def screen(box, item, spans, size, known):
    """Return the states of all locations.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    item : ItemArrays
        The bricks of the item.
    spans : ndarray
        (n, 6) int64, first and last brick of each placed item along x, y and z.
    size : Triple
        The item's locations along x, y and z.
    known : ndarray
        Bool [x, y, z] over at least these locations: those that are not looked at, and get `FREE`.

    Returns
    -------
    States
        uint8 [x, y, z].
    """
    box, item = BoxArrays(*box), ItemArrays(*item)
    states = np.full(size, np.uint8(FREE))
    near = np.zeros(size, np.bool_)
    # Only locations where this item's bricks can meet those of a placed one; the others are free.
    extent = np.zeros(3, np.int64)
    for n in range(len(item.bricks)):
        for d in range(3):
            extent[d] = max(extent[d], item.bricks[n, d])
    for n in range(len(spans)):
        for i in range(max(spans[n, 0] - extent[0], 0), min(spans[n, 3] + 1, size[0])):
            for j in range(max(spans[n, 1] - extent[1], 0), min(spans[n, 4] + 1, size[1])):
                for k in range(max(spans[n, 2] - extent[2], 0), min(spans[n, 5] + 1, size[2])):
                    near[i, j, k] = True
    bricks, page, box_fine = box.bricks, box.page, box.fine
    outer, inner, first, fine = item.outer, item.inner, item.first, item.fine
    offsets = brick_offsets(item.bricks, box.nx, box.ny)
    blocker = 0
    for k in range(size[2]):
        for i in range(size[0]):
            for j in range(size[1]):
                if near[i, j, k] and not known[i, j, k]:
                    start = (k * box.nx + i) * box.ny + j
                    # The brick that blocked the last location often blocks the next one.
                    at = start + offsets[blocker]
                    state = BLOCKED
                    if not (bricks[0, at] & inner[blocker] | bricks[1, at] & outer[blocker]):
                        state, n = state_at(
                            bricks, page, box_fine, outer, inner, first, fine, offsets, start
                        )
                        blocker = n if state == BLOCKED else blocker
                    states[i, j, k] = state
    return states


@kernel
def mark_free(states, mask):
    """Set a mask True at locations that are free, and return those that are open: (n, 3) int64."""
    nx, ny, nz = states.shape
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                mask[i, j, k] |= states[i, j, k] == FREE
                count += states[i, j, k] == OPEN
    found = np.empty((count, 3), np.int64)
    n = 0
    for i in range(nx if count else 0):
        for j in range(ny):
            for k in range(nz):
                if states[i, j, k] == OPEN:
                    found[n, 0], found[n, 1], found[n, 2] = i, j, k
                    n += 1
    return found


@kernel
def screen_at(box, item, location):
    """Return the state of one location."""
    box, item = BoxArrays(*box), ItemArrays(*item)
    i, j, k = location
    offsets = brick_offsets(item.bricks, box.nx, box.ny)
    bricks, page, box_fine = box.bricks, box.page, box.fine
    outer, inner, first, fine = item.outer, item.inner, item.first, item.fine
    start = (k * box.nx + i) * box.ny + j
    state, _ = state_at(bricks, page, box_fine, outer, inner, first, fine, offsets, start)
    return state


@kernel
def next_unblocked(box, item, size, number):
    """Find the next location that is not blocked, in the order of (z, x, y).

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    item : ItemArrays
        The bricks of the item.
    size : Triple
        The locations along x, y and z to look at.
    number : int
        Number of the location to start at.

    Returns
    -------
    i, j, k : int
        The location.
    number : int
        Number of the next location.
    state : int
        Its state; `BLOCKED` if there is no such location.
    """
    box, item = BoxArrays(*box), ItemArrays(*item)
    bricks, page, box_fine = box.bricks, box.page, box.fine
    outer, inner, own_first, fine = item.outer, item.inner, item.first, item.fine
    offsets = brick_offsets(item.bricks, box.nx, box.ny)
    layer = size[0] * size[1]
    blocker = 0
    while number < layer * size[2]:
        # A row along y at a time: its bricks are consecutive words of the box, 64 of them one mask.
        k, rest = divmod(number, layer)
        i, first = divmod(rest, size[1])
        count = min(size[1] - first, 64)
        start = (k * box.nx + i) * box.ny + first
        # A brick that blocks a location often blocks the next ones.
        at = start + offsets[blocker]
        left = FULL >> np.uint64(64 - count)
        left &= ~brick_conflicts(bricks, at, count, outer[blocker], inner[blocker])
        while left:
            j = lowest_bit(left)
            left &= left - _1
            at = start + j + offsets[blocker]
            if not (bricks[0, at] & inner[blocker] | bricks[1, at] & outer[blocker]):
                state, blocker = state_at(
                    bricks, page, box_fine, outer, inner, own_first, fine, offsets, start + j
                )
                if state != BLOCKED:
                    return i, first + j, k, number + j + 1, state
        number += count
    return 0, 0, 0, number, BLOCKED


@inlined
def brick_conflicts(bricks, at, count, outer, inner):
    """Find where the cells of an item's brick conflict with those of a row of bricks in the box.

    Parameters
    ----------
    bricks : Words
        See `BoxArrays`.
    at : int
        Number of the first brick of the row.
    count : int
        Bricks in the row, up to 64.
    outer, inner : numpy.uint64
        The item's brick.

    Returns
    -------
    numpy.uint64
        A bit for each brick in the row.
    """
    found = np.uint64(0)
    for j in range(count):
        both = bricks[0, at + j] & inner | bricks[1, at + j] & outer
        found |= np.uint64(both != 0) << np.uint64(j)
    return found


@kernel
def open_pairs(item, placed, extent, locations):
    """Return (pairs, 2): numbers of a location, and of a placed item that leaves it open."""
    item, placed = ItemArrays(*item), PlacedArrays(*placed)
    pairs = np.empty((16, 2), np.int64)
    found = np.empty(len(placed.spans), np.int64)
    total = 0
    for n in range(len(locations)):
        location = (locations[n, 0], locations[n, 1], locations[n, 2])
        count = _open_with(item, placed, extent, location, found)
        if total + count > len(pairs):
            grown = np.empty((2 * (total + count), 2), np.int64)
            for m in range(total):
                grown[m, 0], grown[m, 1] = pairs[m, 0], pairs[m, 1]
            pairs = grown
        for m in range(count):
            pairs[total, 0], pairs[total, 1] = n, found[m]
            total += 1
    return pairs[:total]


@kernel
def screen_pair(fixed, item, offsets):
    """Return the states of an item at offsets (n, 3), in bricks, from a fixed one."""
    fixed, item = FixedArrays(*fixed), ItemArrays(*item)
    states = np.empty(len(offsets), np.uint8)
    for n in range(len(offsets)):
        states[n] = _pair_state(fixed, item, offsets[n])
    return states


@kernel
def screen_offsets(fixed, item, extent):
    """Return the states [x, y, z] at all offsets at which the bricks of two items can meet."""
    fixed, item = FixedArrays(*fixed), ItemArrays(*item)
    nx, ny, nz = fixed.number.shape
    states = np.empty((nx + extent[0] - 1, ny + extent[1] - 1, nz + extent[2] - 1), np.uint8)
    for x in range(states.shape[0]):
        for y in range(states.shape[1]):
            for z in range(states.shape[2]):
                offset = (x - extent[0] + 1, y - extent[1] + 1, z - extent[2] + 1)
                states[x, y, z] = _pair_state(fixed, item, offset)
    return states


@kernel
def shared_fine_cells(fixed, item, offset, found, densest):
    """Find the fine cells that are outer for two items.

    Only there can their surfaces have a common point.

    Parameters
    ----------
    fixed : FixedArrays
        The bricks of an item.
    item : ItemArrays
        The bricks of another one.
    offset : ndarray
        (3,) int64, its offset from the first, in bricks.
    found : ndarray
        (2, 3) int64, filled with the lowest of these fine cells, and the highest plus 1, in the
        cell box of the first.
    densest : ndarray
        (2, 3) int64, filled with the first fine cells of the cell that has the most of them, and
        the last plus 1.

    Returns
    -------
    bool
        True if there is one.
    """
    fixed, item = FixedArrays(*fixed), ItemArrays(*item)
    nx, ny, nz = fixed.number.shape
    found[0] = np.iinfo(np.int64).max
    found[1] = 0
    most = 0
    for n in range(len(item.bricks)):
        x = item.bricks[n, 0] + offset[0]
        y = item.bricks[n, 1] + offset[1]
        z = item.bricks[n, 2] + offset[2]
        if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
            continue
        m = fixed.number[x, y, z]
        if m < 0:
            continue
        shared = fixed.outer[m] & item.outer[n]
        surface = item.outer[n] & ~item.inner[n]
        fixed_surface = fixed.outer[m] & ~fixed.inner[m]
        while shared:
            bit = lowest_bit(shared)
            one = _1 << np.uint64(bit)
            shared &= shared - _1
            common = FULL
            if surface & fixed_surface & one:
                own = item.first[n] + count_bits(surface & one - _1)
                its = fixed.first[m] + count_bits(fixed_surface & one - _1)
                common = fixed.fine[its, 0] & item.fine[own, 0]
                if not common:
                    continue
            cell = (4 * x + (bit >> 4), 4 * y + (bit >> 2 & 3), 4 * z + (bit & 3))
            count = count_bits(common)
            if count > most:
                most = count
                for d in range(3):
                    densest[0, d], densest[1, d] = 4 * cell[d], 4 * cell[d] + 4
            for d in range(3):
                low, high = 4 * cell[d], 4 * cell[d] + 4
                if low >= found[0, d] and high <= found[1, d]:
                    continue
                while not common & _LAYERS[d] << np.uint64(_SHIFTS[d] * (low & 3)):
                    low += 1
                while not common & _LAYERS[d] << np.uint64(_SHIFTS[d] * (high - 1 & 3)):
                    high -= 1
                found[0, d] = min(found[0, d], low)
                found[1, d] = max(found[1, d], high)
    return found[1, 0] > 0


@kernel
def merge(states, table, reach, location, sign):
    """Raise the states of an item's locations to those of a no-fit table.

    Parameters
    ----------
    states : States
        uint8 [x, y, z] over the item's locations, changed in place.
    table : States
        uint8, indexed by `sign` times the item's offset from `location`, plus `reach`.
    reach : Triple
        Grid steps from the table's first offset to offset 0.
    location : Triple
        Location of the placed item.
    sign : int
        1 if the placed item is the table's first, -1 if it is the second.
    """
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    # The offsets that the table covers, cut to the locations; outside of it the pair can't meet.
    for d in range(3):
        first = -reach[d] if sign > 0 else reach[d] - table.shape[d] + 1
        low[d] = max(location[d] + first, 0)
        high[d] = min(location[d] + first + table.shape[d], states.shape[d])
    for i in range(low[0], high[0]):
        x = sign * (i - location[0]) + reach[0]
        for j in range(low[1], high[1]):
            y = sign * (j - location[1]) + reach[1]
            for k in range(low[2], high[2]):
                z = sign * (k - location[2]) + reach[2]
                states[i, j, k] = max(states[i, j, k], table[x, y, z])


@kernel
def brick_offsets(bricks, nx, ny):
    """Return by how much the number of each of an item's bricks exceeds that of its location."""
    offsets = np.empty(len(bricks), np.int32)
    for n in range(len(bricks)):
        offsets[n] = (bricks[n, 2] * nx + bricks[n, 0]) * ny + bricks[n, 1]
    return offsets


@inlined
def state_at(bricks, page, box_fine, outer, inner, first, fine, offsets, start):
    """Return the state of the location with brick number `start`, and the item's blocking brick."""
    state, n = FREE, -1
    while state != BLOCKED and n + 1 < len(offsets):
        n += 1
        at = start + offsets[n]
        if bricks[0, at] & outer[n]:
            brick = brick_state(bricks, page, box_fine, at, outer[n], inner[n], first[n], fine)
            state = max(state, brick)
    return state, n


@inlined
def brick_state(bricks, page, box_fine, at, outer, inner, first, fine):
    """Return the state of one brick of the item at the brick `at` of the box."""
    state, shared = FREE, bricks[0, at] & outer
    if bricks[0, at] & inner | bricks[1, at] & outer:
        state, shared = BLOCKED, np.uint64(0)
    while shared:
        bit = lowest_bit(shared)
        shared &= shared - _1
        kept = page[at]  # an index, because a view costs two reference counts for each brick
        # Rows of fine cells exist for surface cells only: the rank of this bit among them.
        own = first + count_bits(outer & ~inner & (_1 << np.uint64(bit)) - _1)
        if box_fine[kept, bit, 0] & fine[own, 1] | box_fine[kept, bit, 1] & fine[own, 0]:
            state, shared = BLOCKED, np.uint64(0)
        elif box_fine[kept, bit, 0] & fine[own, 0]:
            state = OPEN
    return state


@inner_kernel
def _open_with(item, placed, extent, location, found):
    """Write to `found` which placed items leave a location open, and return how many."""
    i, j, k = location
    spans = placed.spans
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
        at, brick, cell = placed.starts[n]
        fixed = FixedArrays(
            placed.number[at : at + x * y * z].reshape(x, y, z),
            placed.outer[brick:],
            placed.inner[brick:],
            placed.first[brick:],
            placed.fine[cell:],
        )
        offset = (i - spans[n, 0], j - spans[n, 1], k - spans[n, 2])
        if _pair_state(fixed, item, offset) == OPEN:
            found[count] = n
            count += 1
    return count


@inner_kernel
def _pair_state(fixed, item, offset):
    """Return the state of an item that is `offset` bricks away from a fixed one."""
    fixed, item = FixedArrays(*fixed), ItemArrays(*item)
    bricks, outer, inner, first, fine = item.bricks, item.outer, item.inner, item.first, item.fine
    fixed_outer, fixed_inner, fixed_fine = fixed.outer, fixed.inner, fixed.fine
    nx, ny, nz = fixed.number.shape
    state = FREE
    for n in range(len(bricks)):
        x, y, z = bricks[n, 0] + offset[0], bricks[n, 1] + offset[1], bricks[n, 2] + offset[2]
        if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
            continue
        m = fixed.number[x, y, z]
        if m < 0:
            continue
        shared = fixed_outer[m] & outer[n]
        if not shared:
            continue
        if fixed_outer[m] & inner[n] | fixed_inner[m] & outer[n]:
            return BLOCKED
        surface = outer[n] & ~inner[n]
        fixed_surface = fixed_outer[m] & ~fixed_inner[m]
        while shared:
            bit = lowest_bit(shared)
            shared &= shared - _1
            below = (_1 << np.uint64(bit)) - _1
            own = first[n] + count_bits(surface & below)
            its = fixed.first[m] + count_bits(fixed_surface & below)
            if fixed_fine[its, 0] & fine[own, 1] | fixed_fine[its, 1] & fine[own, 0]:
                return BLOCKED
            if fixed_fine[its, 0] & fine[own, 0]:
                state = OPEN
    return state
