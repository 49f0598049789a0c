"""An arm that packed a box, in the viewer: its trajectory as moments of a page."""

from __future__ import annotations

from dataclasses import dataclass

from packit_sim.core.errors import PackItError
from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.render import robot_films
from packit_sim.render.coloring import Color
from packit_sim.render.layouts import Layout
from packit_sim.robot.trajectory import Trajectory

FPS = 16
"""Moments that are shown in a second of playback."""

INTERVAL = 0.25
"""Simulated seconds between two moments: playback is four times as fast."""


@dataclass(frozen=True)
class ArmReplay:
    """The moments of an execution.

    Attributes
    ----------
    contents : BoxState
        The box, with all items that were tried, and the bodies of the arm.
    colors : tuple of Color
        The colour of each.
    layouts : tuple of Layout
        Where they are every `INTERVAL`, from the start on.
    """

    contents: BoxState[PosedItem]
    colors: tuple[Color, ...]
    layouts: tuple[Layout, ...]

    @classmethod
    def of(cls, trajectory: Trajectory) -> ArmReplay:
        """Prepare a recorded trajectory; raise PackItError if the arm moved nothing in it."""
        if not any(len(one.recording.joints) for one in trajectory.attempts):
            raise PackItError("the arm moved nothing")
        contents, frames = robot_films.executing(trajectory, fps=FPS, speed=FPS * INTERVAL)
        shown = list(frames)
        colors = shown[0][0].coloring([one.item for one in contents.placed]).of
        return cls(contents, colors, tuple(layout for _, layout in shown if layout is not None))

    @property
    def seconds(self) -> float:
        """Simulated time of the last moment."""
        return (len(self.layouts) - 1) * INTERVAL

    def at(self, seconds: float) -> Layout:
        """Return where all are at a simulated time."""
        return self.layouts[min(round(seconds / INTERVAL), len(self.layouts) - 1)]
