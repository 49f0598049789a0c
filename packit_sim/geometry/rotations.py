"""The 24 rotations: the proper rotations of the cube, as exact signed permutations.

`index = 4 * face + turn`: `face` is the side of the canonical shape that faces down, in the order
-z, +z, -x, +x, -y, +y, and `turn` counts further quarter turns about z. Index 0 is the identity.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

COUNT = 24

_FACE_DOWN = (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
)
_QUARTER_TURN = np.array(((0, -1, 0), (1, 0, 0), (0, 0, 1)))

MATRICES: npt.NDArray[np.int64] = np.array(
    [
        np.linalg.matrix_power(_QUARTER_TURN, turn) @ np.array(face)
        for face in _FACE_DOWN
        for turn in range(4)
    ]
)
"""(24, 3, 3) rotation matrices with entries -1, 0 and 1."""

AXES: npt.NDArray[np.int64] = np.abs(MATRICES).argmax(axis=2)
"""(24, 3): the axis of the canonical shape that is turned to x, y and z."""

SIGNS: npt.NDArray[np.int64] = MATRICES.sum(axis=2)
"""(24, 3): -1 if that axis is reversed, else 1."""

for _table in (MATRICES, AXES, SIGNS):
    _table.setflags(write=False)

TIE = 1e-9
"""Extents that differ by less, in box units, count as equal when a shape is aligned."""


def turn_vectors(vectors: npt.NDArray[np.float64], rotation: int) -> npt.NDArray[np.float64]:
    """Turn vectors (..., 3), without rounding."""
    return vectors[..., AXES[rotation]] * SIGNS[rotation]


def turn_extents(extents: npt.NDArray[np.float64], rotation: int) -> npt.NDArray[np.float64]:
    """Turn extents (..., 3)."""
    return extents[..., AXES[rotation]]


def turn_array(array: npt.NDArray[Any], rotation: int) -> npt.NDArray[Any]:
    """Return a view of a centred array [x, y, z, ...] with its contents rotated."""
    x, y, z = AXES[rotation].tolist()
    turned = np.transpose(array, (x, y, z, *range(3, array.ndim)))
    return np.flip(turned, axis=tuple(np.flatnonzero(SIGNS[rotation] < 0).tolist()))


def aligned(extents: npt.ArrayLike) -> int:
    """Find the rotation that puts the smallest extent along z and the largest along y.

    Parameters
    ----------
    extents : array_like
        (3,) of the canonical shape.

    Returns
    -------
    int
        The lowest index if extents tie within `TIE`.
    """
    x, y, z = np.asarray(extents, dtype=float)[AXES].T
    return int(np.flatnonzero((z <= x + TIE) & (x <= y + TIE))[0])


def by_alignment(extents: npt.ArrayLike) -> tuple[int, ...]:
    """Sort the 24 rotations by the extent along z, then by that along x.

    Parameters
    ----------
    extents : array_like
        (3,) of the canonical shape.

    Returns
    -------
    tuple[int, ...]
        Indices; the first is `aligned`. If extents tie within `TIE` the lower index is first.
    """
    x, _, z = np.round(np.asarray(extents, dtype=float) / TIE)[AXES].T
    order = np.lexsort((np.arange(COUNT), x, z)).tolist()
    first = aligned(extents)
    return first, *(rotation for rotation in order if rotation != first)
