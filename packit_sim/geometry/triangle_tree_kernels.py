"""Kernels that find the triangles of a tree of boxes (see `triangle_trees`) in a region."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, kernel

_STACK = 64
"""Nodes that can wait: more than the levels of a tree."""


@kernel
def meeting(tree, region):
    """Return the numbers of a surface's triangles whose boxes meet a region.

    Parameters
    ----------
    tree : tuple
        The triangles, boxes and starts of the tree.
    region : ndarray
        (2, 3) float64, the lowest and highest corner.

    Returns
    -------
    ndarray
        (k,) int64, in the order of the tree.
    """
    numbers = np.empty(len(tree[0]), np.int64)
    return numbers[: collect(tree, region, numbers)].copy()


@allocating_kernel
def collect(tree, region, numbers):
    """Write the numbers of a surface's triangles that meet a region; return how many, or -1."""
    triangles, boxes, starts = tree
    leaves = len(starts) - 1
    lx, ly, lz = region[0, 0], region[0, 1], region[0, 2]
    hx, hy, hz = region[1, 0], region[1, 1], region[1, 2]
    waiting = np.empty(_STACK, np.int64)
    waiting[0] = 1
    top = 1
    count = 0
    while top:
        top -= 1
        node = waiting[top]
        if (
            boxes[node, 0, 0] > hx
            or boxes[node, 1, 0] < lx
            or boxes[node, 0, 1] > hy
            or boxes[node, 1, 1] < ly
            or boxes[node, 0, 2] > hz
            or boxes[node, 1, 2] < lz
        ):
            continue
        if node < leaves:
            # The left child on top: numbers come out in the order of the tree.
            waiting[top], waiting[top + 1] = 2 * node + 1, 2 * node
            top += 2
            continue
        for n in range(starts[node - leaves], starts[node - leaves + 1]):
            is_outside = False
            for d in range(3):
                p, q, r = triangles[n, 0, d], triangles[n, 1, d], triangles[n, 2, d]
                is_above = min(p, q, r) > region[1, d]
                is_outside = is_outside or is_above or max(p, q, r) < region[0, d]
            if is_outside:
                continue
            if count == len(numbers):
                return -1
            numbers[count] = n
            count += 1
    return count
