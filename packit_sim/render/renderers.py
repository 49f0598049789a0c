"""The choice of a renderer: EGL if it starts, else the software renderer."""

from __future__ import annotations

import logging
import os

from packit_sim.core.errors import RenderError
from packit_sim.render.bullet import EglWorld, egl_problem
from packit_sim.render.software import SoftwareWorld
from packit_sim.render.worlds import DrawnWorld

RENDERER_VARIABLE = "PACKIT_RENDERER"
"""Environment variable: `auto` (EGL where it starts, else software), `egl` or `software`."""


def open_world() -> DrawnWorld:
    """Open an empty world with the renderer that `PACKIT_RENDERER` names.

    Returns
    -------
    DrawnWorld
        The world; close it.

    Raises
    ------
    RenderError
        If the variable's value is not valid, or EGL is required and cannot draw.

    Notes
    -----
    EGL is probed once for each process. Only one world at a time draws with EGL, the others and
    forked children use the software renderer.
    """
    wanted = os.environ.get(RENDERER_VARIABLE) or "auto"
    if wanted not in ("auto", "egl", "software"):
        raise RenderError(
            f"{RENDERER_VARIABLE}={wanted!r} is not known: choose auto, egl or software"
        )
    if wanted == "software":
        return SoftwareWorld()
    problem = egl_problem()
    if problem is None:
        try:
            return EglWorld()
        except RenderError as error:
            problem = str(error)
    if wanted == "egl":
        raise RenderError(
            f"{RENDERER_VARIABLE}=egl, but EGL can't draw here ({problem}): close other scenes, or "
            "install libEGL and a driver (Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri), "
            "or choose software"
        )
    logging.getLogger(__name__).info("EGL can't draw here (%s): using software", problem)
    return SoftwareWorld()
