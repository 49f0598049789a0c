"""Pictures of a PyBullet world: which renderer draws, from where, and what comes back.

EGL draws on the GPU, or on Mesa's software rasteriser where there is none; PyBullet's own
TinyRenderer needs nothing and stands in where EGL does not start.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib.util
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from packit_sim.core.errors import RenderError
from packit_sim.core.files import replacing
from packit_sim.render.cameras import Points
from packit_sim.render.coloring import Legend
from packit_sim.render.ghosts import Ghost
from packit_sim.render.looks import Look
from packit_sim.render.pixels import resolve

RENDERER_VARIABLE = "PACKIT_RENDERER"
"""Environment variable: `auto` (EGL where it starts, else TinyRenderer), `egl` or `tiny`."""

PROBE_TIMEOUT = 20.0
"""Seconds that EGL may take to start in the probe; half a second is usual."""

MAX_SIDE = 2048
"""The most pixels along a side of a picture."""

UNIT = 100.0
"""Metres of PyBullet's world to a box unit: its tolerances are absolute, so a large world is an
exact one."""

_PROBE = """
import sys, pybullet as p
c = p.connect(p.DIRECT)
assert p.loadPlugin(sys.argv[1], "_eglRendererPlugin", physicsClientId=c) >= 0
p.getCameraImage(16, 16, renderer=p.ER_BULLET_HARDWARE_OPENGL, physicsClientId=c)
"""
_SUPERSAMPLING = {"egl": 2, "tiny": 1}
_LIGHT = (0.35, 0.6, 1.0)
_OUTLINE = 0.55
"""What an outline leaves of a pixel's brightness."""

_OUTPUT = threading.RLock()
_EGL = threading.Lock()


def _forked() -> None:
    """A child can't use EGL, and the thread that was printing is not in it."""
    global _OUTPUT
    _OUTPUT = threading.RLock()
    _EGL.acquire(blocking=False)


os.register_at_fork(after_in_child=_forked)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keeps what C code prints off the terminal: file descriptors 1 and 2 lead nowhere meanwhile.

    They are the whole process's: what other threads print in these milliseconds is lost too.
    """
    libc = ctypes.CDLL(None)
    with _OUTPUT, contextlib.ExitStack() as stack:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(AttributeError, OSError, ValueError):
                stream.flush()
        libc.fflush(None)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, nowhere)
        for descriptor in (1, 2):
            with contextlib.suppress(OSError):  # a daemon may have closed it
                saved = os.dup(descriptor)
                stack.callback(os.close, saved)
                stack.callback(os.dup2, saved, descriptor)
                os.dup2(nowhere, descriptor)
        stack.callback(libc.fflush, None)
        yield


with quiet():
    import pybullet


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A picture of a box.

    image: (H, W, 3) uint8. depth: (H, W) float32, box units along the view from the camera, inf
    where there is nothing. segmentation: (H, W) int32, the index of the placed item, -1 for none.
    projection: (3, 4), takes a point (x, y, z, 1) of the box to (column, row, 1) times its depth.
    renderer: "egl" or "tiny". legend: what the items' colours mean, if they mean anything.
    """

    image: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    segmentation: npt.NDArray[np.int32]
    projection: Points
    renderer: str
    legend: Legend | None = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the image as PNG, whole or not at all, with the renderer's name in its metadata.

        Raises RenderError where the path can't be written.
        """
        save_png(self.image, path, self.renderer)

    def save_arrays(self, path: str | os.PathLike[str]) -> None:
        """Writes image, depth, segmentation and projection as NPZ, whole or not at all.

        Raises RenderError where the path can't be written.
        """
        names = ("image", "depth", "segmentation", "projection")
        with written(path) as file:
            np.savez_compressed(file, **{name: getattr(self, name) for name in names})


@contextlib.contextmanager
def written(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A file to write a picture to, whole or not at all; raises RenderError where it can't be."""
    path = Path(path)
    try:
        with replacing(path) as file:
            yield file
    except OSError as error:
        raise RenderError(f"the picture can't be written to {path}: {error.strerror}") from error


def save_png(image: npt.NDArray[np.uint8], path: str | os.PathLike[str], renderer: str) -> None:
    """Writes an image (H, W, 3) as PNG, whole or not at all, with the renderer's name inside.

    Raises RenderError where the path can't be written.
    """
    info = PngInfo()
    info.add_text("Software", "PackIt-Sim")
    info.add_text("Renderer", renderer)
    with written(path) as file:
        Image.fromarray(image).save(file, format="PNG", pnginfo=info)


