"""The portfolio: rules with searches at equal processor time, singly and combined.

It is beyond the paper: it shows the returns of searches over their processor time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.provenance import RETURN_SLACK
from packit_sim.game.evaluation.results import Rollout
from packit_sim.render import plots

TITLE = "The portfolio: rules and searches at equal processor time"

BEST = (
    "largest-fitting-first/lowest/blbf+lns",
    "largest-fitting-first/first-fit/maximal-contact+lns",
    "largest-fitting-first/lowest/least-empty+lns",
)
"""The pairs with the highest mean return after 10 s on validation tasks; they play all tasks."""

OTHERS = (
    "largest-fitting-first/lowest/maximal-contact+lns",
    "largest-fitting-first/lowest/blbf+mcts",
    "largest-fitting-first/lowest/blbf+beam",
)
"""Other pairs, which play the first tasks only."""

LEARNED = ("champion+ruin-recreate",)
"""Learned agents with their searches, which play all tasks, to be compared with the pairs."""

FIRST_TASKS = 50
"""The number of tasks that the other pairs play."""

SECONDS = 60.0
"""Processor seconds of each search on each task."""

TIMES = (1.0, 3.0, 10.0, 30.0, 60.0)
"""The seconds of the table's columns."""

LEGEND = (
    "Average Reward after a number of processor seconds per task, on one core. One run of a search "
    "gives all columns, since each improvement is recorded with its time. A rule alone has 0 until "
    "it has finished. `ruin-recreate` adapts to its budget, so that a run of 10 s need not be the "
    "first 10 s of one of 60 s. Where pairs divide the time, the best of their results counts. "
    "Parentheses contain 95% bootstrap intervals."
)

_POINTS = 30
"""Points of a curve."""

_FIRST_POINT = 0.1
"""Seconds of its first point."""

_HEIGHT = 2.5
"""Height of the plot, relative to the range of the rewards at the end of the curves."""

RolloutsByAgent = Mapping[str, Sequence[Rollout]]
"""The rollouts of each agent."""


@dataclass(frozen=True)
class PortfolioRow:
    """A row of the table.

    Attributes
    ----------
    label : str
        An agent, or several that divide the time.
    rewards : dict[float, Estimate]
        Average Reward after each number of seconds.
    success : Estimate
        Success@1 in percent at the end.
    """

    label: str
    tasks: int
    rewards: dict[float, Estimate]
    success: Estimate


def rules() -> tuple[str, ...]:
    """Return all agents without their searches."""
    return tuple(dict.fromkeys(pair.partition("+")[0] for pair in (*LEARNED, *BEST, *OTHERS)))


def agents(pairs: Sequence[str], seconds: float) -> tuple[str, ...]:
    """Return the names of pairs with their time, such as "largest-first/lowest/blbf+lns=60s"."""
    return tuple(f"{pair}={seconds:g}s" for pair in pairs)


def rows(played: RolloutsByAgent, seconds: float) -> tuple[PortfolioRow, ...]:
    """Compute the table.

    Parameters
    ----------
    played : Mapping[str, Sequence[Rollout]]
        The rollouts of `rules` and `agents`.
    seconds : float
        The time of each search.

    Returns
    -------
    tuple of PortfolioRow
        A row for each agent, for the best pairs together, and for all pairs together.
    """
    times = [each for each in TIMES if each < seconds] + [seconds]
    single = [
        _row(name, [_returns_after(played[name], each) for each in times], times)
        for name in (*rules(), *agents((*LEARNED, *BEST, *OTHERS), seconds))
    ]
    together = [
        _row(label, [divided([played[name] for name in names], each) for each in times], times)
        for label, names in _together(seconds).items()
    ]
    return (*single, *together)


def _together(seconds: float) -> dict[str, tuple[str, ...]]:
    """Return agents that divide the time on each task."""
    best, others = agents(BEST, seconds), agents(OTHERS, seconds)
    all_pairs = (*best, *others)
    return {
        f"the first {len(best)} pairs, time divided": best,
        f"all {len(all_pairs)} pairs, time divided": all_pairs,
    }


