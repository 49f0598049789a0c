"""`packit train-champion`: train a network that chooses placements."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import packit_sim
from packit_sim.cli.options import (
    BufferOption,
    KinematicOption,
    RotationsOption,
    WorkersOption,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.extras import needed_for
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import terminal
    from packit_sim.core import parallel

if TYPE_CHECKING:
    from packit_agents.placements.champion_training import RoundResult


def train_champion_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the training.")],
    train_on: Annotated[
        list[str] | None,
        typer.Option(
            help="Dataset with the splits train and validation; may be repeated. "
            "By default everyday-v1 and everyday-hard."
        ),
    ] = None,
    tasks: Annotated[
        int | None, typer.Option(min=2, help="Train only on the first N tasks of each dataset.")
    ] = None,
    kinematic: KinematicOption = False,
    buffer: BufferOption = None,
    rotations: RotationsOption = "all",
    start: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Weights to begin with; default: a rule."),
    ] = None,
    rounds: Annotated[int | None, typer.Option(min=1, help="Number of rounds.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    workers: WorkersOption = 0,
) -> None:
    """Train a network to choose placements; its best weights are best.safetensors in the folder.

    The command can be stopped at any time: repeat it to resume. The final weights are the same.
    The agent placement@FOLDER/best.safetensors plays with the weights.

    Example: packit train-champion --out trainings/champion
    """
    with needed_for("trainings"):
        from packit_agents.placements.champion_training import (
            PlacementTraining,
            PlacementTrainingSettings,
        )
    default = PlacementTrainingSettings(seed=seed)
    settings = replace(
        default,
        packs=tuple(train_on or default.packs),
        rules=packit_sim.Rules(kinematic=kinematic, buffer=buffer, rotations=rotations),
        start=None if start is None else str(start),
        tasks=tasks or default.tasks,
        rounds=rounds or default.rounds,
    )
    with stoppable(RESUMABLE):
        training = PlacementTraining(settings, out)
        with parallel.Workers(workers) as processes, terminal.progress_bars() as progress:
            bar = progress.add_task("training", total=settings.rounds, note="")

            def show(at: RoundResult) -> None:
                note = f"return {at.reward:.3f}, best {at.best.validation.mean:.3f}"
                progress.update(bar, completed=at.rounds, note=note)

            training.run(processes, show)
    best = training.best
    terminal.console.print(
        f"best after {best.steps} rounds: Average Reward {best.validation.mean:.3f} in validation; "
        f"wrote {out / 'best.safetensors'}"
    )
