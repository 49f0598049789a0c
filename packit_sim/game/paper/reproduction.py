"""The paper's tables, and one more: agents, the paper's numbers, and ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from packit_sim.core.confidence import Comparison, Estimate, format_estimate
from packit_sim.game.episodes.episode import Stage
from packit_sim.game.episodes.policy_registry import policy_names
from packit_sim.game.evaluation.evaluation import Score, compare
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.paper.names import HEURISTIC, TABLE_NAMES
from packit_sim.render import plots
from packit_sim.rules import PACKIT, Rules

EASY = Rules(easy=True)

LEARNING = "packnn/aligned/blbf"

STRONGER = (
    HEURISTIC,
    "longest-first/aligned/blbf",
    "largest-box-first/aligned/blbf",
    "largest-first/aligned/dblf",
    "largest-first/aligned/heightmap-minimisation",
    "largest-first/aligned/least-empty",
    "largest-first/aligned/maximal-contact",
    "largest-first/first-fit/blbf",
    "largest-first/lowest/blbf",
    "largest-fitting-first/aligned/blbf",
    "largest-first/lowest/maximal-contact",
    "largest-fitting-first/lowest/maximal-contact",
    f"{HEURISTIC}+mcts=50",
    f"{HEURISTIC}+lns=50",
    "largest-fitting-first/aligned/blbf+beam=4",
)
"""The paper's Heuristic, and agents that the paper does not have."""

LEGEND = (
    "Reward is the mean return, and S@x the percentage of tasks with a return of at least x. "
    "Parentheses contain 95% bootstrap intervals."
)
"""The first sentences of a reproduced table."""

PAPERS_ROWS = (
    'The rows "paper" are the numbers of Goyal and Deng (ICML 2020), measured with other shapes.'
)

Numbers = Mapping[str, float]
"""Average Reward as "reward", Success@x in percent as "S@x"."""


@dataclass(frozen=True)
class PaperRow:
    """A row of a table.

    Attributes
    ----------
    label : str
        The paper's name for it.
    paper : Numbers
        The paper's numbers; empty if it has none.
    """

    agent: str
    label: str
    paper: Numbers = field(default_factory=dict)


_ALL = ("reward", "S@0.5", "S@0.6", "S@0.7", "S@0.8", "S@0.9", "S@1")
_FEW = ("reward", "S@0.7", "S@0.9")


@dataclass(frozen=True)
class PaperTable:
    """Agents to compare.

    Attributes
    ----------
    rows : tuple[PaperRow, ...]
        The agents.
    metrics : tuple[str, ...]
        The columns.
    rules : Rules
        The rules to play by.
    against : str
        The agent that others are compared with.
    """

    title: str
    rows: tuple[PaperRow, ...]
    metrics: tuple[str, ...] = _FEW
    rules: Rules = PACKIT
    against: str = HEURISTIC

    @property
    def playable(self) -> tuple[PaperRow, ...]:
        """The rows with an installed shape policy."""
        known = policy_names(Stage.SHAPE)
        return tuple(row for row in self.rows if row.agent.split("/")[0] in known)


def _row(agent: str, label: str, numbers: Sequence[float]) -> PaperRow:
    """Return a row with the paper's numbers in the order of `_ALL` or `_FEW`."""
    metrics = _ALL if len(numbers) == len(_ALL) else _FEW
    return PaperRow(agent, label, dict(zip(metrics, numbers, strict=True)))


def _searches(
    name: str, values: Sequence[int], found: Mapping[str, Sequence[Sequence[float]]]
) -> tuple[PaperRow, ...]:
    """Return a row for each agent and value of a search, the first of which means no search."""
    labels = {HEURISTIC: "Heuristic", LEARNING: "Learning"}
    return tuple(
        _row(
            agent if value == values[0] else f"{agent}+{name}={value}",
            f"{labels[agent]}, {value}",
            numbers,
        )
        for agent, all_numbers in found.items()
        for value, numbers in zip(values, all_numbers, strict=True)
    )


