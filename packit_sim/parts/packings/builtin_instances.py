"""Built-in strip-packing instances: items made by formulas from a seed, known by name.

Of some, an optimal packing is known by construction, and with it the least height.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import trimesh
from trimesh import creation, transformations

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.polygons import cut_into_triangles
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement

__all__ = ["BuiltinInstance", "builtin_instance"]

DIGITS = 9
"""Digits after the decimal point of all coordinates, so that the meshes do not depend on the
processor's rounding."""

CUBE_SIDE = 10
"""Side of a cube that is cut."""

MIN_INWARDS = 0.05
"""How far each corner of a piece moves into it when its bounding box shrinks by 1 an axis."""

FLAT = 1e-6
"""Largest angle, in radians, between triangles of the same face of a convex body."""


class BuiltinInstance(NamedTuple):
    """A strip-packing instance.

    Attributes
    ----------
    types : tuple of ItemType
        The types of items, named as `write_instance` names their files.
    container : BoxContainer
        The strip.
    optimal : Packing or None
        A packing of least height, if one is known. It only moves the items; for which rotation
        sets it is optimal is documented with each instance.
    """

    types: tuple[ItemType, ...]
    container: BoxContainer
    optimal: Packing | None


class _Items(NamedTuple):
    """The items that a formula makes.

    name: that of the items. meshes: one of each type. demands: how many of each. corners: where
    the lower corner of each item is in an optimal packing, by types, then (demand, 3); or None.
    """

    name: str
    meshes: Sequence[trimesh.Trimesh]
    demands: Sequence[int]
    corners: Sequence[Sequence[Sequence[float]]] | None = None


def builtin_instance(name: str, rotations: str = "cube") -> BuiltinInstance:
    """Build an instance.

    Parameters
    ----------
    name : str
        Its name, such as "cut-cube-16".
    rotations : str
        The rotations that each item may take.

    Returns
    -------
    BuiltinInstance
        The instance; the same name gives the same meshes.

    Raises
    ------
    ArgumentError
        If there is no such instance, or no such set of rotations.
    """
    if name not in _INSTANCES:
        raise ArgumentError(f"no built-in instance {name!r}: choose from {', '.join(_INSTANCES)}")
    base, formula = _INSTANCES[name]
    made = formula(np.random.default_rng(list(name.encode())))
    types = []
    for number, (mesh, demand) in enumerate(zip(made.meshes, made.demands, strict=True), start=1):
        vertices = np.round(mesh.vertices - mesh.bounds[0], DIGITS)
        file = f"{made.name}-{number:02d}.obj"
        types.append(ItemType(file, vertices, mesh.faces, demand, rotations))
    container = BoxContainer((*base, math.inf))
    if made.corners is None:
        return BuiltinInstance(tuple(types), container, None)
    placements = tuple(
        Placement.from_matrix(number, transformations.translation_matrix(corner))
        for number, corners in enumerate(made.corners)
        for corner in corners
    )
    optimal = Packing(tuple(types), container, placements)
    return BuiltinInstance(optimal.types, container, optimal)


