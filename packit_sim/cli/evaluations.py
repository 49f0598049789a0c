"""Evaluations with progress bars, and tables of their results."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.markup import escape

from packit_sim.cli.output import NumberTable
from packit_sim.cli.terminal import console, progress_bars
from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.errors import MeshError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import dataset_file, read_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import SUCCESS_LEVELS, Score, evaluate
from packit_sim.game.evaluation.judging import SCORES, is_judged, judge
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.evaluation.training_runs import RunsScore
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.convex.settings import Method
from packit_sim.robot.measures import MEASURES
from packit_sim.robot.plans import ExecutedPlan
from packit_sim.rules import PACKIT, Rules

HEURISTICS = tuple(
    "/".join(parts)
    for parts in itertools.product(
        ("random", "largest-first"), ("random", "aligned"), ("random", "blbf")
    )
)
"""Every combination of the paper's heuristics."""


def usable_tasks(
    dataset: str, library: ShapeLibrary, split: str | None, limit: int | None
) -> dict[int, Task]:
    """Load tasks by their numbers, and print those with a mesh that can't be used."""
    packs = read_packs(dataset_file(dataset, split))[:limit]
    tasks = {}
    for number, pack in enumerate(packs):
        try:
            tasks[number] = pack.task(library)
        except MeshError as error:
            console.print(
                f"skipped task {number}: {error}", style="yellow", markup=False, soft_wrap=True
            )
    if not tasks:
        raise MeshError(f"{dataset}: each of its {len(packs)} tasks has a mesh that can't be used")
    return tasks


def evaluate_shown(
    agents: Sequence[Agent],
    tasks: Sequence[Task],
    seed: int,
    rules: Rules = PACKIT,
    *,
    workers: Workers | None = None,
    file: Path | None = None,
    numbers: Sequence[int] | None = None,
) -> list[Rollout]:
    """Evaluate agents as `evaluate` does, with a progress bar."""
    with progress_bars() as progress:
        total = len(agents) * len(tasks)
        bar = progress.add_task("playing", total=total, note="")
        played = 0

        def show(rollout: Rollout) -> None:
            nonlocal played
            played += 1
            progress.update(bar, completed=played, note=rollout.agent)

        rollouts = evaluate(
            agents, tasks, seed, show, rules=rules, workers=workers, file=file, numbers=numbers
        )
        progress.update(bar, completed=total, note="")
    return rollouts


def judge_shown(
    rollouts: Sequence[Rollout],
    library: ShapeLibrary,
    pieces: Method,
    *,
    workers: Workers | None = None,
    file: Path | None = None,
) -> list[Rollout]:
    """Judge results as `judge` does, with a progress bar."""
    with progress_bars() as progress:
        known = sum(is_judged(rollout, pieces) for rollout in rollouts)
        bar = progress.add_task("judging", total=len(rollouts), completed=known, note="")

        def show(rollout: Rollout) -> None:
            progress.update(bar, advance=1, note=rollout.agent)

        judged = judge(rollouts, library, pieces, show, workers=workers, file=file)
        progress.update(bar, note="")
    return judged


def score_table(scores: Sequence[Score]) -> NumberTable:
    """Create the paper's table 1, one row per agent, by its number."""
    levels = (f"S@{x:g}" for x in SUCCESS_LEVELS)
    table = NumberTable("", "reward", *levels, "density", "s")
    for number, score in enumerate(scores, start=1):
        table.add_row(
            str(number),
            interval(score.reward, ".3f", ".2f"),
            *(interval(estimate, ".1f", ".0f") for estimate in score.success.values()),
            interval(score.density, ".3f", ".2f"),
            f"{score.seconds:.3g}",
        )
    return table


def verdict_table(own: Sequence[Sequence[Rollout]]) -> NumberTable:
    """Create a table of scores, one row per agent, by its number, from its rollouts."""
    table = NumberTable("", "density", "reward", *SCORES)
    for number, rollouts in enumerate(own, start=1):
        score = Score.of(rollouts[0].agent, rollouts)
        estimates = [Estimate.of([r.played.scores[name] for r in rollouts]) for name in SCORES]
        cells = [interval(estimate, ".3f", ".2f") for estimate in (score.density, score.reward)]
        cells += [interval(estimate, ".3f", ".2f") for estimate in estimates]
        table.add_row(str(number), *cells)
    table.caption = (
        f"boxes of {len(own[0])} tasks after the last step: shares of the placed volume, and "
        "the number of floating items; below each mean its 95% bootstrap interval"
    )
    return table


