"""A box in a headless PyBullet world, for pictures and for an independent check of contacts.

The box's state is the truth; the bodies here are rebuilt from it and never move by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.core.silence import quiet
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.obj_text import convex_pieces, objects
from packit_sim.geometry.shapes import Item
from packit_sim.placement import BoxState, Contents, ItemInBox, PlacedItem
from packit_sim.render.bullet import BulletClient
from packit_sim.render.cameras import Camera, Points
from packit_sim.render.coloring import color_of
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import DEFAULT_LOOK, Look
from packit_sim.render.rendering import Snapshot, take
from packit_sim.render.staging import BodyStager, corners

__all__ = ["Camera", "Look", "Scene", "Snapshot"]

_MAX_SHAPES = 512
"""The most shapes of a world: PyBullet frees none before it disconnects."""

_MAX_TRIANGLES = 2**19
"""The most triangles of a world, for the same reason."""

_MAX_SECTIONS = 2**18
"""The most triangles that a world has of the box itself and of items that are cut open."""


@dataclass
class _Shapes:
    """PyBullet's numbers of an item's shapes; collision shapes are created when first needed."""

    visual: int
    mesh: int | None = None
    pieces: int | None = None


class Scene:
    """A box and its items as static bodies in a separate PyBullet world.

    Close it, or use it in a `with` statement. Only the thread that created it may use it, and no
    forked child: PyBullet would crash.

    Parameters
    ----------
    box : Contents[ItemInBox]
        The box to show.

    Raises
    ------
    RenderError
        By every method: in another thread, in a forked child, after `close`, and if a box has more
        triangles than EGL can draw.
    """

    def __init__(self, box: Contents[ItemInBox]) -> None:
        self._connect()
        try:
            self._build(box)
        except BaseException:
            self._client.close()
            raise

    @property
    def renderer(self) -> str:
        """The renderer's name, "egl" or "tiny", see `renderers.acquire_renderer`."""
        return self._client.renderer

    def update(self, box: Contents[ItemInBox]) -> None:
        """Make the world equal to a box; bodies of items that stayed are kept."""
        self._client.check()
        items = {_key(placed.item): placed.item for placed in box.placed}
        new = sum(len(items[key].shape.mesh.faces) for key in items.keys() - self._shapes.keys())
        if len(self._shapes) > _MAX_SHAPES or self._client.triangles + new > _MAX_TRIANGLES:
            self._client.close()
            self._connect()
        self._build(box)

    def snapshot(
        self,
        width: int = 512,
        height: int = 512,
        look: Look | None = None,
        layout: Layout | None = None,
    ) -> Snapshot:
        """Take a picture.

        Parameters
        ----------
        width : int
            Pixels, 1 to 2048.
        height : int
            Pixels, 1 to 2048.
        look : Look | None
            How the box is shown; None for `DEFAULT_LOOK`.
        layout : Layout | None
            Where the items are shown, instead of `look.explode`. By default they are in their
            places, or as far apart as the look says.

        Returns
        -------
        Snapshot
            The picture, with depths and segmentation.

        Raises
        ------
        ArgumentError
            If the width or the height is out of range.
        """
        self._client.check()
        look = look or DEFAULT_LOOK
        size = np.array(self._cells) * CELL
        placed = tuple(self._bodies)
        if self._stager.triangles > _MAX_SECTIONS:
            box = BoxState(self._cells, placed)
            self._client.close()
            self._connect()
            self._build(box)
        shown = layout or Layout.packed(placed, size, look.explode)
        points = shown.points
        if look.box != "none" or not placed:
            points = np.concatenate((corners(size), points))
        elif layout is None:
            points = _vertices(placed, shown)
        on_grid = all(isinstance(one, PlacedItem) for one in placed)  # others may be outside
        whole = on_grid and layout is None and look.box != "none" and not look.explode
        with quiet():
            image = take(
                self._client,
                self._stager.arrange(self._bodies, look, shown, size),
                points,
                size / 2 if whole or not placed else None,
                look,
                (width, height),
                size if look.box == "ghost" else None,
            )
        return replace(image, legend=look.coloring([p.item for p in placed]).legend)

    def penetrations(self) -> dict[tuple[int, int], float]:
        """Compute how deep placed items interpenetrate, by PyBullet's closest-point query.

        Returns
        -------
        dict[tuple[int, int], float]
            For each pair (i, j), i < j, of items whose cell boxes meet: the depth in box units, 0
            where their surfaces do not cross. An item off the grid is in a pair with every other.

        Notes
        -----
        PyBullet finds nothing between two meshes, so each is tested as convex pieces against the
        other's mesh, both ways: a closed convex part of a mesh is one piece, any other triangle is
        a piece by itself. The depth is the largest over pairs of a piece and a triangle of the
        shortest translation that separates them.

        It is less than the true depth where an item reaches deeper than its pieces are large, and
        by up to 2e-4 of a piece's length, because PyBullet rounds the corners of hulls. It is blind
        where surfaces of parts that are not convex coincide instead of crossing (a prism moved
        along its own sides) and where one item is wholly within another: cells decide there. On
        590 pairs of furniture meshes of 300 to 8,600 triangles, moved along random lines: 0 at a
        gap of 1e-4, at most 6e-6 at one of 1e-6; pushed in from first contact by 1e-4, 1e-3 and
        1e-2, medians of 8e-5, 7e-4 and 4e-3, and wherever FCL finds a crossing more than 0. About
        1 ms a pair, after about 0.05 s for an item new to the scene.
        """
        self._client.check()
        placed = list(self._bodies)
        return {
            (i, j): max(self._depth(placed[i], placed[j]), self._depth(placed[j], placed[i]))
            for i in range(len(placed))
            for j in range(i + 1, len(placed))
            if _cell_boxes_meet(placed[i], placed[j])
        }

    def close(self) -> None:
        """End the world and remove its files; calling it again does nothing."""
        if self._client.close.alive:
            self._client.check()
            self._client.close()

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _connect(self) -> None:
        """Create an empty world."""
        self._client = BulletClient()
        self._stager = BodyStager(self._client)
        self._cells: Triple = (0, 0, 0)
        self._bodies: dict[ItemInBox, int] = {}
        self._shapes: dict[tuple[str, float], _Shapes] = {}

    def _build(self, box: Contents[ItemInBox]) -> None:
        with quiet():
            self._cells = box.cells
            gone = self._bodies.keys() - set(box.placed)
            self._stager.remove([self._bodies.pop(placed) for placed in gone])
            for placed in box.placed:
                if placed not in self._bodies:
                    visual = self._shapes_of(placed.item).visual
                    self._bodies[placed] = self._client.add_body(visual, placed.pose)
            self._bodies = {placed: self._bodies[placed] for placed in box.placed}

    def _shapes_of(self, item: Item) -> _Shapes:
        """Look up PyBullet's shapes of an item, created if new; the rotation is the body's."""
        key = _key(item)
        if key not in self._shapes:
            mesh = item.shape.mesh
            visual = self._client.add_visual(mesh, item.scale, color_of(item.shape))
            self._shapes[key] = _Shapes(visual)
        return self._shapes[key]

    def _depth(self, one: ItemInBox, other: ItemInBox) -> float:
        """Compute how deep triangles of the other are in convex pieces of the one."""
        with quiet():
            pieces, mesh = self._pieces_of(one.item), self._mesh_of(other.item)
        return self._client.depth(pieces, mesh, one.pose, other.pose)

    def _pieces_of(self, item: Item) -> int:
        shapes = self._shapes_of(item)
        if shapes.pieces is None:
            text = objects(convex_pieces(item.shape.mesh), item.scale)
            shapes.pieces = self._client.add_collision(text)
        return shapes.pieces

    def _mesh_of(self, item: Item) -> int:
        shapes, mesh = self._shapes_of(item), item.shape.mesh
        if shapes.mesh is None:
            text = objects([(mesh.vertices, mesh.faces)], item.scale)
            shapes.mesh = self._client.add_collision(text, concave=True)
        return shapes.mesh


def _vertices(placed: Sequence[ItemInBox], layout: Layout) -> Points:
    """Compute all vertices (n, 3) of the items that a layout shows."""
    meshes = [np.empty((0, 3))]
    for one, pose in zip(placed, layout.poses, strict=True):
        if pose is not None:
            meshes.append(pose.apply(one.item.shape.mesh.vertices * np.cbrt(one.item.scale)))
    return np.concatenate(meshes)


def _cell_boxes_meet(one: ItemInBox, other: ItemInBox) -> bool:
    """Return whether two items' cell boxes overlap or touch, if both are on the grid."""
    if not (isinstance(one, PlacedItem) and isinstance(other, PlacedItem)):
        return True
    apart = np.less(one.stop, other.start) | np.less(other.stop, one.start)
    return not apart.any()


def _key(item: Item) -> tuple[str, float]:
    """Return the key of an item's shapes, the same in every rotation."""
    return item.shape.digest, item.scale
