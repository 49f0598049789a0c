"""Count and draw what goes wrong when an arm packs boxes: one picture of each kind of failure.

    .venv/bin/python -m benchmarks.robot_failures build/robot/*.jsonl

Reads results of `packit execute`, or of `benchmarks.robot`, with their trajectories. Prints the
share of the items that were tried for each kind, and draws the first item of each: where it is when
its attempt is over, or, if it was never moved, above the place for which it was chosen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.common import argument_parser, markdown_table
from packit_sim import ShapeLibrary
from packit_sim.game.evaluation.results import read_results, stored_trajectory
from packit_sim.geometry.motions import Motion
from packit_sim.render import films, robot_films
from packit_sim.render.cameras import Camera
from packit_sim.render.coloring import UNKNOWN_COLOR, Colors
from packit_sim.robot.executed_item import Outcome, movement
from packit_sim.robot.measures import resting_poses
from packit_sim.robot.trajectory import Trajectory

KINDS = ("no grasp", "no path", "lost", "displaced", "collapsed")
"""Displaced: at rest more than 2 cm or 15 degrees from the plan; collapsed: moved so far later."""

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "robot-failures.png"

SIDE = 300
"""Pixels of a picture."""

STRIDE = 12
"""Frames per second, at the speed at which it was simulated, of which the last ones are drawn."""

ORANGE = (0.84, 0.37, 0.0)

AZIMUTHS = (-40.0, 50.0, 140.0, 230.0)
"""Angles of the camera; the picture that shows most orange is kept."""

HIGH = 0.3
"""Box units above its place at which an item is drawn that was never moved."""


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    found: dict[str, tuple[Trajectory, int, int]] = {}
    for file in options.results:
        for rollout in read_results(file):
            library = ShapeLibrary.open(rollout.pack.library.name)
            trajectory = stored_trajectory(file, rollout, library)
            counts["tried"] += len(trajectory.attempts)
            for kind, item, attempt in failures(trajectory):
                counts[kind] += 1
                found.setdefault(kind, (trajectory, item, attempt))
    rows = [(kind, counts[kind], f"{counts[kind] / counts['tried']:.1%}") for kind in KINDS]
    print(markdown_table(("failure", f"items of {counts['tried']}", "share"), rows))
    pictures = [drawn(*found[kind]) for kind in KINDS if kind in found]
    Image.fromarray(np.concatenate(pictures, axis=1)).save(PICTURE, optimize=True)
    print(f"wrote {PICTURE}: {', '.join(kind for kind in KINDS if kind in found)}")


def failures(trajectory: Trajectory) -> Iterator[tuple[str, int, int]]:
    """Yield the kind of each failure, the item, and the attempt after which it shows."""
    ends = resting_poses(trajectory)
    for n, one in enumerate(trajectory.attempts):
        if one.outcome is not Outcome.PLACED:
            yield one.outcome.value, n, n
            continue
        if movement(one.planned, ends[n][n]) > 1:
            yield "displaced", n, n
        later = range(n + 1, len(ends))
        moved = next((k for k in later if movement(ends[n][n], ends[k][n]) > 1), None)
        if moved is not None:
            yield "collapsed", n, moved


def drawn(trajectory: Trajectory, item: int, attempt: int) -> Any:
    """Return the picture (height, width, 3) of an item after an attempt, in orange among grey."""
    until = replace(trajectory, attempts=trajectory.attempts[: attempt + 1])
    box, frames = robot_films.executing(until, fps=STRIDE, speed=1.0)
    *_, (look, layout) = frames
    assert layout is not None
    poses = list(layout.poses)
    planned = trajectory.attempts[item].planned
    pose = poses[item] or Motion.shift((0, 0, HIGH)) @ planned.pose
    poses[item] = pose
    shown = planned.moved(pose @ planned.pose.inverse()).vertices

    def coloring(items: Any) -> Colors:
        return Colors(tuple(ORANGE if n == item else UNKNOWN_COLOR for n in range(len(items))))

    now = replace(layout, poses=tuple(poses), points=shown)
    cameras = (Camera(azimuth=azimuth, elevation=50.0) for azimuth in AZIMUTHS)
    views = [(replace(look, coloring=coloring, camera=camera), now) for camera in cameras]
    pictures = list(films.shot(box, views, SIDE, SIDE))
    return max(pictures, key=lambda one: np.ptp(one.astype(int), axis=2).sum())


if __name__ == "__main__":
    main()
