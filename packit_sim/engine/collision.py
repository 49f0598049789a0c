"""Whether two items' collision meshes cross, by FCL: the only room that knows it."""

from __future__ import annotations

import threading
from functools import cache

import fcl
import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.core.counters import count_fcl_call
from packit_sim.engine.occupancy import ItemInBox, PlacedItem
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL, CONTACT_TOLERANCE, STEP, Triple
from packit_sim.geometry.shapes import Item, Shape

COLLISION_MESHES_BUDGET = 2_000_000
"""Triangles that the process's cache of collision meshes holds, roughly 0.7 kB each."""

COLLISIONS_BUDGET = 250_000
"""Answers of FCL that the process remembers, roughly 0.4 kB each."""

BODY_COLLISIONS_BUDGET = 100_000
"""Such answers about bodies off the grid."""

_moving = threading.Lock()
"""Held while a mesh is somewhere for a question."""

_REQUEST = fcl.CollisionRequest(num_max_contacts=1, enable_contact=False)


def collides(a: PlacedItem, b: PlacedItem) -> bool:
    """Whether FCL finds a triangle of one collision mesh that crosses one of the other.

    A fact of the two items and the whole half cells between their centres: the first in a fixed
    order of items stands at the origin, whatever the place in the box or the order of placing.
    """
    return _ask(*_canonical(a, b))


def collides_memo(a: PlacedItem, b: PlacedItem) -> bool:
    """As `collides`, and remembered: the engine's way to ask. The oracle asks anew each time."""
    return _remembered(*_canonical(a, b))


@bounded_cache(
    "collisions",
    COLLISIONS_BUDGET,
    "answers",
    size=lambda answer: 1,
    key=lambda a, b, offset: (a.key, b.key, offset),
)
def _remembered(a: Item, b: Item, offset: Triple) -> bool:
    count_fcl_call()
    return _ask(a, b, offset)


def _canonical(a: PlacedItem, b: PlacedItem) -> tuple[Item, Item, Triple]:
    """Two items in a fixed order, and by how many grid nodes the second is beyond the first."""
    if (b.item.key, b.location) < (a.item.key, a.location):
        a, b = b, a
    (i, j, k), (u, v, w) = a.location, b.location
    return a.item, b.item, (u - i, v - j, w - k)


def _ask(a: Item, b: Item, offset: Triple) -> bool:
    half_cells = [
        2 * STEP * steps + own - theirs
        for steps, own, theirs in zip(offset, b.cells, a.cells, strict=True)
    ]
    fixed = collision_mesh(a).fixed(a.rotation)
    moving = collision_mesh(b).moving(b.rotation)
    with _moving:
        moving.setTranslation(np.array(half_cells) * (CELL / 2))
        return bool(fcl.collide(fixed, moving, _REQUEST, fcl.CollisionResult()))


def meets(placed: PlacedItem, body: ItemInBox) -> bool:
    """As `collides`, of an item on the grid and one that may be anywhere, in any turn.

    The pose of the second is taken as seen from the centre of the first.
    """
    turn = body.pose[:3, :3] / np.cbrt(body.item.scale)
    there = fcl.Transform(turn, body.pose[:3, 3] - placed.center)
    fixed = collision_mesh(placed.item).fixed(placed.item.rotation)
    loose = collision_mesh(body.item).loose
    with _moving:
        loose.setTransform(there)
        return bool(fcl.collide(fixed, loose, _REQUEST, fcl.CollisionResult()))


@bounded_cache(
    "collisions with bodies",
    BODY_COLLISIONS_BUDGET,
    "answers",
    size=lambda answer: 1,
    key=lambda placed, body: (placed.item.key, placed.location, body.item.key, body.pose.tobytes()),
)
def meets_memo(placed: PlacedItem, body: ItemInBox) -> bool:
    """As `meets`, and remembered."""
    count_fcl_call()
    return meets(placed, body)


class CollisionMesh:
    """A shape at a scale as FCL sees it: drawn in by half the contact tolerance on each side."""

    def __init__(self, shape: Shape, scale: float) -> None:
        extents = Item(shape, scale).extents
        drawn_in = np.maximum(extents - CONTACT_TOLERANCE, 0) / extents
        vertices, faces = np.asarray(shape.mesh.vertices), np.asarray(shape.mesh.faces)
        self.triangles = len(faces)
        self.model = fcl.BVHModel()
        self.model.beginModel(len(vertices), len(faces))
        self.model.addSubModel(vertices * (np.cbrt(scale) * drawn_in), faces)
        self.model.endModel()
        self._fixed: dict[int, fcl.CollisionObject] = {}
        self._moving: dict[int, fcl.CollisionObject] = {}

    def fixed(self, rotation: int) -> fcl.CollisionObject:
        """Turned, and centred on the origin."""
        return self._turned(self._fixed, rotation)

    def moving(self, rotation: int) -> fcl.CollisionObject:
        """Turned, and wherever it was put last."""
        return self._turned(self._moving, rotation)

    @cached_property
    def loose(self) -> fcl.CollisionObject:
        """Turned and put wherever it was last."""
        return fcl.CollisionObject(self.model, fcl.Transform())

    def _turned(self, made: dict[int, fcl.CollisionObject], rotation: int) -> fcl.CollisionObject:
        if rotation not in made:  # python-fcl never frees all of one: so none is made twice
            there = fcl.Transform(_turn(rotation), np.zeros(3))
            made[rotation] = fcl.CollisionObject(self.model, there)
        return made[rotation]


@bounded_cache(
    "collision meshes",
    COLLISION_MESHES_BUDGET,
    "triangles",
    size=lambda mesh: mesh.triangles,
    key=lambda item: (item.shape.digest, item.scale),
)
def collision_mesh(item: Item) -> CollisionMesh:
    """The collision mesh of an item's shape at its scale."""
    return CollisionMesh(item.shape, item.scale)


@cache
def _turn(rotation: int) -> npt.NDArray[np.float64]:
    return rotations.MATRICES[rotation].astype(float)


class LooseMesh:
    """A mesh somewhere, off the grid, as FCL sees it.

    vertices: (n, 3) in box units, where they are. faces: (m, 3).
    """

    def __init__(self, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> None:
        model = fcl.BVHModel()
        model.beginModel(len(vertices), len(faces))
        model.addSubModel(vertices, faces)
        model.endModel()
        self._object = fcl.CollisionObject(model, fcl.Transform())

    def crosses(self, other: LooseMesh, shift: npt.ArrayLike = (0.0, 0.0, 0.0)) -> bool:
        """Whether FCL finds a triangle of one that crosses one of the other, shifted by (3,)."""
        with _moving:
            other._object.setTranslation(np.array(shift))
            return bool(fcl.collide(self._object, other._object, _REQUEST, fcl.CollisionResult()))
