"""Pictures of an environment's box: drawn, or on a page that shows it as it fills."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from packit_sim.box import BaseBox
from packit_sim.core.checks import one_of
from packit_sim.core.plain_text import plain_logger

if TYPE_CHECKING:  # loaded when needed: playing alone needs none of them
    from packit_sim.scene import Look, Scene
    from packit_sim.web.viewer import Viewer

_log = plain_logger(__name__)


class Pictured:
    """A base of environments that draw their box, and can be copied in every state.

    Parameters
    ----------
    render_mode : str, optional
        "rgb_array" for `render()`, or "human" for a page that shows the box as it fills.
    look : Look, optional
        The look of the pictures of `render()` (see `looks`).

    Raises
    ------
    ArgumentError
        If the mode is not known.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(self, render_mode: str | None, look: Look | None) -> None:
        one_of("render mode", render_mode, (None, *self.metadata["render_modes"]))
        self.render_mode = render_mode
        self.look = look
        self._scene: Scene | None = None
        self._viewer: Viewer | None = None

    @property
    def _box(self) -> BaseBox[Any]:
        """The box that is drawn."""
        raise NotImplementedError

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Draw the box: uint8 (512, 512, 3) if the render mode is "rgb_array", else None."""
        if self.render_mode != "rgb_array":
            return None
        box = self._box
        if self._scene is None:
            from packit_sim.scene import Scene

            self._scene = Scene(box)
        self._scene.update(box)
        return self._scene.snapshot(look=self.look).image

    def close(self) -> None:
        """Close the scene and the page, if there are any."""
        if self._scene is not None:
            self._scene.close()
            self._scene = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy gets: all but the scene and the page, which it opens for itself."""
        return vars(self) | {"_scene": None, "_viewer": None}

    def __copy__(self) -> Self:
        """Copy it with its episode: two environments can't play one."""
        return copy.deepcopy(self)

    def _show(self) -> None:
        """Bring the page up to date if the render mode is "human"."""
        if self.render_mode != "human":
            return
        if self._viewer is None:
            from packit_sim.web.viewer import Viewer

            self._viewer = Viewer(self._box)
            _log.warning("the box is shown at %s", self._viewer.address)
        self._viewer.update(self._box)
