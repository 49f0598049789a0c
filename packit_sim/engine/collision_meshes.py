"""Meshes that FCL compares: of shapes at a scale, and of any triangles.

The only module that imports FCL.
"""

from __future__ import annotations

import threading
from typing import Any

import fcl
import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.engine.containment import ClosedPart, PartArrays
from packit_sim.engine.crossing_kernels import CROSSING, UNSURE, relation
from packit_sim.engine.pairs import Pair, matrix
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.geometry.triangle_trees import boxes_of

COLLISION_MESHES_BUDGET = 800_000
"""Triangles in the process's cache of collision meshes: 0.23 kB each, and 0.8 kB once FCL was asked
about their mesh."""

_moving = threading.Lock()
"""Held while a mesh is moved for a query."""

_NO_TURN = np.eye(3)

_AS_IT_IS = np.array([[0, 1, 2], [1, 1, 1]])
"""The rotation of `crossing_kernels.relation` that changes nothing."""

_REQUEST = fcl.CollisionRequest(num_max_contacts=1, enable_contact=False)


class CollisionMesh:
    """The FCL mesh of a shape at a scale, shrunk by half the contact tolerance on each side.

    Parameters
    ----------
    scale : float
        The scale of its volume.
    """

    def __init__(self, shape: Shape, scale: float) -> None:
        extents = Item(shape, scale).extents
        shrink = np.maximum(extents - CONTACT_TOLERANCE, 0) / extents
        vertices, faces = np.asarray(shape.mesh.vertices), np.asarray(shape.mesh.faces)
        self._shape = shape
        self.triangles = len(faces)
        self._vertices = vertices * (np.cbrt(scale) * shrink)
        self._fixed: dict[int, fcl.CollisionObject] = {}
        self._moving: dict[int, fcl.CollisionObject] = {}
        self._outlines: dict[int, npt.NDArray[np.float64]] = {}

    @cached_property
    def model(self) -> fcl.BVHModel:
        """FCL's tree of boxes."""
        model = fcl.BVHModel()
        model.beginModel(len(self._vertices), self.triangles)
        model.addSubModel(self._vertices, np.asarray(self._shape.mesh.faces))
        model.endModel()
        return model

    @cached_property
    def tree(self) -> tuple[Floats, Floats, Ints]:
        """The triangles, boxes and starts of the tree that proofs use (see `triangle_trees`)."""
        triangles = self._vertices[np.asarray(self._shape.mesh.faces)[self._shape.order]]
        return triangles, *boxes_of(triangles)

    def fixed(self, rotation: int) -> fcl.CollisionObject:
        """Look up the rotated mesh that is centred on the origin."""
        return self._rotated(self._fixed, rotation)

    def moving(self, rotation: int) -> fcl.CollisionObject:
        """Look up the rotated mesh that queries translate."""
        return self._rotated(self._moving, rotation)

    @cached_property
    def loose(self) -> fcl.CollisionObject:
        """Collision object that queries rotate and translate."""
        return fcl.CollisionObject(self.model, fcl.Transform())

    @cached_property
    def parts(self) -> PartArrays:
        """Connected parts of the mesh."""
        return PartArrays.of(self._vertices, self._shape.parts)

    @cached_property
    def closed_parts(self) -> list[ClosedPart]:
        """Closed parts of the mesh, which only the oracle uses."""
        return ClosedPart.all_of(self.parts)

    def crosses(self, other: CollisionMesh, pair: Pair) -> bool:
        """Decide whether this mesh crosses another one, where a pair has the two."""
        fixed = self.fixed(pair.item.rotation)
        with _moving:
            if pair.loose_turn is None:
                moving = other.moving(pair.other.rotation)
                moving.setTranslation(pair.shift)
            else:
                moving = other.loose
                moving.setTransform(fcl.Transform(pair.loose_turn, pair.shift))
            return _collide(fixed, moving)

    def compared(self, rotation: int) -> tuple[Any, ...]:
        """Look up what `pair_kernels.relations` compares: tree, parts, outline and rotation."""
        return self.tree, tuple(self.parts), self.outline(rotation), matrix(rotation)

    def outline(self, rotation: int) -> npt.NDArray[np.float64]:
        """Look up the rotated outline of the parts."""
        if rotation not in self._outlines:
            self._outlines[rotation] = self.parts.outline(matrix(rotation))
        return self._outlines[rotation]

    def _rotated(
        self, objects: dict[int, fcl.CollisionObject], rotation: int
    ) -> fcl.CollisionObject:
        if rotation not in objects:  # python-fcl never frees one entirely: create none twice
            transform = fcl.Transform(matrix(rotation), np.zeros(3))
            objects[rotation] = fcl.CollisionObject(self.model, transform)
        return objects[rotation]


