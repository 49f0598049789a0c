"""Kernel that finds where a shape may fit into the holes of a box (see `holes`)."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel
from packit_sim.engine.occupancy_kernels import BoxArrays

_1 = np.uint64(1)


@kernel
def find_holes(box, points, shallow, coarse, turns, limits, each, found):
    """Find placements at which no point of a shape is inside an item.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    points : ndarray
        (n, 3) float64, points of the shape relative to its centre, in fine cells.
    shallow : ndarray
        (n,) uint8. 0 for points so deep inside that no surface of another item may be in their fine
        cell; 1 for the others, which must not be in an inner fine cell.
    coarse : int
        The number of points to compare first.
    turns : ndarray
        (turns, 9) int64, for each turn of the shape: axes and signs (see `rotations`), and the
        cells along x, y and z.
    limits : ndarray
        (turns, 3) int64, the number of locations along x, y and z; 0 or less if it does not fit.
    each : int
        The number of placements to find for each turn.
    found : ndarray
        (most, 4) int64, filled with placements: the number of the turn, and the location.

    Returns
    -------
    int
        The number of placements written; the search ends when `found` is full.
    """
    box = BoxArrays(*box)
    at = np.empty(len(points), np.int64)
    cell = np.empty(len(points), np.uint64)
    fine = np.empty(len(points), np.uint64)
    count = 0
    for turn in range(len(turns)):
        if limits[turn].min() <= 0:
            continue
        known = _locate(points, turns[turn], box.nx, box.ny, 0, coarse, at, cell, fine)
        last = 0
        enough = min(count + each, len(found))
        for k in range(limits[turn, 2]):
            for i in range(limits[turn, 0]):
                for j in range(limits[turn, 1]):
                    if count == enough:
                        break
                    start = (k * box.nx + i) * box.ny + j
                    if _taken(box, start + at[last], cell[last], fine[last], shallow[last]):
                        continue
                    n = _first_taken(box, start, at, cell, fine, shallow, 0, coarse)
                    if n < 0 and coarse < len(points):
                        if known < len(points):
                            known = _locate(
                                points, turns[turn], box.nx, box.ny, coarse, len(points),
                                at, cell, fine,
                            )  # fmt: skip
                        n = _first_taken(box, start, at, cell, fine, shallow, coarse, len(points))
                    if n >= 0:
                        last = n
                        continue
                    found[count, 0] = turn
                    found[count, 1], found[count, 2], found[count, 3] = i, j, k
                    count += 1
        if count == len(found):
            break
    return count


@kernel
def _locate(points, turn, nx, ny, start, stop, at, cell, fine):
    """Compute the brick, the cell and the fine cell of turned points at the box's origin."""
    place = np.empty(3, np.int64)
    for n in range(start, stop):
        for d in range(3):
            cells = turn[6 + d]
            own = int(np.floor(points[n, turn[d]] * turn[3 + d] + 2 * cells))
            place[d] = min(max(own, 0), 4 * cells - 1)
        x, y, z = place
        at[n] = ((z >> 4) * nx + (x >> 4)) * ny + (y >> 4)
        cell[n] = np.uint64(16 * (x >> 2 & 3) + 4 * (y >> 2 & 3) + (z >> 2 & 3))
        fine[n] = np.uint64(16 * (x & 3) + 4 * (y & 3) + (z & 3))
    return stop


@kernel
def _first_taken(box, start, at, cell, fine, shallow, first, stop):
    """Return the first of some points that is inside an item; -1 if there is none."""
    for n in range(first, stop):
        if _taken(box, start + at[n], cell[n], fine[n], shallow[n]):
            return n
    return -1


@kernel
def _taken(box, brick, cell, fine, which):
    """Decide whether a point's fine cell is inner, or outer if `which` is 0."""
    if box.bricks[brick, 1] >> cell & _1:
        return True
    if not box.bricks[brick, 0] >> cell & _1:
        return False
    return (box.fine[box.page[brick], cell, which] >> fine & _1) != 0
