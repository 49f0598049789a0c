"""PyBullet worlds of static bodies, for pictures and contacts: the scene's one pybullet module."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import tempfile
import threading
import weakref
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.errors import RenderError
from packit_sim.core.silence import quiet
from packit_sim.geometry.obj_text import UNIT, drawn
from packit_sim.geometry.poses import Pose
from packit_sim.render.cameras import Camera, Points
from packit_sim.render.coloring import Color
from packit_sim.render.renderers import RENDERER_VARIABLE, acquire_renderer, release_renderer

EGL_PROBE = """
import sys, pybullet as p
c = p.connect(p.DIRECT)
assert p.loadPlugin(sys.argv[1], "_eglRendererPlugin", physicsClientId=c) >= 0
p.getCameraImage(16, 16, renderer=p.ER_BULLET_HARDWARE_OPENGL, physicsClientId=c)
"""
"""A script that draws with the EGL plugin whose path is its argument, see `egl_problem`."""

_EGL_TRIANGLES = 2**27 // 216
"""Triangles that EGL's buffer holds: PyBullet silently omits further ones from the picture."""

_MARGIN = 0.001
"""Metres by which PyBullet grows every convex piece that it loads; meshes stay as they are."""

_LIGHT = (0.35, 0.6, 1.0)
"""Direction of the light."""


class View(NamedTuple):
    """A camera in its place, in box units.

    Attributes
    ----------
    camera : Camera
        Its direction and opening angle.
    eye : ndarray of float64, shape (3,)
        Its position.
    near, far : float
        Distances of the clipping planes.
    """

    camera: Camera
    eye: Points
    near: float
    far: float


class Pixels(NamedTuple):
    """A renderer's output.

    Attributes
    ----------
    rgba : ndarray of uint8, shape (H, W, 4)
        The colours.
    depth : ndarray of float32, shape (H, W)
        The depth buffer: 0 at the near plane, 1 at the far one.
    bodies : ndarray of int32, shape (H, W)
        The number of the body, -1 where there is none.
    """

    rgba: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    bodies: npt.NDArray[np.int32]


