"""A box in a headless world, for pictures and for an independent check of contacts by PyBullet.

The box's state is the truth; the bodies here are rebuilt from it and never move by themselves.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from packit_sim.core.errors import RenderError
from packit_sim.core.silence import quiet
from packit_sim.geometry.items import BoxState, Contents, ItemInBox, PlacedItem
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.render.bullet import ContactWorld
from packit_sim.render.cameras import Points
from packit_sim.render.coloring import color_of
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import DEFAULT_LOOK, Look
from packit_sim.render.renderers import open_world
from packit_sim.render.rendering import Snapshot, take
from packit_sim.render.staging import BodyStager, corners

MAX_SHAPES = 512
"""Maximum number of shapes of a world: PyBullet frees none before it disconnects."""

MAX_TRIANGLES = 2**19
"""Maximum number of triangles of a world, for the same reason."""

MAX_SECTIONS = 2**18
"""Maximum number of triangles in a world for the box itself and for items that are cut open."""


class Scene:
    """A box and its items as static bodies in a separate world.

    EGL draws a PyBullet world; without PyBullet or EGL a software renderer draws the same bodies.
    Close the scene, or use it in a `with` statement. Only the thread that created it may use it,
    and no forked child: PyBullet would crash.

    Raises
    ------
    RenderError
        By every method: in another thread, in a forked child, after `close`, and if a box has more
        triangles than EGL can draw.

    Examples
    --------
    >>> from packit_sim import Look, Scene, ShapeLibrary, dataset_file, read_packs
    >>> pack = read_packs(dataset_file("starter"))[0]
    >>> box = pack.contents(ShapeLibrary.open("everyday"))
    >>> with Scene(box) as scene:
    ...     picture = scene.snapshot(320, 240, Look(box="ghost"))
    >>> picture.save("box.png")
    >>> picture.image.shape
    (240, 320, 3)
    """

    def __init__(self, box: Contents[ItemInBox]) -> None:
        self._owner = (os.getpid(), threading.get_ident())
        self._closed = False
        self._contacts: ContactWorld | None = None
        self._open()
        try:
            self._build(box)
        except BaseException:
            self._world.close()
            raise

    @property
    def renderer(self) -> str:
        """The renderer's name, "egl" or "software", see `renderers.open_world`."""
        return self._world.renderer

    def update(self, box: Contents[ItemInBox]) -> None:
        """Make the world equal to a box; bodies of items that stayed are kept."""
        self._check()
        items = {_key(placed.item): placed.item for placed in box.placed}
        new = sum(len(items[key].shape.mesh.faces) for key in items.keys() - self._visuals.keys())
        if len(self._visuals) > MAX_SHAPES or self._world.triangles + new > MAX_TRIANGLES:
            self._world.close()
            self._open()
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
            The display options; None for `DEFAULT_LOOK`.
        layout : Layout | None
            The poses of the items, instead of `look.explode`. By default they are in their
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
        self._check()
        look = look or DEFAULT_LOOK
        size = np.array(self._cells) * CELL
        placed = tuple(self._bodies)
        if self._stager.triangles > MAX_SECTIONS:
            box = BoxState(self._cells, placed)
            self._world.close()
            self._open()
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
                self._world,
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

        Raises
        ------
        MissingPackageError
            If PyBullet is not installed.

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
        self._check()
        placed = list(self._bodies)
        if self._contacts is None:
            self._contacts = ContactWorld()
        depth = self._contacts.depth
        return {
            (i, j): max(depth(placed[i], placed[j]), depth(placed[j], placed[i]))
            for i in range(len(placed))
            for j in range(i + 1, len(placed))
            if _cell_boxes_meet(placed[i], placed[j])
        }

    def close(self) -> None:
        """End the world and remove its files; calling it again does nothing."""
        if not self._closed:
            self._check()
            self._closed = True
            self._world.close()
            if self._contacts is not None:
                self._contacts.close()

    def __getstate__(self) -> tuple[BoxState[ItemInBox], bool]:
        """Return what a copy gets: the box, for a world of its own, and whether it is closed."""
        return BoxState(self._cells, tuple(self._bodies)), self._closed

    def __setstate__(self, state: tuple[BoxState[ItemInBox], bool]) -> None:
        box, is_closed = state
        self.__init__(box)  # type: ignore[misc] # a new world
        if is_closed:
            self.close()

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _check(self) -> None:
        """Raise RenderError if it is closed, or used by another thread or a forked child."""
        if self._closed:
            raise RenderError("the scene is closed")
        if self._owner[0] != os.getpid():
            raise RenderError("the scene belongs to the process that this one was forked from")
        if self._owner[1] != threading.get_ident():
            raise RenderError(
                "the scene belongs to another thread: only the one that created it may use it"
            )

    def _open(self) -> None:
        """Open an empty world."""
        self._world = open_world()
        self._stager = BodyStager(self._world)
        self._cells: Triple = (0, 0, 0)
        self._bodies: dict[ItemInBox, int] = {}
        self._visuals: dict[tuple[str, float], int] = {}

    def _build(self, box: Contents[ItemInBox]) -> None:
        with quiet():
            self._cells = box.cells
            gone = self._bodies.keys() - set(box.placed)
            self._stager.remove([self._bodies.pop(placed) for placed in gone])
            for placed in box.placed:
                if placed not in self._bodies:
                    visual = self._visual_of(placed.item)
                    self._bodies[placed] = self._world.add_body(visual, placed.pose)
            self._bodies = {placed: self._bodies[placed] for placed in box.placed}

    def _visual_of(self, item: Item) -> int:
        """Look up an item's visual shape, created if new; the rotation is the body's."""
        key = _key(item)
        if key not in self._visuals:
            mesh, color = item.shape.mesh, color_of(item.shape)
            self._visuals[key] = self._world.add_visual(mesh, item.scale, color)
        return self._visuals[key]


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
