"""`packit figures`: the paper's figures, from our data."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli.console import (
    DatasetArgument,
    DatasetLibraryOption,
    SeedOption,
    SplitOption,
    open_library,
    prepare_folder,
)
from packit_sim.cli.evaluation_commands import evaluate_shown
from packit_sim.cli.generation_commands import evolve_shown
from packit_sim.cli.output import NOTHING_WRITTEN, print_written, stoppable
from packit_sim.cli.picture_commands import PackOption, picked
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import STARTER_PACKS, dataset_files, load_tasks, read_packs
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.paper import figures
from packit_sim.game.paper.reproduction import HEURISTIC
from packit_sim.render import plots


class FigureName(enum.StrEnum):
    """The figures."""

    TASK = "task"
    ENVIRONMENT = "environment"
    EVOLUTION = "evolution"
    ROLLOUTS = "rollouts"
    LOOKS = "looks"


def figures_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the PNG files.")],
    dataset: DatasetArgument = STARTER_PACKS,
    split: SplitOption = None,
    pack: PackOption = 0,
    library: DatasetLibraryOption = None,
    only: Annotated[
        list[FigureName] | None, typer.Option(help="Draw only this figure; may be repeated.")
    ] = None,
    history_dataset: Annotated[
        str | None,
        typer.Option(
            metavar="DATASET",
            help="Dataset of `packit generate --history`, to draw its first evolution; "
            "default: evolve a pack.",
        ),
    ] = None,
    generations: Annotated[int, typer.Option(min=0, help="Generations of that evolution.")] = 100,
    agent: Annotated[str, typer.Option(help="Agent of the rollouts.")] = HEURISTIC,
    tasks: Annotated[int, typer.Option(min=1, help="Let it play only the first N tasks.")] = 40,
    seed: SeedOption = 0,
) -> None:
    """Draw the paper's figures from our data.

    The files are figure-task.png, figure-environment.png and so on; the same seed draws the same
    pictures.

    Example: packit figures starter --only task --only looks --out figures
    """
    plots.require()
    opened = open_library(library, dataset, split)
    player = Agent.from_name(agent)
    wanted = dict.fromkeys(only or FigureName)
    paths = {name: out / f"figure-{name}.png" for name in wanted}
    for path in paths.values():
        prepare_folder(path)
    chosen = picked(dataset, split, pack)
    with stoppable(NOTHING_WRITTEN):
        for name, path in paths.items():
            if name is FigureName.LOOKS:
                figures.draw_looks(chosen, opened, path)
            elif name is FigureName.TASK:
                figures.draw_task(chosen, opened, path)
            elif name is FigureName.ENVIRONMENT:
                figures.draw_environment(chosen.task(opened), path)
            elif name is FigureName.EVOLUTION:
                if history_dataset is None:
                    kept = evolve_shown(
                        opened, seed, EvolutionSettings(generations=generations)
                    ).kept
                else:
                    kept = figures.first_evolution(read_packs(dataset_files(history_dataset)[0]))
                figures.draw_evolution(kept, opened, path)
            else:
                played = load_tasks(dataset, opened, split)[:tasks]
                rollouts = evaluate_shown([player], played, seed)
                figures.draw_rollouts(rollouts, played, opened, path)
            print_written(path)