def execution_table(own: Sequence[Sequence[Rollout]]) -> NumberTable:
    """Create a table of executions, one row per agent, by its number, from its rollouts."""
    table = NumberTable("", "executed", *MEASURES, "s")
    for number, rollouts in enumerate(own, start=1):
        score = Score.of(rollouts[0].agent, rollouts)
        found = [Estimate.of([r.played.scores[name] for r in rollouts]) for name in MEASURES]
        cells = [interval(estimate, ".3f", ".3f") for estimate in found]
        deepest = max(r.played.scores["penetration"] for r in rollouts)
        cells[MEASURES.index("penetration")] = f"{deepest:.4f}\n[dim]largest[/]"
        table.add_row(
            str(number), interval(score.reward, ".3f", ".3f"), *cells, f"{score.seconds:.3g}"
        )
    table.caption = (
        f"means of {len(own[0])} tasks: returns, m and degrees of placed items, items, and "
        "seconds; s: median processor seconds a task; below each mean its 95% bootstrap interval"
    )
    return table


def plan_table(boxes: Sequence[ExecutedPlan]) -> NumberTable:
    """Create a table of executed plans, one row per box."""
    table = NumberTable("box", "items", "inside", "executed", *MEASURES)
    for number, box in enumerate(boxes):
        scores = (f"{box.scores[name]:.3g}" for name in MEASURES)
        items = len(box.trajectory.attempts)
        table.add_row(str(number), str(items), str(box.inside), f"{box.executed:.3f}", *scores)
    table.caption = "executed, planned: shares of the volume of all items; m, degrees, seconds"
    return table


def comparison_table(
    comparisons: Iterable[tuple[int | str, int | str, Comparison]],
) -> NumberTable:
    """Create a table of pairs of agents, by their numbers."""
    table = NumberTable("", "against", "tasks", "difference", "ratio", "wins", "ties", "losses")
    for first, second, found in comparisons:
        table.add_row(
            str(first),
            str(second),
            str(found.pairs),
            interval(found.difference, "+.3f", "+.3f"),
            interval(found.ratio, ".3f", ".3f"),
            *map(str, (found.wins, found.ties, found.losses)),
        )
    table.caption = "returns on the same tasks; below each mean its 95% bootstrap interval"
    return table


def run_table(scores: Sequence[RunsScore]) -> NumberTable:
    """Create a table of methods, by their numbers, over their training runs."""
    table = NumberTable(
        "", "runs", "tasks", "mean", "middle half", "worst run", "best run", "difference"
    )
    for number, score in enumerate(scores, start=1):
        table.add_row(
            str(number),
            str(score.runs),
            str(score.tasks),
            interval(score.mean, ".3f", ".3f"),
            interval(score.iqm, ".3f", ".3f"),
            f"{score.worst:.3f}",
            f"{score.best:.3f}",
            interval(score.difference, "+.3f", "+.3f") if number > 1 else "",
        )
    table.caption = (
        "returns on the tasks that all runs have played; middle half: the interquartile mean; "
        "below each mean its 95% bootstrap interval over runs and tasks"
    )
    return table


def interval(estimate: Estimate, mean_spec: str, spec: str) -> str:
    """Format a mean with its interval below it, in brackets."""
    mean = format(estimate.mean, mean_spec)
    if estimate.low is None or estimate.high is None:
        return mean
    return f"{mean}\n[dim]\\[{format(estimate.low, spec)} {format(estimate.high, spec)}][/]"


def show_agents(names: Iterable[str]) -> None:
    """Print the agents behind the numbers of a table."""
    for number, name in enumerate(names, start=1):
        console.print(f"[bold]{number}[/] {escape(name)}", highlight=False, soft_wrap=True)


def agents_of(rollouts: Iterable[Rollout]) -> list[str]:
    """List the agents of rollouts, each once."""
    return list(dict.fromkeys(rollout.agent for rollout in rollouts))


def of_agent(rollouts: Iterable[Rollout], agent: str) -> list[Rollout]:
    """Select the rollouts of an agent."""
    return [rollout for rollout in rollouts if rollout.agent == agent]
