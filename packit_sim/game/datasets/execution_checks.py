"""Checks of boxes that an arm packed: measures must follow from the recorded trajectory."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path

from packit_sim.core.errors import PackItError
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Played
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary

MEASURE_SLACK = 1e-9
"""Largest difference between a recorded measure and the computed one, relative above 1."""

POSE_SLACK = 1e-4
"""Largest difference of matrices of a recorded pose and the end of the trajectory: poses are
recorded anew only when they have changed by more than `recording.MOVED`."""


def trajectories_folder(file: Path) -> Path:
    """Return the folder with the trajectories of a file of results."""
    return file.with_name(file.name + ".trajectories")


def execution_problems(
    file: Path, pack: Pack, played: Played, library: ShapeLibrary
) -> Iterator[str]:
    """Yield the contradictions between a result and the trajectory that was recorded with it.

    Parameters
    ----------
    file : Path
        The file of results.
    pack : Pack
        The result.
    played : Played
        Its provenance.

    Yields
    ------
    str
        A sentence for each problem.
    """
    from packit_sim.robot import measures as robot  # loads PyBullet's world
    from packit_sim.robot.trajectory import Trajectory

    if played.rules.robot is None:
        if played.trajectory is not None:
            yield "it has a trajectory, but its rules have no robot"
        return
    path = trajectories_folder(file) / f"{played.trajectory}.npz"
    if not path.is_file():
        yield f"its trajectory {path} is missing"
        return
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != played.trajectory:
        yield f"its trajectory {path} is another one: the SHA-256 differs"
        return
    try:
        trajectory = Trajectory.from_bytes(data, lambda id: library[id])
    except PackItError as error:
        yield f"its trajectory {path} can't be read: {error}"
        return
    if (trajectory.cell, trajectory.cells) != (played.rules.robot, pack.cells):
        yield "its trajectory is of another robot cell or box than its rules"
        return
    tried = [(i.chosen.item.shape.id, i.chosen.item.scale) for i in trajectory.attempts]
    if tried != [(item.shape, item.scale) for item in pack.items]:
        yield "its trajectory is of other items"
        return
    ends = robot.resting_poses(trajectory)
    for n, end in (ends[-1] if ends else {}).items():
        placed = pack.items[n].placed(trajectory.attempts[n].chosen.item)
        if isinstance(placed, PosedItem) and abs(placed.matrix - end.matrix).max() > POSE_SLACK:
            yield f"item {n} is not where its trajectory ends"
    items = [one.chosen.item for one in trajectory.attempts]
    items += [Item(library[record.shape], record.scale) for record in pack.outside]
    counted = robot.inside_volume(trajectory) / plain_sum(item.volume for item in items)
    computed = {"return": counted, **robot.measures(trajectory, items)}
    recorded = {**played.scores, "return": played.total}
    for name, value in computed.items():
        theirs = recorded.get(name)
        if theirs is None or not math.isclose(
            theirs, value, rel_tol=MEASURE_SLACK, abs_tol=MEASURE_SLACK
        ):
            yield f"its {name} is recorded as {theirs!r}, but its trajectory gives {value!r}"
