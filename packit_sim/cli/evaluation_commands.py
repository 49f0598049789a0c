"""`packit evaluate` and `packit compare`: agents on tasks, and their comparison."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import (
    AddressOption,
    BackendOption,
    BufferOption,
    DatasetArgument,
    DatasetLibraryOption,
    DecompositionOption,
    KinematicOption,
    RotationsOption,
    SeedOption,
    SplitOption,
    WorkersOption,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.game.datasets.builtin import STARTER_PACKS
from packit_sim.physics.convex.settings import METHODS, DecompositionSettings
from packit_sim.physics.settings import PhysicsSettings

with lazy_imports():
    from packit_sim.cli import evaluations, inputs, output, terminal
    from packit_sim.core import parallel
    from packit_sim.game.evaluation import training_runs
    from packit_sim.physics.convex import decomposition as convex


def evaluate_command(
    dataset: DatasetArgument = STARTER_PACKS,
    split: SplitOption = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            autocompletion=completion.agents,
            help="Agent SHAPE/ROTATION/LOCATION with an optional +SEARCH=VALUE, such as "
            "largest-first/aligned/blbf+beam=4 (see `packit agents list`); may be repeated; "
            "default: the paper's eight heuristics.",
        ),
    ] = None,
    seed: SeedOption = 0,
    library: DatasetLibraryOption = None,
    easy: Annotated[bool, typer.Option("--easy", help="Play by the rules of PackIt-Easy.")] = False,
    kinematic: KinematicOption = False,
    physics: Annotated[
        bool, typer.Option("--physics", help="Let all items settle after each placement.")
    ] = False,
    buffer: BufferOption = None,
    rotations: RotationsOption = "all",
    values: Annotated[
        bool, typer.Option("--values", help="Count the values of the items, not their volumes.")
    ] = False,
    support: Annotated[
        float,
        typer.Option(
            min=0,
            max=1,
            metavar="SHARE",
            help="Least share of an item's base that rests on something.",
        ),
    ] = 0.0,
    boxes: Annotated[int, typer.Option(min=1, help="Pack each task into N equal boxes.")] = 1,
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
        raise ArgumentError("--scores and --physics exclude each other: choose one")
    settings = DecompositionSettings(method=decomposition)
    if scores or physics:
        convex.require(settings)
    world = PhysicsSettings(decomposition=settings) if physics else None
    rules = packit_sim.Rules(
        easy,
        kinematic,
        world,
        buffer=buffer,
        rotations=rotations,
        values=values,
        support=support,
        boxes=boxes,
    )
    agents = [
        packit_sim.Agent.from_name(name) for name in dict.fromkeys(agent or evaluations.HEURISTICS)
    ]
    opened = inputs.open_library(library, dataset, split)
    numbered = evaluations.usable_tasks(dataset, opened, split, tasks)
    wanted, numbers = list(numbered.values()), list(numbered)
    if out is not None:
        output.prepare_folder(out, dataset)
    hint = RESUMABLE if out else "no results file was given"
    with stoppable(hint), parallel.Workers(workers, backend, address) as processes:
        if (physics or scores) and backend == "loky":  # a cluster's machines have other caches
            shapes = [item.shape for task in wanted for item in task.items]
            inputs.decompose_shown(shapes, settings, workers)
        rollouts = evaluations.evaluate_shown(
            agents, wanted, seed, rules, workers=processes, file=out, numbers=numbers
        )
        if scores:
            rollouts = evaluations.judge_shown(
                rollouts, opened, decomposition, workers=processes, file=out
            )
    evaluations.show_agents(agent.name for agent in agents)
    table = evaluations.score_table([packit_sim.Score.of(agent.name, rollouts) for agent in agents])
    table.caption = (
        f"tasks: {len(wanted)}, seed: {seed}, rules: {rules}; below each mean its 95% bootstrap "
        "interval; s: median processor seconds a task"
    )
    terminal.console.print(table)
    own = [evaluations.of_agent(rollouts, agent.name) for agent in agents]
    if scores:
        terminal.console.print(evaluations.verdict_table(own))
    if len(own) > 1:
        others = enumerate(own[1:], start=2)
        terminal.console.print(
            evaluations.comparison_table(
                (n, 1, packit_sim.compare(each, own[0])) for n, each in others
            )
        )
    if out is not None:
        output.print_written(out)


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

    With --runs, methods that were trained several times are compared by means and interquartile
    means, with intervals over runs and tasks, and by differences to the first method. A method
    whose name is in several files has a run in each.

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
    found = [packit_sim.read_results(file) for file in results]
    for file, rollouts in zip(results, found, strict=True):
        inputs.check_shown(file, rollouts)
    played = [
        [(name, evaluations.of_agent(each, name)) for name in evaluations.agents_of(each)]
        for each in found
    ]
    numbered = list(enumerate(itertools.chain(*played), start=1))
    if len(played) == 1:
        pairs = list(itertools.combinations(numbered, 2))
        if not pairs:
            raise ArgumentError(f"{results[0]} contains one agent only: give a second file")
    else:
        count = len(played[0])
        pairs = list(itertools.product(numbered[:count], numbered[count:]))
    try:
        rows = [(n, m, packit_sim.compare(a, b, seconds)) for (n, (_, a)), (m, (_, b)) in pairs]
    except ArgumentError as error:
        raise ArgumentError(f"{' and '.join(map(str, results))}: {error}") from None
    evaluations.show_agents(name for _, (name, _) in numbered)
    terminal.console.print(evaluations.comparison_table(rows))


def _compare_runs(files: Sequence[Path], patterns: Sequence[str]) -> None:
    """Print the scores of methods, each with the runs whose agents match its pattern."""
    played = []
    for file in files:
        rollouts = packit_sim.read_results(file)
        inputs.check_shown(file, rollouts)
        names = evaluations.agents_of(rollouts)
        played += [(name, evaluations.of_agent(rollouts, name)) for name in names]
    methods = {
        pattern: [rollouts for name, rollouts in played if fnmatchcase(name, pattern)]
        for pattern in patterns
    }
    for pattern, found in methods.items():
        if not found:
            known = ", ".join(dict.fromkeys(name for name, _ in played))
            raise ArgumentError(f"--runs {pattern!r} matches no agent: the results have {known}")
    evaluations.show_agents(methods)
    terminal.console.print(evaluations.run_table(training_runs.score_runs(methods)))
