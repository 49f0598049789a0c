"""`packit record`: episodes of agents as data for learning."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import (
    DatasetArgument,
    DatasetLibraryOption,
    SeedOption,
    SplitOption,
    WorkersOption,
)
from packit_sim.cli.stopping import NOTHING_WRITTEN, RESUMABLE, stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import inputs, output, terminal
    from packit_sim.core import parallel
    from packit_sim.game.datasets import pack_files
    from packit_sim.game.envs import recording
    from packit_sim.game.episodes import agents as episode_agents
    from packit_sim.game.evaluation import transitions as recorded


def record_command(
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the recording.")],
    split: SplitOption = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            autocompletion=completion.agents,
            help="Agent that plays; default: the solutions of the tasks. With --transitions it "
            "may be repeated, and agents take turns; default: largest-first/aligned/blbf.",
        ),
    ] = None,
    transitions: Annotated[
        bool,
        typer.Option(
            "--transitions",
            help="Record every placement as arrays: cells and heights of the box, item, mask.",
        ),
    ] = False,
    shards: Annotated[int, typer.Option(min=1, help="With --transitions, number of files.")] = 10,
    episodes: Annotated[
        int, typer.Option(min=1, help="With --transitions, episodes in each file.")
    ] = 100,
    seed: SeedOption = 0,
    library: DatasetLibraryOption = None,
    workers: WorkersOption = 0,
) -> None:
    """Record episodes of agents: in the format of Minari, or as transitions.

    Without --transitions each task is played once, and the extra learn is needed. With it, tasks
    are drawn at random, and the command can be stopped at any time: repeat it to resume, or with
    more shards to extend the recording.

    Example: packit record everyday-v1 --split train --transitions --out transitions
    """
    if not transitions:
        import gymnasium

        if len(agent or ()) > 1:
            raise ArgumentError("one agent is recorded at a time without --transitions")
        player = packit_sim.Agent.from_name(agent[0]) if agent else episode_agents.GROUND_TRUTH
        with stoppable(NOTHING_WRITTEN):
            played = recording.record(
                gymnasium.make("PackIt-v0", tasks=dataset, split=split, library=library),
                out,
                player,
                seed=seed,
            )
        output.print_written(out, f": {played.total_steps:,} steps")
        return
    tasks = pack_files.load_tasks(dataset, inputs.open_library(library, dataset, split), split)
    names = agent or ["largest-first/aligned/blbf"]
    agents = [packit_sim.Agent.from_name(name) for name in names]
    with (
        stoppable(RESUMABLE),
        terminal.progress_bars() as progress,
        parallel.Workers(workers) as processes,
    ):
        bar = progress.add_task("recording", total=shards, note="")
        manifest = recorded.record_transitions(
            out,
            tasks,
            agents,
            shards,
            episodes=episodes,
            seed=seed,
            workers=processes,
            on_shard=lambda shard: progress.update(bar, advance=1, note=shard.file),
        )
        progress.update(bar, completed=shards)
    output.print_written(out, f": {manifest.steps:,} steps")
