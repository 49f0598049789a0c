"""PyBullet worlds of static bodies, for pictures by EGL and for contacts.

No other module of the scene talks to PyBullet.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from packit_sim.core.errors import RenderError
from packit_sim.core.extras import needed_for
from packit_sim.core.files import naming
from packit_sim.core.silence import quiet
from packit_sim.geometry.bullet_meshes import UNIT, collada, convex_pieces, obj
from packit_sim.geometry.items import ItemInBox
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.render.coloring import Color
from packit_sim.render.worlds import AMBIENT, DIFFUSE, LIGHT, Pixels, View

EGL_PROBE = """
import sys, pybullet as p
c = p.connect(p.DIRECT)
assert p.loadPlugin(sys.argv[1], "_eglRendererPlugin", physicsClientId=c) >= 0
p.getCameraImage(16, 16, renderer=p.ER_BULLET_HARDWARE_OPENGL, physicsClientId=c)
"""
"""A script that draws with the EGL plugin whose path is its argument, see `egl_problem`."""

PROBE_TIMEOUT = 20.0
"""Seconds that EGL may take to start in the probe; half a second is usual."""

_EGL_TRIANGLES = 2**27 // 216
"""Triangles that EGL's buffer holds: PyBullet silently omits further ones from the picture."""

_MARGIN = 0.001
"""Metres by which PyBullet grows every convex piece that it loads; meshes stay as they are."""

_EGL = threading.Lock()
if sys.platform != "win32":
    os.register_at_fork(after_in_child=lambda: _EGL.acquire(blocking=False))  # no EGL in a child


class BulletClient:
    """A connection to an empty PyBullet world, with a folder for the files that it loads.

    Attributes
    ----------
    folder : Path
        The folder of its files, removed when it is closed.
    number : int
        PyBullet's number of the connection.
    close : Callable[[], None]
        Disconnects and removes the folder; calling it again does nothing.

    Raises
    ------
    RenderError
        If PyBullet refuses another connection.
    MissingPackageError
        If PyBullet is not installed.
    """

    def __init__(self) -> None:
        self._pybullet = _pybullet()
        owner = (os.getpid(), threading.get_ident())
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
            self._prepare()
            undo.pop_all()
        self.close = weakref.finalize(
            self, _release, self.number, self._on_release, self.folder, owner
        )

    def _prepare(self) -> None:
        """Prepare the empty world; the connection is closed if this fails."""

    @staticmethod
    def _on_release() -> None:
        """Free all resources of the world except the connection."""

    def _write(self, text: str, suffix: str) -> str:
        path = self.folder / f"{len(os.listdir(self.folder))}{suffix}"
        with naming(path):
            path.write_text(text)
        return str(path)


class ContactWorld(BulletClient):
    """A PyBullet world that computes how deep items interpenetrate."""

    def __init__(self) -> None:
        super().__init__()
        self._pieces: dict[tuple[str, float], int] = {}
        self._meshes: dict[tuple[str, float], int] = {}

    def depth(self, one: ItemInBox, other: ItemInBox) -> float:
        """Compute how deep triangles of an item are in convex pieces of another.

        Parameters
        ----------
        one : ItemInBox
            The item of the pieces.
        other : ItemInBox
            The item of the triangles.

        Returns
        -------
        float
            Box units, 0 where they are disjoint.
        """
        with quiet():
            pieces, mesh = self._pieces_of(one.item), self._mesh_of(other.item)
        shift = other.pose.translation - one.pose.translation
        points = self._pybullet.getClosestPoints(
            bodyA=-1,
            bodyB=-1,
            distance=0.0,
            collisionShapeA=pieces,
            collisionShapeB=mesh,
            collisionShapePositionA=(0, 0, 0),
            collisionShapePositionB=(shift * UNIT).tolist(),
            collisionShapeOrientationA=one.pose.xyzw,
            collisionShapeOrientationB=other.pose.xyzw,
            physicsClientId=self.number,
        )
        distances = (point[8] + _MARGIN for point in points or ())
        return max(0.0, -min(distances, default=0.0) / UNIT)

    def _pieces_of(self, item: Item) -> int:
        """Look up the collision shape of an item's convex pieces, created if new."""
        key = item.shape.digest, item.scale
        if key not in self._pieces:
            text = obj(convex_pieces(item.shape.mesh), item.scale)
            self._pieces[key] = self._add(text)
        return self._pieces[key]

    def _mesh_of(self, item: Item) -> int:
        """Look up the collision shape of an item's surface, created if new."""
        key, mesh = (item.shape.digest, item.scale), item.shape.mesh
        if key not in self._meshes:
            text = obj([(mesh.vertices, mesh.faces)], item.scale)
            self._meshes[key] = self._add(text, concave=True)
        return self._meshes[key]

    def _add(self, text: str, concave: bool = False) -> int:
        """Create a collision shape of OBJ text: its surface, or each object's convex hull."""
        number: int = self._pybullet.createCollisionShape(
            self._pybullet.GEOM_MESH,
            fileName=self._write(text, ".obj"),
            flags=self._pybullet.GEOM_FORCE_CONCAVE_TRIMESH if concave else 0,
            physicsClientId=self.number,
        )
        return number


