"""`packit evaluate` and `packit compare`: agents on tasks, and their comparison."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from packit_sim.cli.console import (
    AddressOption,
    BackendOption,
    DatasetArgument,
    DatasetLibraryOption,
    DecompositionOption,
    SeedOption,
    SplitOption,
    WorkersOption,
    console,
    decompose_shown,
    open_library,
    prepare_folder,
    progress_bars,
)
from packit_sim.cli.output import RESUMABLE, check_shown, print_written, simple_table, stoppable
from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import STARTER_PACKS, dataset_file, read_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import SUCCESS_LEVELS, Score, compare, evaluate
from packit_sim.game.evaluation.judging import SCORES, is_judged, judge
from packit_sim.game.evaluation.results import Rollout, read_results
from packit_sim.game.evaluation.training_runs import score_runs
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.convex.decomposition import require
from packit_sim.physics.convex.settings import METHODS, DecompositionSettings, Method
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.rules import PACKIT, RotationSet, Rules

HEURISTICS = tuple(
    "/".join(parts)
    for parts in itertools.product(
        ("random", "largest-first"), ("random", "aligned"), ("random", "blbf")
    )
)
"""Every combination of the paper's heuristics."""


def evaluate_command(
    dataset: DatasetArgument = STARTER_PACKS,
    split: SplitOption = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="Agent SHAPE/ROTATION/LOCATION with an optional +SEARCH=VALUE, such as "
            "largest-first/aligned/blbf+beam=4 (see `packit agents list`); may be repeated; "
            "default: the paper's eight heuristics."
        ),
    ] = None,
    seed: SeedOption = 0,
    library: DatasetLibraryOption = None,
    easy: Annotated[bool, typer.Option("--easy", help="Play by the rules of PackIt-Easy.")] = False,
    kinematic: Annotated[
        bool, typer.Option("--kinematic", help="Insert items straight down from the open top only.")
    ] = False,
    physics: Annotated[
        bool, typer.Option("--physics", help="Let all items settle after each placement.")
    ] = False,
    buffer: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="K", help="Play online: items arrive one by one, K of them are visible."
        ),
    ] = None,
    rotations: Annotated[
        RotationSet, typer.Option(help="Rotations that items may have: 24, or four about z.")
    ] = "all",
    tasks: Annotated[int | None, typer.Option(min=1, help="Play only the first N tasks.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Results file; results that it already contains are not played again.",
        ),
    ] = None,
    scores: Annotated[
        bool,
        typer.Option("--scores", help="Also score stability, insertability and floating items."),
    ] = False,
    decomposition: DecompositionOption = METHODS[0],
    workers: WorkersOption = 0,
    backend: BackendOption = "loky",
    address: AddressOption = None,
) -> None:
    """Let agents play the tasks of a dataset and print the paper's table.

    With --out the command can be stopped at any time: repeat it to resume. With --scores each box
    is simulated under gravity and disassembled. This takes seconds per task; the first time, its
    shapes are also decomposed.

    Example: packit evaluate everyday-v1 --split test --agent largest-first/aligned/blbf
    """
    if scores and physics:
        raise ArgumentError("--scores and --physics exclude each other: items already settled")
    settings = DecompositionSettings(method=decomposition)
    if scores or physics:
        require(settings)
    world = PhysicsSettings(decomposition=settings) if physics else None
    rules = Rules(easy, kinematic, world, buffer=buffer, rotations=rotations)
    agents = [Agent.from_name(name) for name in dict.fromkeys(agent or HEURISTICS)]
    opened = open_library(library, dataset, split)
    numbered = _usable_tasks(dataset, opened, split, tasks)
    wanted, numbers = list(numbered.values()), list(numbered)
    if out is not None:
        prepare_folder(out, dataset)
    hint = RESUMABLE if out else "no results file was given"
    with stoppable(hint), Workers(workers, backend, address) as processes:
        if (physics or scores) and backend == "loky":  # a cluster's machines have other caches
            shapes = [item.shape for task in wanted for item in task.items]
            decompose_shown(shapes, settings, workers)
        rollouts = evaluate_shown(
            agents, wanted, seed, rules, workers=processes, file=out, numbers=numbers
        )
        if scores:
            rollouts = judge_shown(rollouts, opened, decomposition, workers=processes, file=out)
    show_agents(agent.name for agent in agents)
    table = score_table([Score.of(agent.name, rollouts) for agent in agents])
    table.caption = (
        f"tasks: {len(wanted)}, seed: {seed}, rules: {rules}; below each mean its 95% bootstrap "
        "interval; s: median processor seconds a task"
    )
    console.print(table)
    own = [_of(rollouts, agent.name) for agent in agents]
    if scores:
        console.print(verdict_table(own))
    if len(own) > 1:
        others = enumerate(own[1:], start=2)
        console.print(comparison_table((n, 1, compare(each, own[0])) for n, each in others))
    if out is not None:
        print_written(out)


