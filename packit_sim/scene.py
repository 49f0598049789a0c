"""The same box in a headless PyBullet world: for pictures, and for a second opinion on contacts.

The box's state is the truth; the bodies here are rebuilt from it and never move by themselves.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from packit_sim.box import BoxState
from packit_sim.core.errors import RenderError
from packit_sim.engine.feasibility import Contents
from packit_sim.engine.occupancy import PlacedItem
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.poses import Pose
from packit_sim.geometry.shapes import Item
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import Settled, settle
from packit_sim.render.cameras import Camera, Points
from packit_sim.render.coloring import Color, color_of
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import DEFAULT_LOOK, Look
from packit_sim.render.obj_text import convex_pieces, drawn, objects
from packit_sim.render.rendering import (
    RENDERER_VARIABLE,
    UNIT,
    Snapshot,
    load_renderer,
    quiet,
    release_renderer,
    take,
)
from packit_sim.render.staging import BodyStager, corners

with quiet():
    import pybullet

__all__ = ["Camera", "Look", "Scene", "Snapshot"]


_MARGIN = 0.001
"""Metres by which PyBullet grows every convex piece that it loads; meshes it leaves alone."""

_MAX_MADE = 512
"""Shapes that a world may have made: PyBullet never frees one before it disconnects."""

_MAX_TRIANGLES = 2**19
"""Triangles that a world may have made, for the same reason."""

_MAX_SECTIONS = 2**18
"""Triangles that a world may have made of what is left where boxes are cut open."""

_EGL_TRIANGLES = 2**27 // 216
"""Triangles that EGL's buffer holds: PyBullet leaves more out of the picture without a word."""


@dataclass
class _Shapes:
    """PyBullet's numbers for an item: as drawn, as a collision mesh, as convex pieces.

    The last two are made when they are asked for.
    """

    drawn: int
    mesh: int | None = None
    pieces: int | None = None


