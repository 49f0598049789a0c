"""Whether two items' collision meshes cross, by FCL: the only room that knows it."""

from __future__ import annotations

from functools import cache

import fcl
import numpy as np

from packit_sim import rotations
from packit_sim.caches import bounded
from packit_sim.lattice import CELL, CONTACT_TOLERANCE, Triple
from packit_sim.occupancy import Placed
from packit_sim.shapes import Item

COLLISION_MESHES_BUDGET = 1_000_000
"""Triangles that the process's cache of collision meshes holds, roughly 1 kB each."""

COLLISIONS_BUDGET = 250_000
"""Answers of FCL that the process remembers, roughly 0.4 kB each."""


def collides(a: Placed, b: Placed) -> bool:
    """Whether FCL finds a triangle of one collision mesh that crosses one of the other.

    A fact of the two items and the whole half cells between their centres: the first in a fixed
    order of items stands at the origin, whatever the place in the box or the order of placing.
    """
    return _ask(*_canonical(a, b))


def collides_memo(a: Placed, b: Placed) -> bool:
    """As `collides`, and remembered: the engine's way to ask. The oracle asks anew each time."""
    return _remembered(*_canonical(a, b))


@bounded(
    "collisions",
    COLLISIONS_BUDGET,
    "answers",
    size=lambda answer: 1,
    key=lambda a, b, offset: (a.key, b.key, offset),
)
def _remembered(a: Item, b: Item, offset: Triple) -> bool:
    return _ask(a, b, offset)


def _canonical(a: Placed, b: Placed) -> tuple[Item, Item, Triple]:
    """Two items in a fixed order, and by how many grid nodes the second is beyond the first."""
    if (b.item.key, b.location) < (a.item.key, a.location):
        a, b = b, a
    (i, j, k), (u, v, w) = a.location, b.location
    return a.item, b.item, (u - i, v - j, w - k)


def _ask(a: Item, b: Item, offset: Triple) -> bool:
    beside = Placed(b, offset)
    half_cells = np.add(beside.start, beside.stop) - a.cells
    request = fcl.CollisionRequest(num_max_contacts=1, enable_contact=False)
    return bool(
        fcl.collide(
            fcl.CollisionObject(collision_mesh(a), fcl.Transform(_turn(a.rotation), np.zeros(3))),
            fcl.CollisionObject(
                collision_mesh(b), fcl.Transform(_turn(b.rotation), half_cells * (CELL / 2))
            ),
            request,
            fcl.CollisionResult(),
        )
    )


@bounded(
    "collision meshes",
    COLLISION_MESHES_BUDGET,
    "triangles",
    size=lambda model: model.num_tries_(),
    key=lambda item: (item.shape.digest, item.scale),
)
def collision_mesh(item: Item) -> fcl.BVHModel:
    """The shape at the item's scale, drawn in by half the contact tolerance on each side."""
    extents = Item(item.shape, item.scale).extents
    drawn_in = np.maximum(extents - CONTACT_TOLERANCE, 0) / extents
    mesh = item.shape.mesh
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(mesh.vertices * (np.cbrt(item.scale) * drawn_in), mesh.faces)
    model.endModel()
    return model


@cache
def _turn(rotation: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return rotations.MATRICES[rotation].astype(float)
