"""Kernels that measure the surroundings of placements (see `placement_features`).

Contacts in six directions are counts of bits: the item's surface cells AND the cells that have a
filled neighbour in that direction (`neighbours`, computed once for a box). Shares of space come
from sums over all bricks before a node, so that any box of bricks is eight look-ups: a summed-area
table (Crow, 1984) in three dimensions.

Features are float32 and computed in a fixed order: a trained network depends on their exact values.
Nothing but the result is written.
"""

from __future__ import annotations

import numpy as np

from packit_agents.placements.free_kernels import TurnedArrays
from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.bits import FULL, HIGH, LOW
from packit_sim.geometry.word_kernels import count_bits
from packit_sim.placement import BoxArrays, brick_offsets

_ONE, _FOUR, _SIXTEEN = np.uint64(1), np.uint64(4), np.uint64(16)
"""Distances in bits between neighbours along z, y and x in a word."""

_THREE, _TWELVE, _FORTY_EIGHT = np.uint64(3), np.uint64(12), np.uint64(48)
"""Distances in bits between the first cell of a brick and the last of the brick before it."""

MEASURES = 24
"""Numbers that describe a placement; their names are in `features.PLACEMENT_FEATURES`."""

_BRICK = 64
"""Cells in a brick."""


@kernel
def neighbours(box, nz):
    """Find the cells that have a filled neighbour, in each of six directions.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    nz : int
        Its bricks along z.

    Returns
    -------
    Words
        uint64 (bricks, 8), in the directions -x, +x, -y, +y, -z and +z, and in any of them; the
        last word is not used. Walls and the floor count as filled, the space above the box does
        not.
    """
    box = BoxArrays(*box)
    nx, ny = box.nx, box.ny
    layer = nx * ny
    found = np.empty((layer * nz, 8), np.uint64)
    n = 0
    for k in range(nz):
        for i in range(nx):
            for j in range(ny):
                own = box.bricks[0, n]
                left = box.bricks[0, n - ny] if i > 0 else FULL
                right = box.bricks[0, n + ny] if i + 1 < nx else FULL
                back = box.bricks[0, n - 1] if j > 0 else FULL
                front = box.bricks[0, n + 1] if j + 1 < ny else FULL
                below = box.bricks[0, n - layer] if k > 0 else FULL
                above = box.bricks[0, n + layer] if k + 1 < nz else np.uint64(0)
                found[n, 0] = own << _SIXTEEN | left >> _FORTY_EIGHT
                found[n, 1] = own >> _SIXTEEN | (right & LOW[0]) << _FORTY_EIGHT
                found[n, 2] = (own & ~HIGH[1]) << _FOUR | (back & HIGH[1]) >> _TWELVE
                found[n, 3] = (own & ~LOW[1]) >> _FOUR | (front & LOW[1]) << _TWELVE
                found[n, 4] = (own & ~HIGH[2]) << _ONE | (below & HIGH[2]) >> _THREE
                found[n, 5] = (own & ~LOW[2]) >> _ONE | (above & LOW[2]) << _THREE
                # Six tests in one: most bricks of an item touch nothing.
                any_of = found[n, 0]
                for d in range(1, 6):
                    any_of |= found[n, d]
                found[n, 6] = any_of
                n += 1
    return found


@kernel
def sum_filled(box, nz):
    """Sum the filled cells over the bricks before each node: int32 [x, y, z]."""
    box = BoxArrays(*box)
    nx, ny = box.nx, box.ny
    sums = np.zeros((nx + 1, ny + 1, nz + 1), np.int32)
    n = 0
    for k in range(nz):
        for i in range(nx):
            row = 0
            for j in range(ny):
                row += count_bits(box.bricks[0, n])
                n += 1
                sums[i + 1, j + 1, k + 1] = (
                    row + sums[i + 1, j + 1, k] + sums[i, j + 1, k + 1] - sums[i, j + 1, k]
                )
    return sums


