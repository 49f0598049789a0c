"""The choice of a renderer: EGL if it starts, else TinyRenderer.

EGL draws on the GPU, or with Mesa's software rasteriser if there is none. PyBullet's own
TinyRenderer has no requirements.
"""

from __future__ import annotations

import functools
import importlib.util
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable

from packit_sim.core.errors import RenderError

RENDERER_VARIABLE = "PACKIT_RENDERER"
"""Environment variable: `auto` (EGL where it starts, else TinyRenderer), `egl` or `tiny`."""

PROBE_TIMEOUT = 20.0
"""Seconds that EGL may take to start in the probe; half a second is usual."""

_EGL = threading.Lock()
os.register_at_fork(after_in_child=lambda: _EGL.acquire(blocking=False))  # no EGL in a child


def acquire_renderer(load_egl: Callable[[str], bool], probe: str) -> str:
    """Choose the renderer of a PyBullet world, as `PACKIT_RENDERER` says, and reserve it.

    Parameters
    ----------
    load_egl : Callable[[str], bool]
        Loads the EGL plugin from a path into the world; returns whether it started.
    probe : str
        A Python script that draws with the EGL plugin of its argument, see `egl_problem`.

    Returns
    -------
    str
        "egl" or "tiny"; pass it to `release_renderer` when the world is disconnected.

    Raises
    ------
    RenderError
        If the variable's value is not valid, or EGL is required and cannot draw.

    Notes
    -----
    EGL is probed once for each process. Only one world at a time draws with EGL, the others and
    forked children use TinyRenderer: PyBullet mixes up EGL's contexts, and crashes.
    """
    wanted = os.environ.get(RENDERER_VARIABLE) or "auto"
    if wanted not in ("auto", "egl", "tiny"):
        raise RenderError(f"{RENDERER_VARIABLE}={wanted!r} is not known: choose auto, egl or tiny")
    if wanted == "tiny":
        return "tiny"
    problem = egl_problem(probe)
    if problem is None and not _EGL.acquire(blocking=False):
        problem = "another scene of this process or of its parent uses it"
    elif problem is None:
        if load_egl(_egl_plugin()):
            return "egl"
        _EGL.release()
        problem = "it started in the probe, but not in this process"
    if wanted == "egl":
        raise RenderError(
            f"{RENDERER_VARIABLE}=egl, but EGL can't draw here ({problem}): close other scenes, or "
            "install libEGL and a driver (Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri), "
            "or choose tiny"
        )
    logging.getLogger(__name__).info("EGL can't draw here (%s): using TinyRenderer", problem)
    return "tiny"


def release_renderer(renderer: str) -> None:
    """Make the renderer of a disconnected world available to other worlds."""
    if renderer == "egl":
        _EGL.release()


@functools.cache
def egl_problem(script: str) -> str | None:
    """Find out whether EGL starts.

    Parameters
    ----------
    script : str
        A Python script that draws with the EGL plugin whose path is its argument.

    Returns
    -------
    str or None
        Why EGL does not start, None if it does.

    Notes
    -----
    The script runs in a separate process: if a part of EGL is missing, the plugin ends its process.
    """
    plugin = _egl_plugin()
    if not plugin:
        return "this PyBullet has no EGL plugin"
    command = [sys.executable, "-c", script, plugin]
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