def _row(label: str, reached: Sequence[Sequence[float]], times: Sequence[float]) -> PortfolioRow:
    rewards = {time: Estimate.of(each) for time, each in zip(times, reached, strict=True)}
    success = Estimate.of(100.0 * (np.array(reached[-1]) >= 1 - RETURN_SLACK))
    return PortfolioRow(label, len(reached[-1]), rewards, success)


def divided(played: Sequence[Sequence[Rollout]], seconds: float) -> list[float]:
    """Return the best of several agents on each task, if they divide the time equally.

    Parameters
    ----------
    played : Sequence[Sequence[Rollout]]
        The rollouts of each agent.
    seconds : float
        Processor seconds for all agents together on each task.

    Returns
    -------
    list of float
        The best return of each task that all of them have played, in the order of the first.

    Raises
    ------
    ArgumentError
        If there is no such task.
    """
    by_task = [{each.task_digest: each for each in rollouts} for rollouts in played]
    shared = [task for task in by_task[0] if all(task in own for own in by_task)]
    if not shared:
        raise ArgumentError("there is no task that all of them have played")
    share = seconds / len(played)
    reached = [[own[task].return_after(share) for task in shared] for own in by_task]
    best: list[float] = np.max(reached, axis=0).tolist()
    return best


def _returns_after(rollouts: Sequence[Rollout], seconds: float) -> list[float]:
    return [rollout.return_after(seconds) for rollout in rollouts]


def markdown(found: Sequence[PortfolioRow], seconds: float) -> str:
    """Write the table."""
    columns = ["", "tasks", *(f"{time:g} s" for time in found[0].rewards), f"S@1, {seconds:g} s"]
    lines = [
        f"# {TITLE}",
        "",
        LEGEND,
        "",
        f"| {' | '.join(columns)} |",
        "|---" * len(columns) + "|",
    ]
    for row in found:
        rewards = (format_estimate(each, ".3f") for each in row.rewards.values())
        label = row.label if " " in row.label else f"`{row.label}`"
        success = format_estimate(row.success, ".1f")
        lines.append(f"| {label} | {row.tasks} | {' | '.join(rewards)} | {success} |")
    return "\n".join(lines) + "\n"


def to_json(found: Sequence[PortfolioRow], seconds: float) -> dict[str, Any]:
    """Return the table in JSON's types."""
    return {"title": TITLE, "seconds": seconds, "rows": [asdict(row) for row in found]}


def draw(played: RolloutsByAgent, seconds: float, path: Path) -> None:
    """Plot Average Reward against processor seconds, with 95% intervals."""
    times = np.geomspace(_FIRST_POINT, seconds, _POINTS).tolist()
    curves = {
        name: [_returns_after(played[name], time) for time in times]
        for name in agents((*LEARNED, *BEST, *OTHERS), seconds)
    }
    label, names = next(iter(_together(seconds).items()))
    curves[label] = [divided([played[name] for name in names], time) for time in times]
    with plots.drawn(path, [["reward"]], 9, 5) as (figure, axes):
        ax = axes["reward"]
        ends = []
        for (name, reached), color in zip(curves.items(), plots.COLORS, strict=True):
            found = [Estimate.of(each) for each in reached]
            ends.append(found[-1].mean)
            ax.plot(times, [each.mean for each in found], color=color, label=name)
            if len(reached[0]) > 1:
                low, high = [each.low for each in found], [each.high for each in found]
                ax.fill_between(times, low, high, color=color, alpha=plots.BAND, linewidth=0)
        ax.set(xscale="log", xlabel="processor seconds on a task", ylabel="Average Reward")
        spread = max(max(ends) - min(ends), 0.01)
        ax.set_ylim(max(ends) - _HEIGHT * spread, max(ends) + 0.1 * spread)
        figure.legend(loc="outside lower center", ncols=1)
        figure.suptitle(TITLE, x=0.01, ha="left", weight="bold")
