"""The tasks on which an agent did best and worst, as interactive boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.game.datasets.provenance import RETURN_SLACK
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.reports.runs import EvaluationRun, ReportError, Runs
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.web.page_models import Models

SOLUTION = "ground truth"
"""The name of a task's own pack in the list of agents."""


@dataclass(frozen=True)
class Example:
    """A box that one agent packed.

    Attributes
    ----------
    by : str
        The agent's name.
    model : int
        Its number among the page's models.
    total : float
        The return.
    summary : str
        Items, density and end of the episode, as text.
    """

    by: str
    model: int
    total: float
    summary: str

    @property
    def shown(self) -> str:
        """The return as text, which is 1.000 only if all items were placed."""
        return f"{self.total if self.total >= 1 - RETURN_SLACK else min(self.total, 0.999):.3f}"


@dataclass(frozen=True)
class TaskExamples:
    """A task, packed by several agents.

    Attributes
    ----------
    rank : str
        "best" or "worst".
    examples : tuple[Example, ...]
        The boxes: first that of the gallery's agent, then others.
    """

    task: int
    rank: str
    examples: tuple[Example, ...]


@dataclass(frozen=True)
class Gallery:
    """The best and the worst tasks of one agent.

    Attributes
    ----------
    tasks : tuple[TaskExamples, ...]
        The tasks, its best first.
    models : Models
        The boxes that they show.
    """

    agent: str
    tasks: tuple[TaskExamples, ...]
    models: Models


def chosen(runs: Runs, agent: str | None) -> EvaluationRun:
    """Choose the agent whose tasks are shown.

    Parameters
    ----------
    runs : Runs
        The results.
    agent : str | None
        The agent's name; by default the one with the highest Average Reward.

    Returns
    -------
    EvaluationRun
        Its results.

    Raises
    ------
    ReportError
        If the runs do not contain the agent.
    """
    if agent is None:
        return max(runs.played, key=lambda one: one.reward)
    for one in runs.played:
        if one.name == agent:
            return one
    names = ", ".join(one.name for one in runs.played) or "none"
    raise ReportError(f"agent {agent!r} is not in these results: choose from {names}")


def extremes(rollouts: Sequence[Rollout], each: int) -> list[tuple[str, Rollout]]:
    """Choose the rollouts with the highest and the lowest returns, each at most once.

    Parameters
    ----------
    each : int
        The number of the highest, and of the lowest.

    Returns
    -------
    list[tuple[str, Rollout]]
        Rank ("best" or "worst") and rollout. Of equal returns the first task ranks higher.
    """
    ordered = sorted(rollouts, key=lambda rollout: (-rollout.total, rollout.task))
    best = ordered[: min(each, (len(ordered) + 1) // 2)]
    worst = ordered[max(len(best), len(ordered) - each) :]
    return [("best", one) for one in best] + [("worst", one) for one in reversed(worst)]


def gallery(
    runs: Runs,
    library: ShapeLibrary,
    each: int,
    agent: str | None = None,
    tasks: Mapping[str, Task] = MappingProxyType({}),
) -> Gallery:
    """Collect the best and the worst tasks of an agent, with the boxes of all agents.

    Parameters
    ----------
    runs : Runs
        The results.
    each : int
        The number of the best tasks, and of the worst.
    agent : str | None
        The agent's name, see `chosen`.
    tasks : Mapping[str, Task]
        Tasks by digest; the packs of those that were played are shown as well.

    Returns
    -------
    Gallery
        The tasks and the models.

    Raises
    ------
    PackFormatError
        If the results are of another library.
    """
    shown = chosen(runs, agent)
    others = [one for one in runs.played if one is not shown]
    models = Models()
    chosen_tasks = []
    for rank, rollout in extremes(shown.rollouts, each):
        task = tasks.get(rollout.task_digest)
        examples = []
        for one in (shown, *others):
            found = [r for r in one.rollouts if r.task_digest == rollout.task_digest]
            examples += [_example(one.name, r, task, library, models) for r in found]
        if task is not None:
            examples.append(_solution(task, library, models))
        chosen_tasks.append(TaskExamples(rollout.task, rank, tuple(examples)))
    return Gallery(shown.name, tuple(chosen_tasks), models)


def _example(
    name: str, rollout: Rollout, task: Task | None, library: ShapeLibrary, models: Models
) -> Example:
    pack = rollout.pack
    count = f"{len(pack.items)}" if task is None else f"{len(pack.items)} of {len(task.items)}"
    summary = f"{count} items, density {pack.density:.3f}; ended: {rollout.end}"
    return Example(name, _model(pack, rollout.total, library, models), rollout.total, summary)


def _solution(task: Task, library: ShapeLibrary, models: Models) -> Example:
    summary = f"{len(task.pack.items)} items, density {task.pack.density:.3f}"
    return Example(SOLUTION, _model(task.pack, 1.0, library, models), 1.0, summary)


def _model(pack: Pack, total: float, library: ShapeLibrary, models: Models) -> int:
    """Add a pack's model; `total`, the return, is its share of the task's volume."""
    volume = pack.counted_volume / total if total > 0 else 1.0
    return models.add(pack.cells, pack.placed(library), volume)