def _usable_tasks(
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


def compare_command(
    results: Annotated[
        list[Path],
        typer.Argument(
            help="One or two results files of `packit evaluate`; with --runs any number."
        ),
    ],
    runs: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Names of agents, with * for any text, that are training runs of one method; may "
            "be repeated, once for each method.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0,
            metavar="SECONDS",
            help="Compare the best returns after this number of processor seconds on a task; "
            "default: at the end.",
        ),
    ] = None,
) -> None:
    """Compare agents on the tasks that both have played.

    With one file, its agents are compared with each other. With two files, the agents of the first
    are compared with those of the second.

    With --runs, methods are compared that were trained several times: means and interquartile
    means, with intervals over runs and tasks, and differences to the first method. A method whose
    name is in several files has a run in each.

    Example: packit compare mine.jsonl yours.jsonl

    Example: packit compare results.jsonl --runs "learned@seed-*" --runs "largest-first/*"
    """
    if runs:
        if seconds is not None:
            raise ArgumentError("--seconds has no effect with --runs: leave it out")
        _compare_runs(results, runs)
        return
    if len(results) > 2:
        raise ArgumentError(f"{len(results)} files can't be compared: give one or two")
    found = [read_results(file) for file in results]
    for file, rollouts in zip(results, found, strict=True):
        check_shown(file, rollouts)
    played = [[(name, _of(each, name)) for name in _agents(each)] for each in found]
    numbered = list(enumerate(itertools.chain(*played), start=1))
    if len(played) == 1:
        pairs = list(itertools.combinations(numbered, 2))
        if not pairs:
            raise ArgumentError(f"{results[0]} contains one agent only: give a second file")
    else:
        count = len(played[0])
        pairs = list(itertools.product(numbered[:count], numbered[count:]))
    try:
        rows = [(n, m, compare(a, b, seconds)) for (n, (_, a)), (m, (_, b)) in pairs]
    except ArgumentError as error:
        raise ArgumentError(f"{' and '.join(map(str, results))}: {error}") from None
    show_agents(name for _, (name, _) in numbered)
    console.print(comparison_table(rows))


def _compare_runs(files: Sequence[Path], patterns: Sequence[str]) -> None:
    """Print the scores of methods, each with the runs whose agents match its pattern."""
    played = []
    for file in files:
        rollouts = read_results(file)
        check_shown(file, rollouts)
        played += [(name, _of(rollouts, name)) for name in _agents(rollouts)]
    methods = {
        pattern: [rollouts for name, rollouts in played if fnmatchcase(name, pattern)]
        for pattern in patterns
    }
    for pattern, found in methods.items():
        if not found:
            names = ", ".join(dict.fromkeys(name for name, _ in played))
            raise ArgumentError(f"--runs {pattern!r} matches no agent: the results have {names}")
    show_agents(methods)
    table = _number_table(
        "", "runs", "tasks", "mean", "middle half", "worst run", "best run", "difference"
    )
    for number, score in enumerate(score_runs(methods), start=1):
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
    console.print(table)


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


def score_table(scores: Sequence[Score]) -> Table:
    """Create the paper's table 1, one row per agent, by its number."""
    levels = (f"S@{x:g}" for x in SUCCESS_LEVELS)
    table = _number_table("", "reward", *levels, "density", "s")
    for number, score in enumerate(scores, start=1):
        table.add_row(
            str(number),
            interval(score.reward, ".3f", ".2f"),
            *(interval(estimate, ".1f", ".0f") for estimate in score.success.values()),
            interval(score.density, ".3f", ".2f"),
            f"{score.seconds:.2g}",
        )
    return table


def verdict_table(own: Sequence[Sequence[Rollout]]) -> Table:
    """Create a table of scores, one row per agent, by its number, from its rollouts."""
    table = _number_table("", "density", "reward", *SCORES)
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


def comparison_table(
    comparisons: Iterable[tuple[int | str, int | str, Comparison]],
) -> Table:
    """Create a table of pairs of agents, by their numbers."""
    table = _number_table("", "against", "tasks", "difference", "ratio", "wins", "ties", "losses")
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


def interval(estimate: Estimate, mean_spec: str, spec: str) -> str:
    """Format a mean with its interval below it."""
    mean = format(estimate.mean, mean_spec)
    if estimate.low is None or estimate.high is None:
        return mean
    return f"{mean}\n[dim]{format(estimate.low, spec)} {format(estimate.high, spec)}[/]"


def _number_table(*columns: str) -> Table:
    table = simple_table(padding=(0, 1, 0, 0))
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def show_agents(names: Iterable[str]) -> None:
    """Print the agents behind the numbers of a table."""
    for number, name in enumerate(names, start=1):
        console.print(f"[bold]{number}[/] {escape(name)}", highlight=False, soft_wrap=True)


def _agents(rollouts: Iterable[Rollout]) -> list[str]:
    return list(dict.fromkeys(rollout.agent for rollout in rollouts))


def _of(rollouts: Iterable[Rollout], agent: str) -> list[Rollout]:
    return [rollout for rollout in rollouts if rollout.agent == agent]