def polytope(rng: np.random.Generator) -> trimesh.Trimesh:
    """Create a convex polytope: the hull of twelve points on an ellipsoid.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of its points and radii.

    Returns
    -------
    trimesh.Trimesh
        The polytope.
    """
    directions = rng.normal(size=(12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return _hull(directions * rng.uniform(2, 4, 3))


def bracket(rng: np.random.Generator, profile: str) -> trimesh.Trimesh:
    """Create a bracket: a profile with sides of whole lengths, extruded along y.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of its sizes.
    profile : str
        "L", "U" or "T".

    Returns
    -------
    trimesh.Trimesh
        The bracket.
    """
    wide, high = rng.integers(4, 9, 2)
    thick, deep = rng.integers(1, 3), rng.integers(2, 6)
    left, right = (wide - thick) / 2, (wide + thick) / 2
    outlines = {
        "L": [(wide, thick), (thick, thick), (thick, high), (0, high)],
        "U": [(wide, high), (wide - thick, high), (wide - thick, thick), (thick, thick),
              (thick, high), (0, high)],
        "T": [(wide, thick), (right, thick), (right, high), (left, high), (left, thick),
              (0, thick)],
    }  # fmt: skip
    corners = [(0, 0), (wide, 0), *outlines[profile]]
    front = np.array([(x, 0, z) for x, z in corners], dtype=float)
    count = len(front)
    ends = cut_into_triangles(front)
    now, after = np.arange(count), (np.arange(count) + 1) % count
    faces = [ends, ends[:, ::-1] + count, quads(after, now, count + after, count + now)]
    back = front + np.array((0, deep, 0))
    return trimesh.Trimesh(np.concatenate([front, back]), np.concatenate(faces))


def gear(rng: np.random.Generator) -> trimesh.Trimesh:
    """Create a spur gear of radius 1 along z, with trapezoidal teeth and a bore.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of its number of teeth and its sizes.

    Returns
    -------
    trimesh.Trimesh
        The gear.
    """
    teeth = int(rng.integers(6, 17))
    root = rng.uniform(0.7, 0.88)
    around = 2 * np.pi / teeth * np.add.outer(np.arange(teeth), (-0.35, -0.15, 0.15, 0.35)).ravel()
    radii = np.tile((root, 1.0, 1.0, root), teeth)
    outline = radii[:, None] * np.column_stack([np.cos(around), np.sin(around)])
    bore = rng.uniform(0.2, 0.5) * outline / np.linalg.norm(outline, axis=1)[:, None]
    height = rng.uniform(0.15, 0.6)
    n = len(outline)
    ring = np.concatenate([outline, bore])
    vertices = np.concatenate([np.c_[ring, np.zeros(2 * n)], np.c_[ring, np.full(2 * n, height)]])
    now, after = np.arange(n), (np.arange(n) + 1) % n
    walls = [(0, 2 * n), (3 * n, n), (n, 0), (2 * n, 3 * n)]  # outside, bore, bottom and top
    faces = [quads(one + now, one + after, other + now, other + after) for one, other in walls]
    return trimesh.Trimesh(vertices, np.concatenate(faces))


def quads(one: Ints, one_after: Ints, other: Ints, other_after: Ints) -> Ints:
    """Connect two rows of n vertices by triangles.

    Parameters
    ----------
    one : ndarray of int64, shape (n,)
        The vertices of a row. A quadrilateral is `one`, `one_after`, `other_after`, `other`,
        anticlockwise from outside.
    one_after : ndarray of int64, shape (n,)
        The next vertex of each.
    other : ndarray of int64, shape (n,)
        The vertices of the other row.
    other_after : ndarray of int64, shape (n,)
        The next vertex of each.

    Returns
    -------
    ndarray of int64, shape (2 * n, 3)
        The triangles.
    """
    first = np.column_stack([one, one_after, other_after])
    return np.concatenate([first, np.column_stack([one, other_after, other])])


def _polytopes(kinds: int, demand: int, rng: np.random.Generator) -> _Items:
    return _Items("polytope", [polytope(rng) for _ in range(kinds)], [demand] * kinds)


def _brackets(rng: np.random.Generator) -> _Items:
    return _Items("bracket", [bracket(rng, profile) for profile in "LUTLUT"], [4] * 6)


def _gears(rng: np.random.Generator) -> _Items:
    meshes = [gear(rng).apply_scale(rng.uniform(2, 4)) for _ in range(4)]
    return _Items("gear", meshes, [3] * 4)


def _rings(_: np.random.Generator) -> _Items:
    """Rings as wide as the base, and pins for their bores.

    The rings lie on each other in the optimal packing. No two of them fit next to each other, and
    on edge they are higher than that.
    """
    ring, pin = creation.annulus(2, 5, 1, sections=32), creation.cylinder(1.9, 2, sections=32)
    rings = [(0, 0, z) for z in range(8)]
    pins = [(3.1, 3.1, z) for z in range(0, 8, 2)]
    return _Items("ring-or-pin", [ring, pin], [len(rings), len(pins)], [rings, pins])


def _cut_cube(count: int, is_slanted: bool, rng: np.random.Generator) -> _Items:
    """Halve the largest piece of a cube again and again: by any plane, or into cuboids.

    In the optimal packing the pieces are where they were, and leave no space.
    """
    pieces = [creation.box(bounds=[(0, 0, 0), (CUBE_SIDE,) * 3])]
    while len(pieces) < count:
        piece = max(pieces, key=lambda each: round(each.volume, 6))
        point, normal = piece.center_mass, rng.normal(size=3)
        if not is_slanted:
            point = np.round(piece.bounds[0] + rng.uniform(0.35, 0.65) * piece.extents)
            normal = np.eye(3)[piece.extents.argmax()]
        halves = [_half(piece, point, side * normal) for side in (1, -1)]
        if all(map(_is_checkable, halves)):
            pieces.remove(piece)
            pieces += halves
    return _Items("piece", pieces, [1] * count, [[piece.bounds[0]] for piece in pieces])


def _is_checkable(piece: trimesh.Trimesh) -> bool:
    """Return whether a piece that touches its neighbours counts as free of them.

    The check of a packing draws meshes in towards the centres of their bounding boxes (see
    `validity`). If the centre is outside a piece, or close to a face, that face moves outwards.
    """
    arms = (piece.triangles - piece.bounds.mean(axis=0)) / piece.extents
    inwards = (arms * piece.face_normals[:, None]).sum(axis=2)
    return float(inwards.min()) > MIN_INWARDS


def _half(piece: trimesh.Trimesh, point: Floats, normal: Floats) -> trimesh.Trimesh:
    """Return the part of a convex body that is above a plane."""
    heights = (piece.vertices - point) @ normal
    edges = piece.face_adjacency_edges[piece.face_adjacency_angles > FLAT]
    across = edges[heights[edges].prod(axis=1) < 0]
    one, other = piece.vertices[across[:, 0]], piece.vertices[across[:, 1]]
    low, high = heights[across].T
    cut = one + (low / (low - high))[:, None] * (other - one)
    return _hull(np.concatenate([piece.vertices[heights >= 0], cut]))


def _hull(points: Floats) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(points)


_INSTANCES: dict[str, tuple[tuple[float, float], Callable[[np.random.Generator], _Items]]] = {
    "polytopes-20": ((12, 12), partial(_polytopes, 5, 4)),
    "polytopes-60": ((16, 16), partial(_polytopes, 12, 5)),
    "brackets-24": ((12, 12), _brackets),
    "gears-12": ((10, 10), _gears),
    "rings-12": ((10, 10), _rings),
    "cuboids-16": ((CUBE_SIDE, CUBE_SIDE), partial(_cut_cube, 16, False)),
    "cut-cube-8": ((CUBE_SIDE, CUBE_SIDE), partial(_cut_cube, 8, True)),
    "cut-cube-16": ((CUBE_SIDE, CUBE_SIDE), partial(_cut_cube, 16, True)),
}
"""The base and the formula of each instance."""
assert tuple(_INSTANCES) == BUILTIN_NAMES
