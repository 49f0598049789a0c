"""`packit figures`: the paper's figures, from our data."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import DatasetArgument, DatasetLibraryOption, SeedOption, SplitOption
from packit_sim.cli.picture_commands import PackOption
from packit_sim.cli.stopping import NOTHING_WRITTEN, stoppable
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.game.datasets.builtin import STARTER_PACKS
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.paper.names import HEURISTIC

with lazy_imports():
    from packit_sim.cli import evaluations, generation_progress, inputs, output, shown_boxes
    from packit_sim.game.datasets import pack_files
    from packit_sim.game.paper import figures
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
    agent: Annotated[
        str, typer.Option(autocompletion=completion.agents, help="Agent of the rollouts.")
    ] = HEURISTIC,
    tasks: Annotated[int, typer.Option(min=1, help="Play only the first N tasks.")] = 40,
    seed: SeedOption = 0,
) -> None:
    """Draw the paper's figures from our data.

    The files are figure-task.png, figure-environment.png and so on; the same seed draws the same
    pictures.

    Example: packit figures starter --only task --only looks --out figures
    """
    plots.require()
    opened = inputs.open_library(library, dataset, split)
    player = packit_sim.Agent.from_name(agent)
    wanted = dict.fromkeys(only or FigureName)
    paths = {name: out / f"figure-{name}.png" for name in wanted}
    for path in paths.values():
        output.prepare_folder(path)
    chosen = shown_boxes.picked(dataset, split, pack)
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
                    kept = generation_progress.evolve_shown(
                        opened, seed, EvolutionSettings(generations=generations)
                    ).kept
                else:
                    kept = figures.first_evolution(
                        packit_sim.read_packs(pack_files.dataset_files(history_dataset)[0])
                    )
                figures.draw_evolution(kept, opened, path)
            else:
                played = packit_sim.load_tasks(dataset, opened, split)[:tasks]
                rollouts = evaluations.evaluate_shown([player], played, seed)
                figures.draw_rollouts(rollouts, played, opened, path)
            output.print_written(path)
