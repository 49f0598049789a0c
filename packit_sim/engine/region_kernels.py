"""Kernels that decide whether two surfaces cross in a region, by the few triangles that meet it.

Surfaces can only meet in fine cells that are outer for both items, which bound a region that is
usually small. Then collecting each surface's triangles there and testing all pairs is faster than
descending two trees together (`crossing_kernels.relation`), which would compare many pairs of
boxes. The proofs are the same: `apart` and `cross`, with their margin.

Invariant: a region grown by the margin contains all common points, so that triangles outside of it
prove nothing and are left out. A `Workspace` is overwritten; one serves all offsets of a pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.engine.crossing_kernels import APART, CROSSING, MARGIN, UNSURE, apart, cross
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.triangle_tree_kernels import collect

MAX_TRIANGLES = 256
"""Limit of each surface's triangles; with more, two trees are faster than all pairs."""


class Workspace(NamedTuple):
    """Arrays for the triangles of two surfaces that meet a region.

    Attributes
    ----------
    numbers, other_numbers : ndarray
        (MAX_TRIANGLES,) int64, the triangles' numbers.
    corners : ndarray
        (MAX_TRIANGLES, 3, 3) float64, the corners of the other surface's triangles, moved.
    boxes, other_boxes : ndarray
        (MAX_TRIANGLES, 2, 3) float64, lowest and highest corners of their boxes.
    """

    numbers: Ints
    other_numbers: Ints
    corners: Floats
    boxes: Floats
    other_boxes: Floats


@kernel
def workspace():
    """Return a `Workspace`, not filled."""
    return Workspace(
        np.empty(MAX_TRIANGLES, np.int64),
        np.empty(MAX_TRIANGLES, np.int64),
        np.empty((MAX_TRIANGLES, 3, 3)),
        np.empty((MAX_TRIANGLES, 2, 3)),
        np.empty((MAX_TRIANGLES, 2, 3)),
    )


@kernel
def relation_in(one, other, turn, shift, region, space):
    """Decide whether two surfaces cross, by all pairs of triangles that meet a region.

    Parameters
    ----------
    one, other, turn, shift, region
        See `crossing_kernels.relation`.
    space : Workspace
        Overwritten.

    Returns
    -------
    int
        `APART`, `CROSSING`, or `UNSURE` if neither is proved; -1 if there are too many triangles.
    """
    triangles, others = one[0], other[0]
    numbers, other_numbers, corners, boxes, other_boxes = space
    wide = np.empty((2, 3))
    turned = np.empty((2, 3))
    # The region in each item's frame. Grown in both: turning by signs and axes is exact, shifting
    # is rounded.
    for d in range(3):
        wide[0, d], wide[1, d] = region[0, d] - MARGIN, region[1, d] + MARGIN
        p = turn[1, d] * (wide[0, d] - shift[d])
        q = turn[1, d] * (wide[1, d] - shift[d])
        turned[0, turn[0, d]], turned[1, turn[0, d]] = min(p, q) - MARGIN, max(p, q) + MARGIN
    count = collect(one, wide, numbers)
    # Without triangles of the first surface the second need not be looked at.
    other_count = collect(other, turned, other_numbers) if count else 0
    if count < 0 or other_count < 0:
        return -1
    for m in range(other_count):
        for d in range(3):
            for corner in range(3):
                at = others[other_numbers[m], corner, turn[0, d]]
                corners[m, corner, d] = turn[1, d] * at + shift[d]
        _bound(corners, m, wide, other_boxes, m)
    # Boxes cut to the region: triangles that only meet outside of it are no pair.
    for n in range(count if other_count else 0):
        _bound(triangles, numbers[n], wide, boxes, n)
    unsure = False
    for m in range(other_count):
        lx, ly, lz = other_boxes[m, 0, 0], other_boxes[m, 0, 1], other_boxes[m, 0, 2]
        hx, hy, hz = other_boxes[m, 1, 0], other_boxes[m, 1, 1], other_boxes[m, 1, 2]
        for n in range(count):
            if (
                boxes[n, 0, 0] > hx
                or boxes[n, 1, 0] < lx
                or boxes[n, 0, 1] > hy
                or boxes[n, 1, 1] < ly
                or boxes[n, 0, 2] > hz
                or boxes[n, 1, 2] < lz
                or apart(triangles, numbers[n], corners, m)
            ):
                continue
            if cross(triangles, numbers[n], corners, m):
                return CROSSING
            unsure = True
    return UNSURE if unsure else APART


@inner_kernel
def _bound(triangles, n, region, boxes, k):
    """Write the box of a triangle in a region, grown by the margin, to boxes[k]."""
    for d in range(3):
        p, q, r = triangles[n, 0, d], triangles[n, 1, d], triangles[n, 2, d]
        boxes[k, 0, d] = max(min(p, q, r) - MARGIN, region[0, d])
        boxes[k, 1, d] = min(max(p, q, r) + MARGIN, region[1, d])
