"""Boxes that an arm packed: their measures, and the files of their trajectories."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from packit_sim.core.files import replacing
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.items import PlacedItem, PosedItem
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import ExecutedItem
from packit_sim.robot.measures import measures
from packit_sim.robot.plans import ExecutedPlan, execute_plan
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


def execute_pack(
    pack: Pack,
    library: ShapeLibrary,
    cell: RobotCell | None = None,
    callback: Callable[[tuple[ExecutedItem, ...]], None] | None = None,
) -> ExecutedPlan:
    """Let an arm put the items of a pack in where they are, in their order.

    Parameters
    ----------
    pack : Pack
        The pack, such as a stored result.
    library : ShapeLibrary
        Its library.
    cell : RobotCell, optional
        The robot cell.
    callback : callable, optional
        Called after each item with all that were tried.

    Returns
    -------
    ExecutedPlan
        The box at the end.

    Raises
    ------
    ArgumentError
        If the arm can't reach the box, or can't lift an item.
    """
    plan = [
        PosedItem.of(one) if isinstance(one, PlacedItem) else one for one in pack.placed(library)
    ]
    outside = [Item(library[record.shape], record.scale) for record in pack.outside]
    return execute_plan(plan, pack.cells, cell or RobotCell(), outside, callback=callback)
