"""What a picture shows of a PyBullet world: bodies moved, painted and cut open as a look says."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
import trimesh
from trimesh import creation

from packit_sim.engine.occupancy import PlacedItem
from packit_sim.geometry.poses import Pose
from packit_sim.render.cameras import Points
from packit_sim.render.coloring import Color
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import RGB, Cut, Look
from packit_sim.render.rendering import UNIT, quiet
from packit_sim.render.sections import is_beyond, section

with quiet():
    import pybullet

Maker = Callable[[trimesh.Trimesh, Color], int]
"""Makes a body of a mesh in box units, upright, its origin in the world's."""

_EDGE_RADIUS = 0.004
"""Of the box's edges, as a share of its longest side."""

_AWAY = np.array((0.0, 0.0, -1e4))
"""Where bodies are that are not to be seen."""

_CAP = 0.8
"""What a section keeps of its item's brightness."""


class BodyStager:
    """The bodies of a world as the last picture showed them, and those that only pictures have."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._poses: dict[int, Pose] = {}
        self._colors: dict[int, Color] = {}
        self._size: Points | None = None
        self._edges = self._floor = -1
        self._cut: Cut | None = None
        self._parts: dict[PlacedItem, tuple[int, ...]] = {}

    def forget(self, bodies: Iterable[int]) -> None:
        """Bodies that are no more; their numbers may be given again."""
        for body in bodies:
            self._poses.pop(body, None)
            self._colors.pop(body, None)

    def arrange(
        self,
        bodies: Mapping[PlacedItem, int],
        look: Look,
        layout: Layout,
        size: Points,
        make: Maker,
    ) -> dict[int, int]:
        """Shows the bodies of placed items as a look says; returns the item's index by the body.

        size: (3,) of the box.
        """
        self._show_box(look, size, make)
        self._cut_open(bodies, look.cut, make)
        indices = {}
        colors = look.coloring([placed.item for placed in bodies]).of
        rows = zip(bodies.items(), layout.poses, colors, strict=True)
        for n, ((placed, body), pose, color) in enumerate(rows):
            parts = self._parts.get(placed)
            self._put(body, pose if parts is None else None)
            self._paint(body, color)
            indices[body] = n
            for part, light in zip(parts or (), (1.0, _CAP), strict=False):
                self._put(part, pose and Pose(pose.position))
                self._paint(part, _lit(color, light))
                indices[part] = n
        return indices

    def _show_box(self, look: Look, size: Points, make: Maker) -> None:
        if self._size is None or not np.array_equal(size, self._size):
            self._remove(body for body in (self._edges, self._floor) if body >= 0)
            self._edges, self._floor = (make(mesh, (1.0, 1.0, 1.0)) for mesh in _box(size))
            self._size = size
        there = Pose(np.zeros(3)) if look.box == "edges" else None
        self._put(self._edges, there)
        self._put(self._floor, there)
        edges, floor = _box_colors(look.background)
        self._paint(self._edges, edges)
        self._paint(self._floor, floor)

    def _cut_open(self, bodies: Mapping[PlacedItem, int], cut: Cut | None, make: Maker) -> None:
        """Makes what is left of items that are cut; nothing is of those that are taken away."""
        gone = [placed for placed in self._parts if placed not in bodies or cut != self._cut]
        for placed in gone:
            self._remove(self._parts.pop(placed))
        self._cut = cut
        if cut is None:
            return
        for placed in bodies.keys() - self._parts.keys():
            if is_beyond(placed, cut):
                self._parts[placed] = ()
            elif (left := section(placed, cut)) is not None:
                white = (1.0, 1.0, 1.0)
                self._parts[placed] = make(left.rest, white), make(left.cap, white)

    def _put(self, body: int, pose: Pose | None) -> None:
        """Moves a body, or out of sight."""
        pose = pose or Pose(_AWAY)
        known = self._poses.get(body)
        same = known is not None and known.wxyz == pose.wxyz
        if same and known is not None and np.array_equal(known.position, pose.position):
            return
        pybullet.resetBasePositionAndOrientation(
            body, (pose.position * UNIT).tolist(), pose.xyzw, physicsClientId=self._client
        )
        self._poses[body] = pose

    def _paint(self, body: int, color: Color) -> None:
        if self._colors.get(body) != color:
            pybullet.changeVisualShape(
                body, -1, rgbaColor=(*color, 1.0), physicsClientId=self._client
            )
            self._colors[body] = color

    def _remove(self, bodies: Iterable[int]) -> None:
        for body in list(bodies):
            pybullet.removeBody(body, physicsClientId=self._client)
            self.forget([body])


def corners(size: Points) -> Points:
    """(8, 3) corners of a box that has one at the origin."""
    return np.indices((2, 2, 2)).reshape(3, 8).T * size


def _box(size: Points) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """The edges of a box, and a floor under it."""
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
    """Of a box's edges and its floor, to be seen before a background."""
    red, green, blue = (channel / 255 for channel in background)
    if 0.3 * red + 0.59 * green + 0.11 * blue > 0.5:
        return (0.30, 0.32, 0.36), (0.94 * red, 0.94 * green, 0.95 * blue)
    return (0.72, 0.75, 0.80), (0.8 * red + 0.13, 0.8 * green + 0.13, 0.8 * blue + 0.14)


def _lit(color: Color, share: float) -> Color:
    red, green, blue = (channel * share for channel in color)
    return red, green, blue