@bounded_cache(
    "collision meshes",
    COLLISION_MESHES_BUDGET,
    "triangles",
    size=lambda mesh: mesh.triangles,
    key=lambda item: (item.shape.digest, item.scale),
)
def collision_mesh(item: Item) -> CollisionMesh:
    """Look up the collision mesh of an item's shape at its scale."""
    return CollisionMesh(item.shape, item.scale)


class LooseMesh:
    """The FCL mesh of any triangles, off the grid.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        Its vertices, in box units.
    faces : ndarray of int64, shape (m, 3)
        Its triangles, as indices of vertices.
    """

    def __init__(self, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> None:
        self._model = fcl.BVHModel()
        self._model.beginModel(len(vertices), len(faces))
        self._model.addSubModel(vertices, faces)
        self._model.endModel()

    @cached_property
    def _fixed(self) -> fcl.CollisionObject:
        return fcl.CollisionObject(self._model, fcl.Transform())

    @cached_property
    def _moving(self) -> fcl.CollisionObject:
        """Another object, so that a mesh can be compared with itself in another pose."""
        return fcl.CollisionObject(self._model, fcl.Transform())

    def crosses(
        self,
        other: LooseMesh,
        shift: npt.ArrayLike = (0.0, 0.0, 0.0),
        turn: npt.NDArray[np.float64] = _NO_TURN,
    ) -> bool:
        """Decide whether this mesh crosses another one, rotated and then translated.

        Parameters
        ----------
        shift : array_like of float64, shape (3,)
            Its translation.
        turn : ndarray of float64, shape (3, 3)
            Its rotation.

        Returns
        -------
        bool
            Whether a triangle of one mesh crosses a triangle of the other.
        """
        with _moving:
            other._moving.setTransform(fcl.Transform(turn, np.array(shift)))
            return _collide(self._fixed, other._moving)

    def distance(
        self, other: LooseMesh, shift: npt.ArrayLike, turn: npt.NDArray[np.float64] = _NO_TURN
    ) -> float:
        """Compute the distance to another mesh, rotated and then translated.

        Parameters
        ----------
        shift : array_like of float64, shape (3,)
            Its translation.
        turn : ndarray of float64, shape (3, 3)
            Its rotation.

        Returns
        -------
        float
            The smallest distance of two triangles; not more than 0 if the meshes cross.
        """
        with _moving:
            other._moving.setTransform(fcl.Transform(turn, np.array(shift)))
            return float(fcl.distance(self._fixed, other._moving))


def triangles_cross(one: Floats, other: Floats) -> bool:
    """Decide whether a triangle of one surface crosses a triangle of another.

    Parameters
    ----------
    one : ndarray of float64, shape (n, 3, 3)
        The corners of the triangles, at least one, near the origin.
    other : ndarray of float64, shape (m, 3, 3)
        The same of the other surface.

    Returns
    -------
    bool
        What is proved (see `crossing_kernels`), or else FCL's answer.
    """
    boxes, starts = boxes_of(one)
    tree, other_tree = (one, boxes, starts), (other, *boxes_of(other))
    found = relation(tree, other_tree, _AS_IT_IS, np.zeros(3), boxes[1])
    if found != UNSURE:
        return bool(found == CROSSING)
    return _soup(one).crosses(_soup(other))


def _soup(triangles: Floats) -> LooseMesh:
    """Return the FCL mesh of triangles (n, 3, 3) without common vertices."""
    return LooseMesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def _collide(one: fcl.CollisionObject, other: fcl.CollisionObject) -> bool:
    """Decide whether a triangle of one mesh crosses a triangle of another, where they are now."""
    return bool(fcl.collide(one, other, _REQUEST, fcl.CollisionResult()))