class Scene:
    """A box and its items as static bodies in a PyBullet world of its own.

    renderer: "egl" or "tiny", see `rendering.load_renderer`. Close it, or use it in a `with`.
    Only the thread that made it may use it, and no forked child (PyBullet would crash): its methods
    raise RenderError there, after `close`, and where a box has more triangles than EGL can draw.
    """

    def __init__(self, box: Contents) -> None:
        self._owner = (os.getpid(), threading.get_ident())
        self._connect()
        try:
            self._build(box)
        except BaseException:
            self._finalizer()
            raise

    def update(self, box: Contents) -> None:
        """Makes the world equal to the box again; bodies of items that stayed are kept."""
        self._check()
        items = {_key(placed.item): placed.item for placed in box.placed}
        new = sum(len(items[key].shape.mesh.faces) for key in items.keys() - self._shapes.keys())
        if len(self._shapes) > _MAX_MADE or self._triangles + new > _MAX_TRIANGLES:
            self._finalizer()
            self._connect()
        self._build(box)

    def snapshot(
        self,
        width: int = 512,
        height: int = 512,
        look: Look | None = None,
        layout: Layout | None = None,
    ) -> Snapshot:
        """A picture of so many pixels. Raises ValueError where a side is not 1 to 2048.

        layout: where items are shown, whatever the look says of that; by default in their places,
        or as far apart as the look says.
        """
        self._check()
        look = look or DEFAULT_LOOK
        size = np.array(self._cells) * CELL
        placed = tuple(self._bodies)
        if self._sections > _MAX_SECTIONS:
            box = BoxState(self._cells, placed)
            self._finalizer()
            self._connect()
            self._build(box)
        shown = layout or Layout.packed(placed, size, look.explode)
        points = shown.points
        if look.box != "none" or not placed:
            points = np.concatenate((corners(size), points))
        elif layout is None:
            points = _vertices(placed, shown)
        whole = layout is None and look.box != "none" and not look.explode
        with quiet():
            indices = self._stage.arrange(self._bodies, look, shown, size, self._wall)
            shot = take(
                self._client,
                self.renderer,
                indices,
                points,
                size / 2 if whole or not placed else None,
                look,
                width,
                height,
                size if look.box == "ghost" else None,
            )
        return replace(shot, legend=look.coloring([p.item for p in placed]).legend)

    def penetrations(self) -> dict[tuple[int, int], float]:
        """How deep placed items interpenetrate, by PyBullet's closest-point query.

        For each pair (i, j), i < j, of items whose cell boxes meet: the depth in box units, 0 where
        their surfaces don't cross. PyBullet finds nothing between two meshes, so each is tested as
        convex pieces against the other's mesh, both ways: a closed convex part of a mesh is one
        piece, any other triangle is one by itself. The depth is the largest over pairs of a piece
        and a triangle of the least way out of each other.

        It falls short of the true depth where an item reaches deeper than its pieces are large, and
        by up to 2e-4 of a piece's length, because PyBullet rounds the corners of hulls. It is blind
        where surfaces of parts that are not convex coincide instead of crossing (a prism moved
        along its own sides) and where one item is wholly within another: cells decide there. On
        590 pairs of furniture meshes of 300 to 8,600 triangles, moved along random lines: 0 at a
        gap of 1e-4, at most 6e-6 at one of 1e-6; pushed in from first contact by 1e-4, 1e-3 and
        1e-2, medians of 8e-5, 7e-4 and 4e-3, and wherever FCL finds a crossing more than 0. About
        1 ms a pair, after about 0.05 s for an item new to the scene.
        """
        self._check()
        placed = list(self._bodies)
        return {
            (i, j): max(self._depth(placed[i], placed[j]), self._depth(placed[j], placed[i]))
            for i in range(len(placed))
            for j in range(i + 1, len(placed))
            if _meet(placed[i], placed[j])
        }

    def settle(self, settings: PhysicsSettings | None = None) -> Settled:
        """What becomes of the items when they are let go, see `settling.settle`.

        That is found out in a world of its own, and this one stays as it is:
        `snapshot(layout=settled.layout)` shows what came of it.
        """
        self._check()
        assert self._cells is not None
        return settle(BoxState(self._cells, tuple(self._bodies)), settings)

    def close(self) -> None:
        """Ends the world and removes its files; once more does nothing."""
        if self._finalizer.alive:
            self._check()
            self._finalizer()

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _check(self) -> None:
        if not self._finalizer.alive:
            raise RenderError("the scene is closed")
        if self._owner[0] != os.getpid():
            raise RenderError("the scene belongs to the process that this one was forked from")
        if self._owner[1] != threading.get_ident():
            raise RenderError(
                "the scene belongs to another thread: only the one that made it may use it"
            )

    def _connect(self) -> None:
        """A new, empty world."""
        with contextlib.ExitStack() as undo:
            self._folder = Path(tempfile.mkdtemp(prefix="packit-scene-"))
            undo.callback(shutil.rmtree, self._folder, ignore_errors=True)
            with quiet():
                self._client = pybullet.connect(pybullet.DIRECT)
            if self._client < 0:
                raise RenderError("PyBullet has no room for another world: close other scenes")
            undo.callback(_disconnect, self._client)
            pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self._client)
            self.renderer = load_renderer(self._client)
            undo.pop_all()
        self._finalizer = weakref.finalize(
            self, _release, self._client, self.renderer, self._folder, self._owner
        )
        self._cells: Triple = (0, 0, 0)
        self._stage = BodyStager(self._client)
        self._bodies: dict[PlacedItem, int] = {}
        self._shapes: dict[tuple[str, float], _Shapes] = {}
        self._triangles = self._sections = 0

    def _build(self, box: Contents) -> None:
        with quiet():
            self._cells = box.cells
            gone = self._bodies.keys() - set(box.placed)
            self._remove([self._bodies.pop(placed) for placed in gone])
            for placed in box.placed:
                if placed not in self._bodies:
                    self._bodies[placed] = self._add(placed)
            self._bodies = {placed: self._bodies[placed] for placed in box.placed}

    def _add(self, placed: PlacedItem) -> int:
        drawn = self._shapes_of(placed.item).drawn
        return self._body(drawn, _upright(placed))

    def _shapes_of(self, item: Item) -> _Shapes:
        """What PyBullet holds of an item, made where it is new; the rotation is the body's."""
        key = _key(item)
        if key not in self._shapes:
            drawn = self._draw(item.shape.mesh, item.scale, color_of(item.shape))
            self._shapes[key] = _Shapes(drawn)
        return self._shapes[key]

    def _mesh_of(self, item: Item) -> int:
        shapes, mesh = self._shapes_of(item), item.shape.mesh
        if shapes.mesh is None:
            shapes.mesh = self._collision(
                objects([(mesh.vertices, mesh.faces)], item.scale),
                pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            )
        return shapes.mesh

    def _pieces_of(self, item: Item) -> int:
        shapes = self._shapes_of(item)
        if shapes.pieces is None:
            shapes.pieces = self._collision(objects(convex_pieces(item.shape.mesh), item.scale), 0)
        return shapes.pieces

    def _depth(self, one: PlacedItem, other: PlacedItem) -> float:
        """How deep triangles of the other are in convex pieces of the one, in box units."""
        with quiet():
            pieces, mesh = self._pieces_of(one.item), self._mesh_of(other.item)
        points = pybullet.getClosestPoints(
            bodyA=-1,
            bodyB=-1,
            distance=0.0,
            collisionShapeA=pieces,
            collisionShapeB=mesh,
            collisionShapePositionA=(0, 0, 0),
            collisionShapePositionB=((other.center - one.center) * UNIT).tolist(),
            collisionShapeOrientationA=_upright(one).xyzw,
            collisionShapeOrientationB=_upright(other).xyzw,
            physicsClientId=self._client,
        )
        distances = (point[8] + _MARGIN for point in points or ())
        return max(0.0, -min(distances, default=0.0) / UNIT)

    def _wall(self, mesh: trimesh.Trimesh, color: Color) -> int:
        """A body that only pictures have."""
        self._sections += len(mesh.faces)
        return self._body(self._draw(mesh, 1.0, color), Pose(np.zeros(3)))

    def _draw(self, mesh: trimesh.Trimesh, scale: float, color: Color) -> int:
        self._triangles += len(mesh.faces)
        if self.renderer == "egl" and self._triangles > _EGL_TRIANGLES:
            raise RenderError(
                f"the box holds more than the {_EGL_TRIANGLES:,} triangles that EGL can draw: "
                f"choose {RENDERER_VARIABLE}=tiny"
            )
        return pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            fileName=self._write(drawn(mesh, scale)),
            rgbaColor=(*color, 1.0),  # else PyBullet takes the OBJ's material, which is white
            specularColor=(0.05, 0.05, 0.05),
            physicsClientId=self._client,
        )

    def _collision(self, text: str, flags: int) -> int:
        return pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            fileName=self._write(text),
            flags=flags,
            physicsClientId=self._client,
        )

    def _write(self, text: str) -> str:
        path = self._folder / f"{len(os.listdir(self._folder))}.obj"
        path.write_text(text)
        return str(path)

    def _body(self, visual: int, pose: Pose) -> int:
        return pybullet.createMultiBody(
            baseMass=0,
            baseVisualShapeIndex=visual,
            basePosition=(pose.position * UNIT).tolist(),
            baseOrientation=pose.xyzw,
            physicsClientId=self._client,
        )

    def _remove(self, bodies: list[int]) -> None:
        self._stage.forget(bodies)
        for body in bodies:
            pybullet.removeBody(body, physicsClientId=self._client)


