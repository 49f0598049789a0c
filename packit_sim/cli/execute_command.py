"""`packit execute`: an arm packs the boxes that agents plan, in physics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import (
    DatasetLibraryOption,
    DecompositionOption,
    SeedOption,
    SplitOption,
    WorkersOption,
    checked_dataset,
    packing_file,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.game.datasets.builtin import STARTER_PACKS
from packit_sim.physics.convex.settings import METHODS, DecompositionSettings

with lazy_imports():
    from packit_sim.cli import evaluations, inputs, output, terminal
    from packit_sim.core import files as core_files
    from packit_sim.core import parallel
    from packit_sim.game.datasets import pack_files
    from packit_sim.game.evaluation import executed, results
    from packit_sim.parts.results import execution
    from packit_sim.render import films, robot_films, video
    from packit_sim.robot import cell as robot
    from packit_sim.robot import replays

if TYPE_CHECKING:
    from packit_sim.robot.executed_item import ExecutedItem
    from packit_sim.robot.trajectory import Trajectory

FILM_FPS = 12
"""Frames per second of a film, in which time runs four times as fast."""


def execute_command(
    dataset: Annotated[
        str,
        typer.Argument(
            metavar="DATASET",
            autocompletion=completion.datasets,
            help="Dataset or results: a name (see `packit datasets list`), a folder or a file; or "
            "a packing: a .json file, or the folder of `packit pack`.",
        ),
    ] = STARTER_PACKS,
    split: SplitOption = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            autocompletion=completion.agents,
            help="Agent without a search (see `packit agents list`); may be repeated; default: "
            "stable-champion.",
        ),
    ] = None,
    arm: Annotated[
        str,
        typer.Option(help="gantry, panda, or a URDF file of a machine with the gantry's joints."),
    ] = "gantry",
    level: Annotated[
        int,
        typer.Option(
            help="1: items are presented in the rotation of their placement; 2: in a random stable "
            "pose, and gantry or panda turn them."
        ),
    ] = 1,
    edge: Annotated[
        float | None,
        typer.Option(help="Metres in a box unit; default: 0.3. Packings keep their real size."),
    ] = None,
    moves: Annotated[
        int,
        typer.Option(
            help="Most straight moves to insert an item; with 1 it comes straight down. More are "
            "for packings, --stored, and agents with --all-masks."
        ),
    ] = 1,
    open_loop: Annotated[
        bool, typer.Option("--open-loop", help="Plan without seeing where items really are.")
    ] = False,
    stored: Annotated[
        bool,
        typer.Option("--stored", help="Execute the stored placements, without an agent."),
    ] = False,
    reachable: Annotated[
        bool | None,
        typer.Option(
            "--reachable/--all-masks",
            help="Show agents only placements that the arm can hold and reach (the default), or "
            "all.",
        ),
    ] = None,
    seed: SeedOption = 0,
    library: DatasetLibraryOption = None,
    tasks: Annotated[
        int | None, typer.Option(min=1, help="Execute only the first N tasks.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Results file, with a folder of trajectories next to it; results that it already "
            "contains are not executed again.",
        ),
    ] = None,
    replay: Annotated[
        Path | None,
        typer.Option(
            help="Folder for files with which other simulators replay the trajectories of plans: "
            "JSON, URDF and meshes."
        ),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            help="Film of the first box, with the arm: .gif or .mp4. For agents it needs --out, "
            "which keeps trajectories."
        ),
    ] = None,
    decomposition: DecompositionOption = METHODS[0],
    workers: WorkersOption = 0,
) -> None:
    """Let an arm pack the boxes that agents plan, or your own packings, in simulated physics.

    The agent sees where the items really are before each choice. With --out the command can be
    stopped at any time: repeat it to resume. `packit verify` recomputes the measures from the
    recorded trajectories. The parts of a packing, such as the record of `packit pack`, are put in
    straight from above, in the order of the file; --stored does so with items of packs or results.

    Example: packit execute everyday-v1 --split test --tasks 10 --out executed.jsonl

    Example: packit execute packed
    """
    cell = robot.RobotCell(
        arm=arm,
        edge=0.30 if edge is None else edge,
        level=level,
        moves=moves,
        open_loop=open_loop,
        reachable=reachable is not False,
        seed=seed,
        decomposition=DecompositionSettings(method=decomposition),
    )
    if film is not None:
        video.require(film)
        output.prepare_folder(film, dataset)
    packing = packing_file(dataset)
    if moves > 1 and not (packing or stored or reachable is False):
        raise ArgumentError(
            f"--moves {moves} has no effect on masks of ways straight from above: add --all-masks"
        )
    if packing or stored:
        what = "a packing" if packing else "not planned again"
        unused: dict[str, object] = {"--agent": agent, "--reachable": reachable, "--out": out}
        if packing:
            unused |= {"--split": split, "--library": library, "--tasks": tasks, "--edge": edge}
        for option, value in unused.items():
            if value is not None:
                raise ArgumentError(
                    f"{option} has no effect on {dataset}, which is {what}: leave it out"
                )
        for file in sorted(replay.glob("box-*/replay.json")) if replay else ():
            core_files.require_replaceable(file, field=replays.FORMAT)
        with stoppable("the plan is not executed"), terminal.progress_bars() as progress:
            bar = progress.add_task("executing", total=None, note="items")

            def note(_: tuple[ExecutedItem, ...]) -> None:
                progress.advance(bar)

            if packing:
                plans = execution.execute_packing(packing, cell, note)
            else:
                checked_dataset(dataset)
                opened = inputs.open_library(library, dataset, split)
                packs = pack_files.read_packs(pack_files.dataset_file(dataset, split))
                plans = [executed.execute_pack(pack, opened, cell, note) for pack in packs[:tasks]]
        terminal.console.print(evaluations.plan_table(plans))
        if replay is not None:
            for number, plan in enumerate(plans):
                folder = replay / f"box-{number}"
                output.print_written(replays.write_replay(plan.trajectory, folder))
        if film is not None:
            _film(plans[0].trajectory, film)
        return
    if replay is not None:
        raise ArgumentError(
            f"--replay has no effect on {dataset}: it is for packings (.json), and for --stored"
        )
    if film is not None and out is None:
        raise ArgumentError(f"--film {film} needs --out, which keeps the trajectories")
    checked_dataset(dataset)
    rules = packit_sim.Rules(robot=cell)
    agents = [
        packit_sim.Agent.from_name(name) for name in dict.fromkeys(agent or ["stable-champion"])
    ]
    for one in agents:
        one.check_rules(rules)
    opened = inputs.open_library(library, dataset, split)
    numbered = evaluations.usable_tasks(dataset, opened, split, tasks)
    wanted = list(numbered.values())
    for task in wanted:
        rules.check_items(task.cells, task.items)
    if out is not None:
        output.prepare_folder(out, dataset)
    hint = RESUMABLE if out else "no results file was given"
    with stoppable(hint), parallel.Workers(workers, "loky", None) as processes:
        shapes = [item.shape for task in wanted for item in task.items]
        inputs.decompose_shown(shapes, cell.decomposition, workers)
        rollouts = evaluations.evaluate_shown(
            agents, wanted, seed, rules, workers=processes, file=out, numbers=list(numbered)
        )
    evaluations.show_agents(one.name for one in agents)
    own = [evaluations.of_agent(rollouts, one.name) for one in agents]
    terminal.console.print(evaluations.execution_table(own))
    if out is not None:
        output.print_written(out)
    if film is not None and out is not None:
        _film(results.stored_trajectory(out, own[0][0], opened), film)


def _film(trajectory: Trajectory, file: Path) -> None:
    """Film how the arm packed a box."""
    box, frames = robot_films.executing(trajectory, fps=FILM_FPS)
    video.write(file, films.shot(box, frames), FILM_FPS)
    output.print_written(file)
