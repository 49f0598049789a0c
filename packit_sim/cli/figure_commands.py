"""`packit figures`: the paper's figures, from our data."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli.console import (
    LibraryOption,
    PacksArgument,
    SeedOption,
    SplitOption,
    console,
    make_room,
)
from packit_sim.cli.evaluation_commands import evaluate_shown
from packit_sim.cli.generation_commands import evolve_shown
from packit_sim.cli.picture_commands import PackOption, picked, stoppable
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.packs import STARTER_PACKS, load_tasks, read_packs
from packit_sim.datasets.statistics import dataset_files
from packit_sim.game.agents import Agent
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.paper import figures
from packit_sim.paper.reproduction import HEURISTIC
from packit_sim.render import plots


class FigureName(enum.StrEnum):
    """What there is a figure of."""

    TASK = "task"
    ENVIRONMENT = "environment"
    EVOLUTION = "evolution"
    ROLLOUTS = "rollouts"
    LOOKS = "looks"


def figures_command(
    out: Annotated[Path, typer.Option("--out", help="The folder for the PNGs.")],
    packs: PacksArgument = STARTER_PACKS,
    split: SplitOption = None,
    pack: PackOption = 0,
    library: LibraryOption = "everyday",
    only: Annotated[
        list[FigureName] | None, typer.Option(help="Not all of them; may be repeated.")
    ] = None,
    history: Annotated[
        str | None,
        typer.Option(
            help="Packs by `generate --history`, whose first evolution is drawn; by default a "
            "short one is made."
        ),
    ] = None,
    generations: Annotated[int, typer.Option(min=0, help="Of that short evolution.")] = 100,
    agent: Annotated[str, typer.Option(help="Whose rollouts are drawn.")] = HEURISTIC,
    tasks: Annotated[int, typer.Option(min=1, help="That it plays, the first of PACKS.")] = 40,
    seed: SeedOption = 0,
) -> None:
    """Draws the paper's figures from our data: a task, the environment, evolution, rollouts; looks.

    Files are named figure-task.png and so on; the same seed makes the same pictures.
    """
    plots.require()
    opened = ShapeLibrary.open(library)
    player = Agent.from_name(agent)
    wanted = dict.fromkeys(only or FigureName)
    paths = {name: out / f"figure-{name}.png" for name in wanted}
    for path in paths.values():
        make_room(path)
    chosen = picked(packs, split, pack)
    with stoppable():
        for name, path in paths.items():
            if name is FigureName.LOOKS:
                figures.draw_looks(chosen, opened, path)
            elif name is FigureName.TASK:
                figures.draw_task(chosen, opened, path)
            elif name is FigureName.ENVIRONMENT:
                figures.draw_environment(chosen.task(opened), path)
            elif name is FigureName.EVOLUTION:
                if history is None:
                    kept = evolve_shown(
                        opened, seed, EvolutionSettings(generations=generations)
                    ).kept
                else:
                    kept = figures.first_evolution(read_packs(dataset_files(history)[0]))
                figures.draw_evolution(kept, opened, path)
            else:
                played = load_tasks(packs, opened, split)[:tasks]
                rollouts = evaluate_shown([player], played, seed)
                figures.draw_rollouts(rollouts, played, opened, path)
            console.print(f"wrote {path}", soft_wrap=True)
