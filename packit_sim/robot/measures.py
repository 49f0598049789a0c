"""Measures of an execution, computed from its recorded trajectory alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.shapes import Item
from packit_sim.robot.executed_item import Outcome, apart, movement
from packit_sim.robot.penetration import largest_penetration
from packit_sim.robot.trajectory import Trajectory, posed

MEASURES = (
    "planned",
    "displacement",
    "turn",
    "collapses",
    "failed grasps",
    "no path",
    "penetration",
    "robot seconds",
)
"""The names of the measures."""


def measures(trajectory: Trajectory, items: Sequence[Item]) -> dict[str, int | float]:
    """Compute the measures of an execution.

    Parameters
    ----------
    trajectory : Trajectory
        The recorded trajectory.
    items : sequence of Item
        The items of the task.

    Returns
    -------
    dict of str to number
        "planned": the volume of the items for which a placement was chosen, relative to the
        task's. "displacement" (m) and "turn" (degrees): means over placed items of the distance
        and the angle between where they were to be released and where they came to rest.
        "collapses": placed items that later moved by more than 2 cm in a box of 0.30 m, or 15
        degrees. "failed grasps": items without a grasp, or lost. "no path": items without a way
        into the box. "penetration" (m): see `largest_penetration`. "robot seconds": simulated time.
    """
    cell, attempts = trajectory.cell, trajectory.attempts
    volume = plain_sum(item.volume for item in items)
    outcomes = [one.outcome for one in attempts]
    ends = resting_poses(trajectory)
    offsets = [
        apart(one.planned, ends[n][n])
        for n, one in enumerate(attempts)
        if one.outcome is Outcome.PLACED
    ]
    collapsed = 0
    for n, one in enumerate(attempts):
        if one.outcome is Outcome.PLACED:
            collapsed += any(movement(ends[n][n], end[n]) > 1 for end in ends[n + 1 :])
    steps = sum(len(one.recording.joints) for one in attempts)
    return {
        "planned": plain_sum(one.chosen.item.volume for one in attempts) / volume,
        "displacement": _mean([shift for shift, _ in offsets]) * cell.edge,
        "turn": _mean([angle for _, angle in offsets]),
        "collapses": collapsed,
        "failed grasps": outcomes.count(Outcome.NO_GRASP) + outcomes.count(Outcome.LOST),
        "no path": outcomes.count(Outcome.NO_PATH),
        "penetration": largest_penetration(trajectory) * cell.edge,
        "robot seconds": steps * cell.world.step,
    }


def resting_poses(trajectory: Trajectory) -> list[dict[int, PosedItem]]:
    """Return where the items of each attempt are at its end, by their numbers, as recorded."""
    known: dict[int, PosedItem] = {}
    found = []
    for one in trajectory.attempts:
        own = one.recording
        for number in np.unique(own.rows[:, 1]).tolist():
            row = own.poses[np.flatnonzero(own.rows[:, 1] == number)[-1]]
            known[number] = posed(trajectory.attempts[number].chosen.item, row.tolist())
        found.append(dict(known))
    return found


def inside_volume(trajectory: Trajectory) -> float:
    """Return the volume of the items that are inside the box at the end, in cubic box units."""
    ends = resting_poses(trajectory)
    last = ends[-1] if ends else {}
    return plain_sum(
        one.item.volume for one in last.values() if trajectory.cell.holds(trajectory.cells, one)
    )


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0
