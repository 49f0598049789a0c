"""Polycubes: unit cubes that are joined face to face, as closed surfaces."""

from __future__ import annotations

import itertools
from collections.abc import Collection

import numpy as np
import trimesh

from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.lattice import Triple

_SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))


def polycube(cells: Collection[Triple], inset: float) -> trimesh.Trimesh:
    """Create the surface of a polycube, drawn in so that polycubes on one lattice do not touch.

    Parameters
    ----------
    cells : collection of tuple
        The min corner (x, y, z) of each unit cube, on integers.
    inset : float
        By how much all faces are drawn in, more than 0 and less than 0.5.

    Returns
    -------
    trimesh.Trimesh
        The surface of all points that are farther than `inset`, along any axis, from the outside of
        the polycube. Cubes that share an edge or a corner alone are not joined.

    Raises
    ------
    ArgumentError
        If there is no cell, or the inset is not possible.
    """
    filled = set(cells)
    if not filled:
        raise ArgumentError("a polycube needs at least one cell")
    check_range("inset", inset, (0 < inset < 0.5, "more than 0 and less than 0.5"))
    solid = _blocks(filled)
    vertices: dict[Triple, int] = {}
    faces = []
    for block in sorted(solid):
        for axis, side in itertools.product(range(3), (0, 1)):
            if _moved(block, axis, 2 * side - 1) in solid:
                continue
            square = []
            for first, second in _SQUARE if side else _SQUARE[::-1]:
                corner = _moved(block, axis, side)
                corner = _moved(corner, (axis + 1) % 3, first)
                corner = _moved(corner, (axis + 2) % 3, second)
                square.append(vertices.setdefault(corner, len(vertices)))
            a, b, c, d = square
            faces += [(a, b, c), (a, c, d)]
    corners = np.array(list(vertices))
    points = corners // 2 + np.where(corners % 2, inset, -inset)
    return trimesh.Trimesh(points, faces, process=False)


def _blocks(filled: set[Triple]) -> set[Triple]:
    """Divide the solid into blocks: along an axis 2n + 1 is inside cube n, 2n is between cubes."""
    blocks = {
        _moved(_moved(_moved((2 * x, 2 * y, 2 * z), 0, a), 1, b), 2, c)
        for x, y, z in filled
        for a, b, c in itertools.product((0, 1), repeat=3)
    }
    return {block for block in blocks if _cubes_around(block) <= filled}


def _cubes_around(block: Triple) -> set[Triple]:
    (a, b), (c, d), (e, f) = (((n - 1) // 2, n // 2) for n in block)
    return {(x, y, z) for x in (a, b) for y in (c, d) for z in (e, f)}


def _moved(corner: Triple, axis: int, by: int) -> Triple:
    """Return an integer point moved along an axis."""
    x, y, z = (value + by * (n == axis) for n, value in enumerate(corner))
    return x, y, z