_TABLE_1 = (
    _row("random/aligned/blbf", "Random / Aligned / BLBF", (0.419, 33.39, 13.59, 3.11, 0.19, 0, 0)),
    _row(
        "largest-first/random/blbf",
        "Largest-First / Random / BLBF",
        (0.473, 44.46, 20.0, 4.66, 0.58, 0, 0),
    ),
    _row(
        "largest-first/aligned/random",
        "Largest-First / Aligned / Random",
        (0.494, 50.10, 24.08, 8.16, 1.17, 0, 0),
    ),
    _row(
        HEURISTIC,
        "Largest-First / Aligned / BLBF (Heuristic)",
        (0.592, 75.15, 49.71, 22.33, 5.63, 0.58, 0),
    ),
    _row(
        LEARNING,
        "PackNN / Aligned / BLBF (Learning)",
        (0.649, 86.41, 70.01, 40.19, 8.15, 0, 0),
    ),
)

_BEAM = {
    HEURISTIC: ((0.592, 22.33, 0.58), (0.632, 31.65, 1.17), (0.686, 48.74, 1.75)),
    LEARNING: ((0.649, 40.19, 0), (0.697, 54.37, 0.19), (0.720, 61.75, 0.39)),
}

_BACKTRACK = {
    HEURISTIC: (
        (0.592, 22.33, 0.58),
        (0.658, 36.89, 1.17),
        (0.693, 49.32, 1.55),
        (0.729, 63.30, 2.33),
    ),
    LEARNING: (
        (0.649, 40.19, 0),
        (0.680, 49.32, 0.19),
        (0.695, 54.56, 0.19),
        (0.715, 62.33, 0.78),
    ),
}

_EASY = (
    _row(HEURISTIC, "Heuristic", (0.822, 81.74, 33.20)),
    _row(LEARNING, "Learning", (0.804, 87.18, 14.56)),
    _row("packnn-easy/aligned/blbf", "Learning* (trained on PackIt-Easy)", (0.830, 88.93, 25.04)),
)

TABLES = {
    "table1": PaperTable("Agents (paper, table 1)", _TABLE_1, _ALL),
    "beam": PaperTable("Beam search: beams", _searches("beam", (1, 2, 4), _BEAM)),
    "backtrack": PaperTable(
        "Backtracking: backtracks", _searches("backtrack", (0, 2, 4, 8), _BACKTRACK)
    ),
    "easy": PaperTable("PackIt-Easy", _EASY, rules=EASY),
    "baselines": PaperTable(
        "Baselines beyond the paper", tuple(PaperRow(agent, agent) for agent in STRONGER), _ALL
    ),
}
"""The tables by name, the argument of `packit reproduce`."""
assert tuple(TABLES) == TABLE_NAMES


@dataclass(frozen=True)
class Reproduced:
    """Our result for a row of a table.

    Attributes
    ----------
    score : Score
        Our score.
    comparison : Comparison | None
        The comparison with the table's `against`; None for that agent.
    """

    row: PaperRow
    score: Score
    comparison: Comparison | None

    def metric(self, name: str) -> Estimate:
        """Return Average Reward for "reward", Success@x in percent for "S@x"."""
        return self.score.reward if name == "reward" else self.score.success[float(name[2:])]


def reproduced(table: PaperTable, rollouts: Sequence[Rollout]) -> tuple[Reproduced, ...]:
    """Compute the rows of a table that were played."""
    played: dict[str, list[Rollout]] = {}
    for rollout in rollouts:
        played.setdefault(rollout.agent, []).append(rollout)
    against = played[table.against]
    return tuple(
        Reproduced(
            row,
            Score.of(row.agent, played[row.agent]),
            None if row.agent == table.against else compare(played[row.agent], against),
        )
        for row in table.rows
        if row.agent in played
    )


