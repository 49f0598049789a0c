"""Hand-made shapes that are hard for collision checks, and boxes filled with them."""

from __future__ import annotations

import numpy as np
import trimesh
from trimesh import creation

from packit_sim.box import Box
from packit_sim.geometry.shapes import Item, Shape


def _bowl() -> trimesh.Trimesh:
    """An open bowl with one thin wall: not watertight."""
    ball = creation.icosphere(subdivisions=3)
    return ball.submesh([np.flatnonzero(ball.triangles_center[:, 2] < 0)], append=True)


def _hollow_box() -> trimesh.Trimesh:
    """A closed box with a closed cavity: two surfaces, the inner one facing inwards."""
    cavity = creation.box((0.8, 0.8, 0.8))
    cavity.invert()
    return trimesh.util.concatenate([creation.box((1, 1, 1)), cavity])


def _soup() -> trimesh.Trimesh:
    """Triangles that share nothing."""
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


def cube_of(cells: float) -> Item:
    """A cube of so many cells a side."""
    return Item(CUBE, scale=(cells / 100 * 3**0.5) ** 3)


def random_item(shapes: tuple[Shape, ...], size: float, rng: np.random.Generator) -> Item:
    """A shape with a diagonal of about `size` box units, in any rotation."""
    shape = shapes[rng.integers(len(shapes))]
    return Item(shape, (size * rng.uniform(0.5, 1.2)) ** 3, int(rng.integers(24)))


def fill(box: Box, items: list[Item], rng: np.random.Generator) -> None:
    """Places what fits, each at a feasible location by chance, half of them at the BLBF one."""
    for item in items:
        locations = np.argwhere(box.feasible(item))
        if len(locations):
            bottom_left_back = rng.random() < 0.5
            location = box.blbf(item) if bottom_left_back else rng.choice(locations)
            assert location is not None
            box.place(item, location)
