"""The tables of a report: scores, comparisons, and the settings of evaluations and trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from packit_sim.core.confidence import Estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.game.evaluation.evaluation import SUCCESS_LEVELS, Score, compare
from packit_sim.game.evaluation.judging import SCORES
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.reports.runs import EvaluationRun, TrainingRun


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes
    ----------
    low_high : str
        The interval, shown below it.
    value : float | str
        The key to sort by.
    best : bool
        Whether it is the best of its column.
    differs : bool
        Whether it differs from others in its row.
    """

    text: str
    low_high: str = ""
    value: float | str = ""
    best: bool = False
    differs: bool = False


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    name : str
        The heading.
    meaning : str
        The meaning of the numbers, if the heading does not say it.
    """

    name: str
    meaning: str = ""


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    caption : str
        The content of the table.
    rows : tuple[tuple[Cell, ...], ...]
        A cell for each column; the first one names the row.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]


def scores(played: Sequence[EvaluationRun]) -> Table:
    """Tabulate Average Reward, Success@x and density, a row for each agent."""
    found = [(one.name, Score.of(one.rollouts[0].agent, one.rollouts)) for one in played]
    columns = (
        Column("agent"),
        Column("tasks", "played"),
        Column("reward", "Average Reward: mean return"),
        *(
            Column(f"S@{x:g}", f"share of tasks with a return of {x:g} or more, in percent")
            for x in SUCCESS_LEVELS
        ),
        Column("density", "of the boxes at the end"),
        Column("s", "median seconds per task, on a machine that may have done other work as well"),
    )
    measured = [[s.reward, *s.success.values(), s.density] for _, s in found]
    best = [max(estimate.mean for estimate in column) for column in zip(*measured, strict=True)]
    shares = range(1, 1 + len(SUCCESS_LEVELS))
    rows = [
        (
            _name(name),
            _number(score.tasks, "d"),
            *(
                _estimate(
                    estimate,
                    *((".1f", ".0f") if n in shares else (".3f", ".2f")),
                    best=len(found) > 1 and estimate.mean == best[n] > 0,
                )
                for n, estimate in enumerate(estimates)
            ),
            _number(score.seconds, ".2g"),
        )
        for (name, score), estimates in zip(found, measured, strict=True)
    ]
    return Table(
        "Scores over all tasks that each agent played. Below each mean its 95% bootstrap interval; "
        "the highest reward, success and density are marked.",
        columns,
        tuple(rows),
    )


def more_scores(played: Sequence[EvaluationRun]) -> Table | None:
    """Tabulate the means of all further scores that results contain.

    Parameters
    ----------
    played : Sequence[EvaluationRun]
        The results of agents.

    Returns
    -------
    Table | None
        A column for each number that all rollouts of any agent have in `Played.scores`, under its
        name there; None if there is no such number.
    """
    found = [_more_scores(one.rollouts) for one in played]
    names = list(dict.fromkeys(name for scores in found for name in scores))
    if not names:
        return None
    columns = (Column(name, SCORES.get(name, f"mean of {name!r} in the results")) for name in names)
    rows = [
        (_name(one.name), *(_estimate(own.get(name), ".3f", ".2f") for name in names))
        for one, own in zip(played, found, strict=True)
    ]
    return Table(
        "Scores of the boxes at the end: means, and below each its 95% bootstrap interval.",
        (Column("agent"), *columns),
        tuple(rows),
    )


def comparisons(played: Sequence[EvaluationRun]) -> dict[str, Table]:
    """Compare each agent with each other on the tasks that both have played.

    Parameters
    ----------
    played : Sequence[EvaluationRun]
        The results of agents.

    Returns
    -------
    dict[str, Table]
        The numbers of `packit compare` by the name of the other agent.
    """
    columns = (
        Column("agent"),
        Column("tasks", "that both have played"),
        Column("difference", "mean of the differences of returns, task by task"),
        Column("ratio", "of the mean returns"),
        Column("wins", "tasks with a higher return"),
        Column("ties", "tasks with the same return"),
        Column("losses", "tasks with a lower return"),
    )
    tables = {}
    for other in played:
        rows = [_compared(one, other) for one in played if one is not other]
        caption = f"Returns against those of {other.name}, on the same tasks."
        tables[other.name] = Table(caption, columns, tuple(rows))
    return tables


def evaluations(played: Sequence[EvaluationRun]) -> Table:
    """Tabulate the evaluations, file by file."""
    columns = (
        Column("results"),
        Column("agents"),
        Column("tasks"),
        Column("rules"),
        Column("seed"),
        Column("library"),
        Column("box", "cells an axis"),
    )
    played_by: dict[tuple[str, str, int, str, str], list[EvaluationRun]] = {}
    for one in played:
        pack = one.rollouts[0].pack
        ref, box = pack.library, " x ".join(map(str, pack.cells))
        library = f"{ref.name} {ref.version} ({ref.digest[:12]})"
        key = str(one.file), str(one.rules), one.seed, library, box
        played_by.setdefault(key, []).append(one)
    rows = []
    for (file, rules, seed, library, box), agents in played_by.items():
        tasks = {rollout.task for one in agents for rollout in one.rollouts}
        counts = _number(len(agents), "d"), _number(len(tasks), "d")
        rest = _name(rules), _number(seed, "d"), _name(library), _name(box)
        rows.append((_name(file), *counts, *rest))
    return Table("What was played.", columns, tuple(rows))


def trainings(learned: Sequence[TrainingRun]) -> Table:
    """Tabulate the validation results of each training."""
    columns = (
        Column("training"),
        Column("steps", "so far"),
        Column("best", "highest Average Reward in validation"),
        Column("after", "steps, at that point"),
        Column("last", "Average Reward in the last validation"),
    )
    rows = [
        (
            _name(one.name),
            _number(one.run.curve[-1].steps, ",d"),
            _estimate(one.run.best.validation, ".3f", ".3f"),
            _number(one.run.best.steps, ",d"),
            _estimate(one.run.curve[-1].validation, ".3f", ".3f"),
        )
        for one in learned
    ]
    return Table("What trainings reached on their validation tasks.", columns, tuple(rows))


def settings(learned: Sequence[TrainingRun]) -> Table:
    """Tabulate the settings of trainings side by side; those that differ are marked."""
    names = dict.fromkeys(name for one in learned for name in one.run.settings)
    rows = []
    for name in names:
        values = [_plain(one.run.settings.get(name)) for one in learned]
        differs = len(set(values)) > 1
        rows.append((_name(name), *(Cell(v, value=v, differs=differs) for v in values)))
    columns = (Column("setting"), *(Column(one.name) for one in learned))
    return Table("Settings of the trainings; those that differ are marked.", columns, tuple(rows))


def _more_scores(rollouts: Sequence[Rollout]) -> Mapping[str, Estimate]:
    first, *rest = (rollout.played.scores for rollout in rollouts)
    return {
        name: Estimate.of([float(scores[name]) for scores in (first, *rest)])
        for name in first
        if all(name in scores for scores in rest)
    }


def _compared(one: EvaluationRun, other: EvaluationRun) -> tuple[Cell, ...]:
    try:
        found = compare(one.rollouts, other.rollouts)
    except ArgumentError:  # no task that both have played
        return _name(one.name), _number(0, "d"), *(Cell("") for _ in range(5))
    return (
        _name(one.name),
        _number(found.pairs, "d"),
        _estimate(found.difference, "+.3f", "+.3f"),
        _estimate(found.ratio, ".3f", ".3f"),
        *(_number(count, "d") for count in (found.wins, found.ties, found.losses)),
    )


def _name(text: str) -> Cell:
    return Cell(text, value=text)


def _number(value: float, spec: str) -> Cell:
    return Cell(format(value, spec), value=value)


def _estimate(estimate: Estimate | None, mean_spec: str, spec: str, *, best: bool = False) -> Cell:
    if estimate is None:
        return Cell("")
    ends = (estimate.low, estimate.high)
    low_high = " to ".join(format(end, spec) for end in ends if end is not None)
    return Cell(format(estimate.mean, mean_spec), low_high, estimate.mean, best)


def _plain(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    return str(value)