def to_json(table: PaperTable, found: Sequence[Reproduced]) -> dict[str, Any]:
    """Return a table in JSON's types: estimates as mean, low and high, and the paper's numbers."""
    return {
        "title": table.title,
        "against": table.against,
        "rows": [
            {
                "agent": each.row.agent,
                "label": each.row.label,
                "tasks": each.score.tasks,
                "ours": {name: asdict(each.metric(name)) for name in table.metrics},
                "paper": dict(each.row.paper),
                "density": asdict(each.score.density),
                "seconds": each.score.seconds,
                "comparison": asdict(each.comparison) if each.comparison else None,
            }
            for each in found
        ],
    }


def markdown(table: PaperTable, found: Sequence[Reproduced]) -> str:
    """Write a table with the paper's numbers below ours, and the comparisons of agents."""
    lines = [f"# {table.title}", "", LEGEND, ""]
    if any(row.paper for row in table.rows):
        lines += [PAPERS_ROWS, ""]
    lines += [
        "| | | " + " | ".join(table.metrics) + " |",
        "|---|---|" + "---|" * len(table.metrics),
    ]
    for each in found:
        ours = (_cell(each.metric(name), name) for name in table.metrics)
        lines.append(f"| {each.row.label} | ours | {' | '.join(ours)} |")
        if each.row.paper:
            paper = (f"{each.row.paper[name]:g}" for name in table.metrics)
            lines.append(f"| | paper | {' | '.join(paper)} |")
    lines += ["", f"Compared with `{table.against}` on the same tasks:", ""]
    base = next(row.paper for row in table.rows if row.agent == table.against)
    columns = ["", "difference", "ratio", "paper's ratio", "wins / ties / losses"]
    if not base:
        columns.remove("paper's ratio")
    lines += [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for each in found:
        if each.comparison is None:
            continue
        difference, ratio = each.comparison.difference, each.comparison.ratio
        counts = (each.comparison.wins, each.comparison.ties, each.comparison.losses)
        cells = [each.row.label, format_estimate(difference, "+.3f"), format_estimate(ratio, ".3f")]
        if base:
            cells.append(f"{each.row.paper['reward'] / base['reward']:.3f}")
        lines.append(f"| {' | '.join(cells)} | {' / '.join(map(str, counts))} |")
    return "\n".join(lines) + "\n"


def draw(table: PaperTable, found: Sequence[Reproduced], path: Path) -> None:
    """Plot bars of Average Reward, ours with intervals, and the paper's if there are any."""
    paper = [each.row.paper["reward"] for each in found if each.row.paper]
    height = 0.9 + (0.55 if paper else 0.3) * len(found)
    with plots.drawn(path, [["reward"]], 8, height) as (figure, axes):
        ax = axes["reward"]
        places = np.arange(len(found))[::-1]
        means = np.array([each.score.reward.mean for each in found])
        ends = np.array([_ends(each.score.reward) for each in found])
        errors = np.abs(ends.T - means)
        half = 0.2 if paper else 0.0
        bar = {"xerr": errors, "capsize": 3, "color": plots.COLORS[0], "label": "ours"}
        ax.barh(places + half, means, 0.38 if paper else 0.6, **bar)
        if paper:
            ax.barh(places - half, paper, 0.38, color=plots.COLORS[4], label="paper (other shapes)")
            figure.legend(loc="outside upper right", ncols=2)
        ax.set_yticks(places, [each.row.label for each in found])
        ax.set_xlim(0, 1)
        ax.set_xlabel("Average Reward, and its 95% bootstrap interval")
        ax.grid(axis="y", visible=False)
        figure.suptitle(table.title, x=0.01, ha="left", weight="bold")


def _cell(estimate: Estimate, metric: str) -> str:
    return format_estimate(estimate, ".3f" if metric == "reward" else ".1f")


def _ends(estimate: Estimate) -> tuple[float, float]:
    """Return the ends of an interval; the mean for both if there is none."""
    if estimate.low is None or estimate.high is None:
        return estimate.mean, estimate.mean
    return estimate.low, estimate.high
