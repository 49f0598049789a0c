"""The kernel that fills a box with cuboids, from below (see `cuboid_cover`)."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel

FOUND, NONE, STOPPED = 0, 1, 2
"""Outcomes of a search: a filling, the proof that there is none, or neither."""


@kernel
def fill_box(sides, counts, types, extents, box, tries):
    """Fill a box completely, by depth-first search over the piece in the lowest free corner.

    The lowest free cell (then the first along x, then along y) must be the low corner of a piece.
    What is filled is therefore a map of heights. A free run that no sum of sides can fill ends a
    branch: sums are bits of an integer, so that sides of the box have 62 steps at most.

    Parameters
    ----------
    sides : (t, 3) int64
        The sides of each type of pieces, in steps.
    counts : (t,) int64
        The number of pieces of each type.
    types : (c,) int64
        The type of each choice, in the order in which choices are tried.
    extents : (c, 3) int64
        The extents of each choice along x, y and z: sides of its type.
    box : (3,) int64
        The extents of the box, in steps.
    tries : int
        The number of partial fillings after which the search stops.

    Returns
    -------
    outcome : int
        FOUND, NONE or STOPPED.
    placed : (n, 4) int64
        For each piece, from below: its choice and the low corner x, y, z.
    """
    pieces = counts.sum()
    heights = np.zeros((box[0], box[1]), dtype=np.int64)
    left = counts.copy()
    placed = np.zeros((pieces, 4), dtype=np.int64)
    next_choice = np.zeros(pieces + 1, dtype=np.int64)
    runs = np.zeros((pieces + 1, 3), dtype=np.int64)
    sums = np.zeros(pieces + 1, dtype=np.int64)
    depth = 0
    is_new = True
    while depth < pieces:
        if is_new:
            if tries == 0:
                return STOPPED, placed
            tries -= 1
            low = box[2] + 1
            for x in range(box[0]):
                for y in range(box[1]):
                    if heights[x, y] < low:
                        low = heights[x, y]
                        placed[depth, 1], placed[depth, 2], placed[depth, 3] = x, y, low
            x, y = placed[depth, 1], placed[depth, 2]
            along_x = along_y = 0
            while x + along_x < box[0] and heights[x + along_x, y] == low:
                along_x += 1
            while y + along_y < box[1] and heights[x, y + along_y] == low:
                along_y += 1
            runs[depth] = along_x, along_y, box[2] - low
            reached = np.int64(1)
            for kind in range(len(sides)):
                a, b, c = sides[kind]
                for _ in range(left[kind]):
                    reached |= (reached << a) | (reached << b) | (reached << c)
                    reached &= (np.int64(1) << 62) - 1
            sums[depth] = reached
            can_fill = (reached >> along_y) & (reached >> runs[depth, 2]) & 1
            next_choice[depth] = 0 if can_fill else len(types)
        is_new = False
        x, y, z = placed[depth, 1], placed[depth, 2], placed[depth, 3]
        while next_choice[depth] < len(types):
            choice = next_choice[depth]
            next_choice[depth] += 1
            a, b, c = extents[choice]
            rest_y, rest_z = runs[depth, 1] - b, runs[depth, 2] - c
            if left[types[choice]] == 0 or a > runs[depth, 0] or rest_y < 0 or rest_z < 0:
                continue
            if not (sums[depth] >> rest_y) & (sums[depth] >> rest_z) & 1:
                continue
            if (heights[x : x + a, y : y + b] == z).all():
                heights[x : x + a, y : y + b] = z + c
                left[types[choice]] -= 1
                placed[depth, 0] = choice
                is_new = True
                break
        if is_new:
            depth += 1
        elif depth == 0:
            return NONE, placed
        else:
            depth -= 1
            choice, x, y, z = placed[depth]
            a, b, _ = extents[choice]
            heights[x : x + a, y : y + b] = z
            left[types[choice]] += 1
    return FOUND, placed
