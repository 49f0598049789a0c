"""Shapes that are hard for collision checks, made by hand or at random."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from trimesh import creation

from packit_sim.geometry.shapes import Item, Shape


def _joined(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    joined = trimesh.util.concatenate(meshes)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def _bowl() -> trimesh.Trimesh:
    """Create an open bowl with one thin wall: not watertight."""
    ball = creation.icosphere(subdivisions=3)
    return ball.submesh([np.flatnonzero(ball.triangles_center[:, 2] < 0)], append=True)


def _hollow_box() -> trimesh.Trimesh:
    """Create a closed box with a closed cavity: two surfaces, the inner one facing inwards."""
    cavity = creation.box((0.8, 0.8, 0.8))
    cavity.invert()
    return _joined([creation.box((1, 1, 1)), cavity])


def _soup() -> trimesh.Trimesh:
    """Create triangles that share nothing."""
    corners = np.random.default_rng(5).uniform(-1, 1, (40, 1, 3))
    triangles = corners + np.random.default_rng(6).uniform(-0.3, 0.3, (40, 3, 3))
    return trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(120).reshape(-1, 3), process=False)


def _tilted_cube() -> trimesh.Trimesh:
    cube = creation.box((1, 1, 1))
    cube.apply_transform(trimesh.transformations.rotation_matrix(0.6, (1, 2, 3)))
    return cube


CUBE = Shape.from_mesh(creation.box((1, 1, 1)), "cube")
BALL = Shape.from_mesh(creation.icosphere(subdivisions=3), "ball")
RING = Shape.from_mesh(creation.torus(0.5, 0.15, major_sections=32, minor_sections=16), "ring")
BOWL = Shape.from_mesh(_bowl(), "bowl")
HOLLOW = Shape.from_mesh(_hollow_box(), "hollow-box")
PLATE = Shape.from_mesh(creation.box((1, 0.7, 0.001)), "plate")
SOUP = Shape.from_mesh(_soup(), "soup")
TILTED = Shape.from_mesh(_tilted_cube(), "tilted-cube")
ZOO = (CUBE, BALL, RING, BOWL, HOLLOW, PLATE, SOUP, TILTED)


def random_item(shapes: tuple[Shape, ...], size: float, rng: np.random.Generator) -> Item:
    """Draw a shape with a diagonal of about `size` box units, in any rotation."""
    shape = shapes[rng.integers(len(shapes))]
    return Item(shape, (size * rng.uniform(0.5, 1.2)) ** 3, int(rng.integers(24)))


def item_of(mesh: trimesh.Trimesh, id: str = "mesh", rotation: int = 0) -> Item:
    """Create an item of a mesh in its real size, in box units."""
    return Item(Shape.from_mesh(mesh, id), float(np.linalg.norm(mesh.extents)) ** 3, rotation)


def _tube(radius: float, wall: float, height: float) -> trimesh.Trimesh:
    return creation.annulus(radius - wall, radius, height, sections=24)


def _shell(radius: float, wall: float, height: float) -> trimesh.Trimesh:
    """Create a closed can: its cavity is a separate part that faces inwards."""
    cavity = creation.cylinder(radius - wall, height - 2 * wall, sections=24)
    cavity.invert()
    return _joined([creation.cylinder(radius, height, sections=24), cavity])


def _frames(radius: float, wall: float, height: float) -> trimesh.Trimesh:
    """Create three separate thin bars and a separate open sheet."""
    bars = [creation.box((2 * radius, wall, wall)) for _ in range(3)]
    for n, bar in enumerate(bars):
        bar.apply_translation((0, n * height / 2, 0))
    sheet = creation.box((radius, height / 4, wall))
    sheet.update_faces(np.arange(12) > 1)
    sheet.apply_translation((0, height / 4, 0))
    return _joined([*bars, sheet])


def _plate(radius: float, wall: float, height: float) -> trimesh.Trimesh:
    return creation.box((2 * radius, height, wall))


THIN = (_plate, _tube, _shell, _frames)
"""Surfaces whose walls may be thinner than a fine cell, so that no cell of them is inner."""


def nested_pair(rng: np.random.Generator) -> tuple[Item, Item]:
    """Draw a thin shape, and a thinner one that may be inside its walls, turned at random."""
    make = THIN[rng.integers(len(THIN))]
    radius, height = rng.uniform(0.06, 0.11), rng.uniform(0.06, 0.15)
    wall = 10 ** rng.uniform(-3, -2)
    outer = make(radius, wall, height)
    kind = rng.integers(4)
    if kind == 0:  # in the middle of the wall, all around
        inner = make(radius - 0.3 * wall, 0.4 * wall, height - 0.6 * wall)
    elif kind == 1:  # a scrap
        inner = creation.box((*rng.uniform(0.1, 0.5, 2) * height, rng.uniform(0.1, 0.9) * wall))
    elif kind == 2:  # any other thin shape
        other = THIN[rng.integers(len(THIN))]
        inner = other(*(rng.uniform(0.3, 1, 3) * (radius, wall, height)))
    else:  # a scrap and a sheet that are not connected
        scraps = [creation.box(rng.uniform(0.1, 0.9) * wall * np.ones(3)) for _ in range(2)]
        scraps[1].apply_translation(rng.uniform(-1, 1, 3) * (radius, height / 2, height / 2))
        inner = _joined(scraps)
    turn = np.eye(4)
    if rng.random() < 0.5:
        angle = rng.choice((0.05, 1.0, np.pi)) * rng.uniform(-1, 1)
        turn = trimesh.transformations.rotation_matrix(angle, rng.normal(size=3))
    for mesh in (outer, inner):
        mesh.apply_transform(turn)
        if rng.random() < 0.2:  # not closed
            mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    rotation = int(rng.integers(24))
    return (
        item_of(outer, "outer", rotation),
        item_of(inner, "inner", rotation if rng.random() < 0.8 else 0),
    )