class BulletClient:
    """A connection to an empty PyBullet world, with a folder for the files that it loads.

    Only the thread that created it may use it, and no forked child (PyBullet would crash).

    Attributes
    ----------
    renderer : str
        "egl" or "tiny", see `renderers.acquire_renderer`.
    folder : Path
        Where its files lie; removed when it is closed.
    number : int
        PyBullet's number of the connection.
    triangles : int
        Triangles of all visual shapes: PyBullet frees none before it disconnects.
    close : Callable[[], None]
        Disconnects and removes the folder; calling it again does nothing.

    Raises
    ------
    RenderError
        If PyBullet refuses another connection, or the renderer is not available.
    """

    def __init__(self) -> None:
        self._owner = (os.getpid(), threading.get_ident())
        self._pybullet = _pybullet()
        with contextlib.ExitStack() as undo:
            self.folder = Path(tempfile.mkdtemp(prefix="packit-scene-"))
            undo.callback(shutil.rmtree, self.folder, ignore_errors=True)
            with quiet():
                self.number = self._pybullet.connect(self._pybullet.DIRECT)
            if self.number < 0:
                raise RenderError("PyBullet allows no further connection: close other scenes")
            undo.callback(_disconnect, self.number)
            self._pybullet.setPhysicsEngineParameter(
                enableFileCaching=0, physicsClientId=self.number
            )
            self.renderer = acquire_renderer(self._load_egl, EGL_PROBE)
            undo.pop_all()
        self.triangles = 0
        self.close = weakref.finalize(
            self, _release, self.number, self.renderer, self.folder, self._owner
        )

    def check(self) -> None:
        """Raise RenderError if it is closed, or used by another thread or a forked child."""
        if not self.close.alive:
            raise RenderError("the scene is closed")
        if self._owner[0] != os.getpid():
            raise RenderError("the scene belongs to the process that this one was forked from")
        if self._owner[1] != threading.get_ident():
            raise RenderError(
                "the scene belongs to another thread: only the one that created it may use it"
            )

    def add_visual(self, mesh: trimesh.Trimesh, scale: float, color: Color) -> int:
        """Create a visual shape of a mesh.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            The mesh, in box units.
        scale : float
            The scale of its volume.
        color : Color
            Its colour.

        Returns
        -------
        int
            The number of the shape.

        Raises
        ------
        RenderError
            If the world has more triangles than EGL can draw.
        """
        self.triangles += len(mesh.faces)
        if self.renderer == "egl" and self.triangles > _EGL_TRIANGLES:
            raise RenderError(
                f"the box contains more than the {_EGL_TRIANGLES:,} triangles that EGL can draw: "
                f"choose {RENDERER_VARIABLE}=tiny"
            )
        number: int = self._pybullet.createVisualShape(
            self._pybullet.GEOM_MESH,
            fileName=self._write(drawn(mesh, scale)),
            rgbaColor=(*color, 1.0),  # else PyBullet takes the OBJ's material, which is white
            specularColor=(0.05, 0.05, 0.05),
            physicsClientId=self.number,
        )
        return number

    def add_collision(self, obj: str, concave: bool = False) -> int:
        """Create a collision shape of OBJ text and return its number.

        Parameters
        ----------
        obj : str
            The text, in metres.
        concave : bool
            Whether its surface is taken as it is; else each object becomes its convex hull.

        Returns
        -------
        int
            The number of the shape.
        """
        number: int = self._pybullet.createCollisionShape(
            self._pybullet.GEOM_MESH,
            fileName=self._write(obj),
            flags=self._pybullet.GEOM_FORCE_CONCAVE_TRIMESH if concave else 0,
            physicsClientId=self.number,
        )
        return number

    def add_body(self, visual: int, pose: Pose) -> int:
        """Create a static body of a visual shape and return its number."""
        number: int = self._pybullet.createMultiBody(
            baseMass=0,
            baseVisualShapeIndex=visual,
            basePosition=(pose.position * UNIT).tolist(),
            baseOrientation=pose.xyzw,
            physicsClientId=self.number,
        )
        return number

    def remove(self, body: int) -> None:
        """Remove a body."""
        self._pybullet.removeBody(body, physicsClientId=self.number)

    def move(self, body: int, pose: Pose) -> None:
        """Set the pose of a body."""
        self._pybullet.resetBasePositionAndOrientation(
            body, (pose.position * UNIT).tolist(), pose.xyzw, physicsClientId=self.number
        )

    def paint(self, body: int, color: Color) -> None:
        """Set the colour of a body."""
        self._pybullet.changeVisualShape(
            body, -1, rgbaColor=(*color, 1.0), physicsClientId=self.number
        )

    def depth(self, pieces: int, mesh: int, first: Pose, second: Pose) -> float:
        """Compute how deep a mesh's triangles are in convex pieces.

        Parameters
        ----------
        pieces : int
            The collision shape of the pieces.
        mesh : int
            The collision shape of the mesh.
        first : Pose
            The pose of the pieces.
        second : Pose
            The pose of the mesh.

        Returns
        -------
        float
            Box units, 0 where they are disjoint.
        """
        points = self._pybullet.getClosestPoints(
            bodyA=-1,
            bodyB=-1,
            distance=0.0,
            collisionShapeA=pieces,
            collisionShapeB=mesh,
            collisionShapePositionA=(0, 0, 0),
            collisionShapePositionB=((second.position - first.position) * UNIT).tolist(),
            collisionShapeOrientationA=first.xyzw,
            collisionShapeOrientationB=second.xyzw,
            physicsClientId=self.number,
        )
        distances = (point[8] + _MARGIN for point in points or ())
        return max(0.0, -min(distances, default=0.0) / UNIT)

    def camera_image(self, view: View, width: int, height: int) -> Pixels:
        """Draw the world in (height, width) pixels."""
        eye, toward = view.eye, view.camera.toward
        _, _, rgba, depth, bodies = self._pybullet.getCameraImage(
            width,
            height,
            viewMatrix=self._pybullet.computeViewMatrix(
                (eye * UNIT).tolist(), ((eye - toward) * UNIT).tolist(), (0, 0, 1)
            ),
            projectionMatrix=self._pybullet.computeProjectionMatrixFOV(
                view.camera.fov, width / height, view.near * UNIT, view.far * UNIT
            ),
            lightDirection=_LIGHT,
            lightAmbientCoeff=0.5,
            lightDiffuseCoeff=0.6,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=self._pybullet.ER_BULLET_HARDWARE_OPENGL,
            physicsClientId=self.number,
        )
        shape = (height, width)
        return Pixels(
            np.reshape(rgba, (*shape, 4)), np.reshape(depth, shape), np.reshape(bodies, shape)
        )

    def _load_egl(self, plugin: str) -> bool:
        with quiet():
            number: int = self._pybullet.loadPlugin(
                plugin, "_eglRendererPlugin", physicsClientId=self.number
            )
        return number >= 0

    def _write(self, text: str) -> str:
        path = self.folder / f"{len(os.listdir(self.folder))}.obj"
        path.write_text(text)
        return str(path)


@functools.cache
def _pybullet() -> Any:
    """Import PyBullet, which takes a tenth of a second and prints its build time."""
    with quiet():
        import pybullet
    return pybullet


def _release(number: int, renderer: str, folder: Path, owner: tuple[int, int]) -> None:
    """Disconnect, if its own thread asks; a forked child leaves everything to its parent."""
    process, thread = owner
    if process != os.getpid():
        return
    if thread == threading.get_ident():
        _disconnect(number)
        release_renderer(renderer)
    shutil.rmtree(folder, ignore_errors=True)


def _disconnect(number: int) -> None:
    with quiet():
        _pybullet().disconnect(physicsClientId=number)
