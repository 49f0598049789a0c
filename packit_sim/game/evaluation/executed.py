"""Boxes that an arm packed: their measures, and the files of their trajectories."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from packit_sim.core.files import replacing
from packit_sim.game.episodes.episode import Episode
from packit_sim.robot.measures import measures
from packit_sim.robot.trajectory import Trajectory


@dataclass(frozen=True)
class Executed:
    """The record of an execution.

    Attributes
    ----------
    scores : dict of str to number
        The measures (see `robot.measures.measures`).
    digest : str
        The SHA-256 of the trajectory.
    """

    scores: dict[str, int | float]
    digest: str


def executed(episode: Episode, folder: Path | None) -> Executed | None:
    """Measure an episode, and write its trajectory.

    Parameters
    ----------
    episode : Episode
        The episode, which is over.
    folder : Path, optional
        The folder of trajectories, each named after its digest; by default none is written.

    Returns
    -------
    Executed or None
        The measures; None if no arm packed the box.
    """
    cell = episode.rules.robot
    if cell is None:
        return None
    trajectory = Trajectory.of(cell, episode.box.cells, episode.box.placed)
    digest = trajectory.digest
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(folder / f"{digest}.npz") as file:
            file.write(trajectory.to_bytes())
    return Executed(measures(trajectory, episode.task.items), digest)
