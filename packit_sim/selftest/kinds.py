"""The kinds of items that `packit selftest` draws."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh
from trimesh import creation

from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.selftest.hard_shapes import ZOO, nested_pair, random_item

Rng = np.random.Generator


@cache
def _everyday() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


def library(rng: Rng) -> list[Item]:
    """Library meshes of all sizes."""
    everyday = _everyday()
    shapes = tuple(everyday[i] for i in rng.choice(everyday.ids, 10, replace=False))
    size = rng.uniform(0.3, 0.8)
    return [random_item(shapes, size, rng) for _ in range(14)]


def soups(rng: Rng) -> list[Item]:
    """Triangles that share nothing, of random sizes, and shapes made by hand."""
    shapes = []
    for n in range(4):
        count, spread = int(rng.integers(3, 120)), rng.uniform(0.05, 1)
        corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, spread, (count, 3, 3))
        faces = np.arange(3 * count).reshape(-1, 3)
        soup = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
        shapes.append(Shape.from_mesh(soup, f"soup {n}"))
    return [random_item((*shapes, *ZOO), rng.uniform(0.3, 0.7), rng) for _ in range(14)]


def shells(rng: Rng) -> list[Item]:
    """Open surfaces without a thickness, and plates thinner than a fine cell, tilted at random."""
    meshes = []
    for _ in range(2):
        ball = creation.icosphere(subdivisions=2)
        above = np.flatnonzero(ball.triangles_center[:, 2] > rng.uniform(-0.8, 0.5))
        meshes.append(ball.submesh([above], append=True))
        meshes.append(creation.box((1, rng.uniform(0.2, 1), 10 ** rng.uniform(-5, -2))))
        pipe = creation.cylinder(rng.uniform(0.1, 0.6), 1)
        side = np.flatnonzero(np.abs(pipe.face_normals[:, 2]) < 0.5)
        meshes.append(pipe.submesh([side], append=True))
    for mesh in meshes:
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    shapes = tuple(Shape.from_mesh(mesh, f"shell {n}") for n, mesh in enumerate(meshes))
    return [random_item(shapes, rng.uniform(0.3, 0.7), rng) for _ in range(12)]


def contacts(rng: Rng) -> list[Item]:
    """Blocks larger or smaller than whole cells by about the contact tolerance."""
    items = []
    for n in range(16):
        cells = rng.integers(1, 9, size=3) * rng.choice((1, 4, 4, 4), size=3)
        extents = cells / 100 + rng.choice((0, 0.3, 0.9, 1.1, 2), size=3) * (
            CONTACT_TOLERANCE * rng.choice((-1, 1), size=3)
        )
        block = Shape.from_mesh(creation.box(extents), f"block {n}")
        scale = float(np.linalg.norm(extents)) ** 3
        items.append(Item(block, scale, int(rng.integers(24))))
    return items


def extremes(rng: Rng) -> list[Item]:
    """Items of all sizes side by side, from a fraction of a cell to about the box."""
    everyday = _everyday()
    shapes = (*ZOO, *(everyday[i] for i in rng.choice(everyday.ids, 4, replace=False)))
    sizes = 10 ** rng.uniform(-2.5, 0.1, size=14)
    return [random_item(shapes, size, rng) for size in sizes]


def nested(rng: Rng) -> list[Item]:
    """Thin shapes, and thinner ones that may be inside their walls."""
    pairs = [nested_pair(rng) for _ in range(7)]
    return [item for pair in pairs for item in pair]


KINDS: dict[str, Callable[[Rng], list[Item]]] = {
    draw.__name__: draw for draw in (library, soups, shells, contacts, extremes, nested)
}
"""Functions that draw items, by the name of the kind."""