class EglWorld(BulletClient):
    """A PyBullet world that is drawn with EGL: by the GPU, or by Mesa's software rasteriser.

    Attributes
    ----------
    renderer : str
        "egl".
    triangles : int
        Triangles of all visual shapes: PyBullet frees none before it disconnects.

    Raises
    ------
    RenderError
        If another world of this process or of its parent draws with EGL (PyBullet mixes up EGL's
        contexts, and crashes), or EGL does not start.
    """

    renderer = "egl"
    triangles = 0

    def _prepare(self) -> None:
        if not _EGL.acquire(blocking=False):
            raise RenderError("another scene of this process or of its parent uses it")
        with quiet():
            plugin = self._pybullet.loadPlugin(
                _egl_plugin(), "_eglRendererPlugin", physicsClientId=self.number
            )
        if plugin < 0:
            _EGL.release()
            raise RenderError("it started in the probe, but not in this process")

    @staticmethod
    def _on_release() -> None:
        _EGL.release()

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
        if self.triangles > _EGL_TRIANGLES:
            raise RenderError(
                f"the box contains more than the {_EGL_TRIANGLES:,} triangles that EGL can draw: "
                "choose PACKIT_RENDERER=software"
            )
        number: int = self._pybullet.createVisualShape(
            self._pybullet.GEOM_MESH,
            fileName=self._write(collada(mesh, scale), ".dae"),
            rgbaColor=(*color, 1.0),
            specularColor=(0.05, 0.05, 0.05),
            physicsClientId=self.number,
        )
        return number

    def add_body(self, visual: int, pose: Motion) -> int:
        """Create a static body of a visual shape and return its number."""
        number: int = self._pybullet.createMultiBody(
            baseMass=0,
            baseVisualShapeIndex=visual,
            basePosition=(pose.translation * UNIT).tolist(),
            baseOrientation=pose.xyzw,
            physicsClientId=self.number,
        )
        return number

    def remove(self, body: int) -> None:
        """Remove a body."""
        self._pybullet.removeBody(body, physicsClientId=self.number)

    def move(self, body: int, pose: Motion) -> None:
        """Set the pose of a body."""
        self._pybullet.resetBasePositionAndOrientation(
            body, (pose.translation * UNIT).tolist(), pose.xyzw, physicsClientId=self.number
        )

    def paint(self, body: int, color: Color) -> None:
        """Set the colour of a body."""
        self._pybullet.changeVisualShape(
            body, -1, rgbaColor=(*color, 1.0), physicsClientId=self.number
        )

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
            lightDirection=LIGHT,
            lightAmbientCoeff=AMBIENT,
            lightDiffuseCoeff=DIFFUSE,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=self._pybullet.ER_BULLET_HARDWARE_OPENGL,
            physicsClientId=self.number,
        )
        shape = (height, width)
        return Pixels(
            np.reshape(rgba, (*shape, 4)), np.reshape(depth, shape), np.reshape(bodies, shape)
        )


@functools.cache
def egl_problem() -> str | None:
    """Find out why PyBullet cannot draw with EGL; None if it can.

    Notes
    -----
    A script draws with it in a separate process: if a part of EGL is missing, the plugin ends its
    process.
    """
    if importlib.util.find_spec("pybullet") is None:
        return "PyBullet is not installed"
    if not (plugin := _egl_plugin()):
        return "this PyBullet has no EGL plugin"
    command = [sys.executable, "-c", EGL_PROBE, plugin]
    try:
        probe = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PROBE_TIMEOUT
        )
    except subprocess.TimeoutExpired:
        return f"it hung for {PROBE_TIMEOUT:g} s"
    except OSError as error:
        return f"the probe did not run: {error}"
    return None if probe.returncode == 0 else f"the probe ended with status {probe.returncode}"


def _egl_plugin() -> str:
    spec = importlib.util.find_spec("eglRenderer")
    return (spec and spec.origin) or ""


@functools.cache
def _pybullet() -> Any:
    """Import PyBullet, which takes a tenth of a second and prints its build time."""
    with quiet(), needed_for("contacts of a scene"):
        import pybullet
    return pybullet


def _release(
    number: int, on_release: Callable[[], None], folder: Path, owner: tuple[int, int]
) -> None:
    """Disconnect if called by the owner's thread; a forked child leaves all to its parent."""
    process, thread = owner
    if process != os.getpid():
        return
    if thread == threading.get_ident():
        _disconnect(number)
        on_release()
    shutil.rmtree(folder, ignore_errors=True)


def _disconnect(number: int) -> None:
    with quiet():
        _pybullet().disconnect(physicsClientId=number)
