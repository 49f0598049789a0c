"""A software renderer, for machines without PyBullet, EGL or a graphics driver."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
import trimesh

from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shading import ShadedMesh
from packit_sim.render.coloring import Color
from packit_sim.render.raster_kernels import draw_triangles
from packit_sim.render.worlds import AMBIENT, DIFFUSE, LIGHT, Pixels, View


@dataclass
class _Body:
    """A visual shape at a pose."""

    mesh: ShadedMesh
    pose: Motion
    color: Color


class SoftwareWorld:
    """A world of static bodies that is drawn with a depth buffer in compiled code.

    Attributes
    ----------
    renderer : str
        "software".
    triangles : int
        Triangles of all visual shapes.
    """

    renderer = "software"

    def __init__(self) -> None:
        self.triangles = 0
        self._visuals: list[tuple[ShadedMesh, Color]] = []
        self._bodies: dict[int, _Body] = {}
        self._numbers = count()

    def add_visual(self, mesh: trimesh.Trimesh, scale: float, color: Color) -> int:
        """Add a visual shape, a mesh in box units scaled in volume, and return its number."""
        shaded = ShadedMesh.of(mesh)
        self._visuals.append((shaded._replace(vertices=shaded.vertices * np.cbrt(scale)), color))
        self.triangles += len(mesh.faces)
        return len(self._visuals) - 1

    def add_body(self, visual: int, pose: Motion) -> int:
        """Add a body of a visual shape and return its number."""
        mesh, color = self._visuals[visual]
        number = next(self._numbers)
        self._bodies[number] = _Body(mesh, pose, color)
        return number

    def remove(self, body: int) -> None:
        """Remove a body."""
        del self._bodies[body]

    def move(self, body: int, pose: Motion) -> None:
        """Set the pose of a body."""
        self._bodies[body].pose = pose

    def paint(self, body: int, color: Color) -> None:
        """Set the colour of a body."""
        self._bodies[body].color = color

    def camera_image(self, view: View, width: int, height: int) -> Pixels:
        """Draw the world in (height, width) pixels."""
        inverse = np.zeros((height, width))
        rgba = np.full((height, width, 4), 255, dtype=np.uint8)
        bodies = np.full((height, width), -1, dtype=np.int32)
        projection = view.camera.projection(view.eye, width, height)
        light = np.array(LIGHT) / np.linalg.norm(LIGHT)
        for number, body in self._bodies.items():
            mesh = body.mesh
            homogeneous = body.pose.apply(mesh.vertices) @ projection[:, :3].T + projection[:, 3]
            depth = homogeneous[:, 2]
            shown = (depth >= view.near) & (depth <= view.far)
            if not shown.any():
                continue
            points = np.zeros((len(depth), 3))
            np.divide(homogeneous, depth[:, None], out=points, where=shown[:, None])
            points[shown, 2] = 1 / depth[shown]
            facing = mesh.normals @ (body.pose.rotation.T @ light)
            lights = AMBIENT + DIFFUSE * np.stack((facing, -facing), axis=1).clip(min=0)
            sides = np.stack((mesh.fronts, mesh.backs), axis=1)
            red, green, blue = (255 * channel for channel in body.color)
            draw_triangles(
                (inverse, rgba, bodies),
                points,
                lights,
                mesh.faces,
                sides,
                number,
                (red, green, blue),
            )
        buffer = np.ones((height, width), dtype=np.float32)
        share = view.far / (view.far - view.near)
        drawn = bodies >= 0
        buffer[drawn] = share * (1 - view.near * inverse[drawn])
        return Pixels(rgba, buffer, bodies)

    def close(self) -> None:
        """Free everything; calling it again does nothing."""
        self._visuals.clear()
        self._bodies.clear()
