"""Bodies of a world, arranged for each picture: moved, painted and cut open."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import trimesh
from trimesh import creation

from packit_sim.core.errors import RenderError
from packit_sim.geometry.items import ItemInBox, PlacedItem
from packit_sim.geometry.motions import IDENTITY, Motion
from packit_sim.render.cameras import Points
from packit_sim.render.coloring import Color
from packit_sim.render.defaults import RGB
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import Cut, Look
from packit_sim.render.sections import BRIGHTNESS, is_beyond, section
from packit_sim.render.worlds import DrawnWorld

_EDGE_RADIUS = 0.004
"""Radius of the box's edges, as a share of its longest side."""

_WHITE = (1.0, 1.0, 1.0)
_AWAY = Motion.shift(np.array((0.0, 0.0, -1e4)))
"""The place of hidden bodies, out of every picture."""


class BodyStager:
    """Moves, paints and cuts open the bodies of a world for each picture.

    Bodies stay as the last picture showed them until the next one needs them otherwise.

    Attributes
    ----------
    triangles : int
        Triangles of all bodies created for pictures only: the box and items that are cut open.
    """

    def __init__(self, world: DrawnWorld) -> None:
        self._world = world
        self.triangles = 0
        self._poses: dict[int, Motion] = {}
        self._colors: dict[int, Color] = {}
        self._size: Points | None = None
        self._edges = self._floor = -1
        self._cut: Cut | None = None
        self._parts: dict[ItemInBox, tuple[int, ...]] = {}

    def remove(self, bodies: Iterable[int]) -> None:
        """Remove bodies; the world may use their numbers again."""
        for body in list(bodies):
            self._world.remove(body)
            self._poses.pop(body, None)
            self._colors.pop(body, None)

    def arrange(
        self,
        bodies: Mapping[ItemInBox, int],
        look: Look,
        layout: Layout,
        size: Points,
    ) -> dict[int, int]:
        """Arrange the bodies for a picture.

        Parameters
        ----------
        bodies : Mapping[ItemInBox, int]
            The body's number of each placed item.
        look : Look
            The display options.
        layout : Layout
            The poses of the items.
        size : Points
            Extents (3,) of the box in box units.

        Returns
        -------
        dict[int, int]
            The item's index for each number of a body that shows it.
        """
        self._show_box(look, size)
        self._cut_open(bodies, look.cut)
        indices = {}
        colors = look.coloring([placed.item for placed in bodies]).of
        rows = zip(bodies.items(), layout.poses, colors, strict=True)
        for n, ((placed, body), pose, color) in enumerate(rows):
            parts = self._parts.get(placed)
            self._put(body, pose if parts is None else None)
            self._paint(body, color)
            indices[body] = n
            for part, light in zip(parts or (), (1.0, BRIGHTNESS), strict=False):
                self._put(part, pose and Motion.shift(pose.translation))
                self._paint(part, _lit(color, light))
                indices[part] = n
        return indices

    def _show_box(self, look: Look, size: Points) -> None:
        if self._size is None or not np.array_equal(size, self._size):
            self.remove(body for body in (self._edges, self._floor) if body >= 0)
            self._edges, self._floor = map(self._add, _box(size))
            self._size = size
        there = IDENTITY if look.box == "edges" else None
        self._put(self._edges, there)
        self._put(self._floor, there)
        edges, floor = _box_colors(look.background)
        self._paint(self._edges, edges)
        self._paint(self._floor, floor)

    def _cut_open(self, bodies: Mapping[ItemInBox, int], cut: Cut | None) -> None:
        """Create bodies of the remaining parts of items that are cut; none for hidden items."""
        gone = [placed for placed in self._parts if placed not in bodies or cut != self._cut]
        for placed in gone:
            self.remove(self._parts.pop(placed))
        self._cut = cut
        if cut is None:
            return
        for placed in bodies.keys() - self._parts.keys():
            if not isinstance(placed, PlacedItem):
                raise RenderError("only items on the grid can be cut open: leave out the cut")
            if is_beyond(placed, cut):
                self._parts[placed] = ()
            elif (left := section(placed, cut)) is not None:
                self._parts[placed] = self._add(left.rest), self._add(left.cap)

    def _add(self, mesh: trimesh.Trimesh) -> int:
        """Create a body of a mesh in box units, with its origin in the world's."""
        self.triangles += len(mesh.faces)
        return self._world.add_body(self._world.add_visual(mesh, 1.0, _WHITE), IDENTITY)

    def _put(self, body: int, pose: Motion | None) -> None:
        """Move a body, out of sight where the pose is None."""
        pose = pose or _AWAY
        if self._poses.get(body) != pose:
            self._world.move(body, pose)
            self._poses[body] = pose

    def _paint(self, body: int, color: Color) -> None:
        if self._colors.get(body) != color:
            self._world.paint(body, color)
            self._colors[body] = color


def corners(size: Points) -> Points:
    """Compute the corners (8, 3) of a box with one at the origin."""
    return np.indices((2, 2, 2)).reshape(3, 8).T * size


def _box(size: Points) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Build the edges of a box, and a floor under it."""
    radius = _EDGE_RADIUS * float(size.max())
    points = corners(size)
    joints = [creation.icosphere(2, radius).apply_translation(point) for point in points]
    edges = [
        creation.cylinder(radius, sections=12, segment=(a, b))
        for a in points
        for b in points
        if np.count_nonzero(a < b) == 1 and (a <= b).all()
    ]
    floor = creation.box((size[0], size[1], radius)).subdivide().subdivide().subdivide()
    floor.apply_translation((size[0] / 2, size[1] / 2, -radius))
    frame = trimesh.util.concatenate(joints + edges)
    assert isinstance(frame, trimesh.Trimesh)
    return frame, floor


def _box_colors(background: RGB) -> tuple[Color, Color]:
    """Choose colours of a box's edges and its floor that stand out from a background."""
    red, green, blue = (channel / 255 for channel in background)
    if 0.3 * red + 0.59 * green + 0.11 * blue > 0.5:
        return (0.30, 0.32, 0.36), (0.94 * red, 0.94 * green, 0.95 * blue)
    return (0.72, 0.75, 0.80), (0.8 * red + 0.13, 0.8 * green + 0.13, 0.8 * blue + 0.14)


def _lit(color: Color, share: float) -> Color:
    red, green, blue = (channel * share for channel in color)
    return red, green, blue