@inner_kernel
def _free(sums, low, high):
    """Return the share of a range of bricks that is not filled; 0 if there are none."""
    bricks = 1
    for d in range(3):
        bricks *= max(high[d] - low[d], 0)
    if bricks == 0:
        return np.float32(0)
    x0, y0, z0 = low[0], low[1], low[2]
    x1, y1, z1 = high[0], high[1], high[2]
    filled = (
        sums[x1, y1, z1]
        - sums[x0, y1, z1]
        - sums[x1, y0, z1]
        - sums[x1, y1, z0]
        + sums[x0, y0, z1]
        + sums[x0, y1, z0]
        + sums[x1, y0, z0]
        - sums[x0, y0, z0]
    )
    return np.float32(bricks - filled / _BRICK)


@kernel
def measure(box, sums, near, turned, placements):
    """Measure placements of an item.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    sums : ndarray
        As `sum_filled` returns it.
    near : Words
        As `neighbours` returns it.
    turned : TurnedArrays
        The item.
    placements : ndarray
        int32 (n, 4): rotation, x, y, z, those of a rotation together.

    Returns
    -------
    ndarray
        float32 (n, MEASURES), see `features.PLACEMENT_FEATURES`.
    """
    box, turned = BoxArrays(*box), TurnedArrays(*turned)
    count = np.zeros(6, np.int64)
    nodes = np.array([sums.shape[0] - 1, sums.shape[1] - 1, sums.shape[2] - 1])
    bricks = np.float32(nodes[0] * nodes[1] * nodes[2])
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    from_, to = np.empty(3, np.int64), np.empty(3, np.int64)
    found = np.empty((len(placements), MEASURES), np.float32)
    last = -1
    offsets = np.empty(0, np.int32)
    surface = np.empty(0, np.uint64)
    for n in range(len(placements)):
        # Placements of a rotation come together: its bricks are prepared once, those without
        # surface cells left out.
        r = placements[n, 0]
        if r != last:
            last = r
            begin, end = turned.starts[r], turned.starts[r + 1]
            all_offsets = brick_offsets(turned.bricks[begin:end], box.nx, box.ny)
            all_cells = turned.outer[begin:end] & ~turned.inner[begin:end]
            offsets, surface = all_offsets[all_cells != 0], all_cells[all_cells != 0]
        start = (placements[n, 3] * box.nx + placements[n, 1]) * box.ny + placements[n, 2]
        count[:] = 0
        for m in range(len(offsets)):
            at = start + offsets[m]
            own = surface[m]
            if own & near[at, 6]:
                for d in range(6):
                    count[d] += count_bits(own & near[at, d])
        cells = turned.cells[r]
        row = found[n]
        faces = np.float32(0)
        for d in range(3):
            face = np.float32(cells[(d + 1) % 3] * cells[(d + 2) % 3])
            faces += 2 * face
            row[2 * d], row[2 * d + 1] = count[2 * d] / face, count[2 * d + 1] / face
        row[6] = count.sum() / faces
        size = np.float32(1)
        for d in range(3):
            low[d] = placements[n, 1 + d]
            high[d] = low[d] + turned.extents[r, d]
            size *= turned.extents[r, d]
            box_cells = np.float32(4 * nodes[d])
            row[7 + d] = cells[d] / box_cells
            row[10 + d] = 4 * low[d] / box_cells
        row[13] = row[12] + row[9]
        row[14] = 1 - _free(sums, low, high) / size
        for d in range(3):
            from_[d], to[d] = max(low[d] - 1, 0), min(high[d] + 1, nodes[d])
        wider = np.float32((to[0] - from_[0]) * (to[1] - from_[1]) * (to[2] - from_[2]))
        row[15] = 1 - _free(sums, from_, to) / wider
        for d in range(3):
            from_[:], to[:] = low, high
            from_[d], to[d] = 0, low[d]
            row[16 + 2 * d] = _free(sums, from_, to) / bricks
            from_[d], to[d] = high[d], nodes[d]
            row[17 + 2 * d] = _free(sums, from_, to) / bricks
        row[22] = min(low[0], nodes[0] - high[0]) / nodes[0]
        row[23] = min(low[1], nodes[1] - high[1]) / nodes[1]
    return found