def load_renderer(client: int) -> str:
    """Readies a renderer, "egl" or "tiny", in a world without bodies; `release_renderer` it later.

    `PACKIT_RENDERER` chooses; EGL is probed once a process. Only one world at a time draws with
    EGL, the others and forked children by TinyRenderer: PyBullet mixes up EGL's contexts, and
    crashes. Raises RenderError where the variable is not valid, or EGL is demanded in vain.
    """
    wanted = os.environ.get(RENDERER_VARIABLE) or "auto"
    if wanted not in ("auto", "egl", "tiny"):
        raise RenderError(f"{RENDERER_VARIABLE}={wanted!r} is not known: choose auto, egl or tiny")
    if wanted == "tiny":
        return "tiny"
    problem = _egl_problem()
    if problem is None and not _EGL.acquire(blocking=False):
        problem = "another scene of this process, or of the one it was forked from, has it"
    elif problem is None:
        with quiet():
            plugin = pybullet.loadPlugin(
                _egl_plugin(), "_eglRendererPlugin", physicsClientId=client
            )
        if plugin >= 0:
            return "egl"
        _EGL.release()
        problem = "it started in the probe, but not in this process"
    if wanted == "egl":
        raise RenderError(
            f"{RENDERER_VARIABLE}=egl, but EGL can't draw here ({problem}): close other scenes, or "
            "install libEGL and a driver (Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri), "
            "or choose tiny"
        )
    logging.getLogger(__name__).info("EGL can't draw here (%s): TinyRenderer does", problem)
    return "tiny"


def release_renderer(renderer: str) -> None:
    """Lets another world have the renderer, once the one that had it is disconnected."""
    if renderer == "egl":
        _EGL.release()


def take(
    client: int,
    renderer: str,
    indices: dict[int, int],
    points: Points,
    center: Points | None,
    look: Look,
    width: int,
    height: int,
    ghost: Points | None = None,
) -> Snapshot:
    """Draws a world; `indices` gives the item's index for a body's number.

    points, center: what the picture frames, see `Camera.eye`. ghost: (3,) extents of a box that is
    drawn as panes of glass.
    """
    for name, side in (("width", width), ("height", height)):
        if not 1 <= side <= MAX_SIDE:
            raise ValueError(f"{name} {side!r} is not possible: 1 to {MAX_SIDE} pixels")
    camera, samples = look.camera, _SUPERSAMPLING[renderer]
    eye = camera.eye(points, width / height, center)
    low, high = points.min(axis=0), points.max(axis=0)
    distance = float((eye - (low + high) / 2) @ camera.toward)
    radius = float(np.linalg.norm(high - low))
    near, far = max(distance - radius, radius / 100), distance + radius
    _, _, rgba, buffer, bodies = pybullet.getCameraImage(
        width * samples,
        height * samples,
        viewMatrix=pybullet.computeViewMatrix(
            (eye * UNIT).tolist(), ((eye - camera.toward) * UNIT).tolist(), (0, 0, 1)
        ),
        projectionMatrix=pybullet.computeProjectionMatrixFOV(
            camera.fov, width / height, near * UNIT, far * UNIT
        ),
        lightDirection=_LIGHT,
        lightAmbientCoeff=0.5,
        lightDiffuseCoeff=0.6,
        lightSpecularCoeff=0.05,
        shadow=0,
        renderer=pybullet.ER_BULLET_HARDWARE_OPENGL,
        physicsClientId=client,
    )
    items = np.full(max(*indices, -1, 0) + 1, -1, dtype=np.int32)
    items[list(indices)] = list(indices.values())
    shape = (height * samples, width * samples)
    panes = None if ghost is None else Ghost(ghost, camera, eye, width, height)
    back = look.background if panes is None else panes.behind(look.background)
    image, depth, segmentation = resolve(
        np.reshape(rgba, (*shape, 4)),
        np.reshape(buffer, shape),
        np.reshape(bodies, shape),
        items,
        np.broadcast_to(np.asarray(back, dtype=np.float32), (height, width, 3)),
        samples,
        _OUTLINE,
        near,
        far,
    )
    if panes is not None:
        image = panes.before(image, depth)
    return Snapshot(
        np.rint(image).astype(np.uint8),
        depth,
        segmentation,
        camera.projection(eye, width, height),
        renderer,
    )


def _egl_plugin() -> str:
    spec = importlib.util.find_spec("eglRenderer")
    return (spec and spec.origin) or ""


@functools.cache
def _egl_problem() -> str | None:
    """Why EGL does not start, or None where it does.

    Asked in a process of its own: where a part of EGL is missing the plugin ends its process.
    """
    plugin = _egl_plugin()
    if not plugin:
        return "this PyBullet has no EGL plugin"
    command = [sys.executable, "-c", _PROBE, plugin]
    try:
        probe = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PROBE_TIMEOUT
        )
    except subprocess.TimeoutExpired:
        return f"it hung for {PROBE_TIMEOUT:g} s"
    except OSError as error:
        return f"the probe did not run: {error}"
    return None if probe.returncode == 0 else f"the probe ended with status {probe.returncode}"
