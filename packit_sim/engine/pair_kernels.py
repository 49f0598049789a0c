"""Kernels that compare the surfaces of two items at many offsets.

Conditions 3 and 4 of a feasible location (docs/concepts/exactness.md), cheapest test first:
shared outer fine cells (none: no common point), proofs in the cell with the most of them, proofs in
the region of all of them, and the winding number of a vertex of each part, only for surfaces that
are proved not to cross. What is `UNSURE` is left to FCL; everything else equals its answer.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.engine.containment_kernels import holds, points_within
from packit_sim.engine.crossing_kernels import APART, CROSSING, relation
from packit_sim.engine.region_kernels import relation_in, workspace
from packit_sim.engine.screening_kernels import shared_fine_cells
from packit_sim.geometry.lattice import CELL, FINE


@kernel
def relations(one, other, turn, to_first, shifts, bricks, other_bricks, offsets):
    """Decide whether two items on the grid are in conflict by their surfaces.

    Parameters
    ----------
    one, other : tuple
        The tree (see `crossing_kernels`), the parts (see `containment.PartArrays`), their outline
        and the rotation (3, 3) of each item.
    turn, to_first : ndarray
        See `pairs.relative_turn`.
    shifts : ndarray
        (n, 3) float64, from the centre of the first to that of the other.
    bricks, other_bricks : tuple
        The cells (3,) of the first's cell box with its `FixedArrays`, and the `ItemArrays` of the
        other.
    offsets : ndarray
        (n, 3) int64, from the cell box of the first to that of the other, in grid steps.

    Returns
    -------
    ndarray
        (n,) int64: `CROSSING` if the surfaces cross or a part of one is inside the other, `APART`
        if neither is true, `UNSURE` if there is no proof that they cross or don't.
    """
    tree, parts, outline, matrix = one
    other_tree, other_parts, other_outline, other_matrix = other
    states = np.empty(len(shifts), np.int64)
    moved = np.empty(3)
    cells = np.empty((2, 3), np.int64)
    densest = np.empty((2, 3), np.int64)
    region = np.empty((2, 3))
    space = workspace()
    size, fixed = bricks
    for n in range(len(shifts)):
        states[n] = APART
        if shared_fine_cells(fixed, other_bricks, offsets[n], cells, densest):
            for d in range(3):
                moved[d] = 0.0
                for e in range(3):
                    moved[d] += to_first[d, e] * shifts[n, e]
            # Of surfaces that cross, 19 in 20 cross in the cell with the most shared fine cells.
            _bound_cells(densest, size, to_first, region)
            states[n] = relation_in(tree, other_tree, turn, moved, region, space)
            if states[n] != CROSSING:
                _bound_cells(cells, size, to_first, region)
                states[n] = relation_in(tree, other_tree, turn, moved, region, space)
            if states[n] < 0:  # too many triangles in the region: two trees are faster
                states[n] = relation(tree, other_tree, turn, moved, region)
        # Where FCL has to decide about a crossing, the caller then asks for parts inside as well.
        if states[n] != APART:
            continue
        points, _, triangles, part, boxes, starts = parts
        others, _, other_triangles, other_part, other_boxes, other_starts = other_parts
        within = points_within(others, other_outline, outline, shifts[n])
        if len(within) and holds(
            within, triangles, part, boxes, starts, matrix, other_matrix, shifts[n]
        ):
            states[n] = CROSSING
            continue
        within = points_within(points, outline, other_outline, -shifts[n])
        if len(within) and holds(
            within,
            other_triangles,
            other_part,
            other_boxes,
            other_starts,
            other_matrix,
            matrix,
            -shifts[n],
        ):
            states[n] = CROSSING
    return states


@inner_kernel
def _bound_cells(cells, size, to_first, region):
    """Write the box of fine cells of a cell box to a region in the frame of the item's shape."""
    for d in range(3):
        region[0, d] = region[1, d] = 0.0
        for e in range(3):
            low = to_first[d, e] * (cells[0, e] * FINE - 0.5 * size[e] * CELL)
            high = to_first[d, e] * (cells[1, e] * FINE - 0.5 * size[e] * CELL)
            region[0, d] += min(low, high)
            region[1, d] += max(low, high)