def _release(client: int, renderer: str, folder: Path, owner: tuple[int, int]) -> None:
    """Ends a world, as far as its own thread asks; a forked child leaves all to its parent."""
    process, thread = owner
    if process != os.getpid():
        return
    if thread == threading.get_ident():
        _disconnect(client)
        release_renderer(renderer)
    shutil.rmtree(folder, ignore_errors=True)


def _disconnect(client: int) -> None:
    with quiet():
        pybullet.disconnect(physicsClientId=client)


def _vertices(placed: Sequence[PlacedItem], layout: Layout) -> Points:
    """(n, 3) all vertices of items that a layout shows."""
    meshes = [np.empty((0, 3))]
    for one, pose in zip(placed, layout.poses, strict=True):
        if pose is not None:
            meshes.append(pose.apply(one.item.shape.mesh.vertices * np.cbrt(one.item.scale)))
    return np.concatenate(meshes)


def _meet(one: PlacedItem, other: PlacedItem) -> bool:
    """Whether two items' cell boxes overlap or touch."""
    apart = np.less(one.stop, other.start) | np.less(other.stop, one.start)
    return not apart.any()


def _key(item: Item) -> tuple[str, float]:
    """What a world knows an item's shape by, in whichever rotation."""
    return item.shape.digest, item.scale


def _upright(placed: PlacedItem) -> Pose:
    """Compute the pose of an item on the grid."""
    return Pose.from_rotation(placed.center, placed.item.rotation)
