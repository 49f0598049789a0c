"""`packit train-columns`: learn the values of columns in the online game of polycubes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from packit_sim.cli.options import WorkersOption
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import terminal
    from packit_sim.core import parallel

if TYPE_CHECKING:
    from packit_agents.online.value_training import RoundResult


def train_columns_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the training.")],
    buffer: Annotated[
        list[int] | None,
        typer.Option(min=1, help="Visible items; may be repeated. By default 1, 3, 5 and 10."),
    ] = None,
    rounds: Annotated[int | None, typer.Option(min=1, help="Number of rounds.")] = None,
    games: Annotated[
        int | None, typer.Option(min=1, help="Number of games of a round, for each buffer.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the arrivals.")] = 0,
    workers: WorkersOption = 0,
) -> None:
    """Learn the values of columns for the polycubes of BlockOut, which arrive one by one.

    The command can be stopped at any time: repeat it to resume. The final values are the same. The
    agents columns@FOLDER/last.safetensors and columns-ahead@FOLDER/last.safetensors play with them.

    Example: packit train-columns --out trainings/columns --buffer 5
    """
    from packit_agents.online.value_training import ValueTraining, ValueTrainingSettings

    default = ValueTrainingSettings(seed=seed)
    settings = replace(
        default,
        buffers=tuple(buffer or default.buffers),
        rounds=rounds or default.rounds,
        games=games or default.games,
    )
    with stoppable(RESUMABLE):
        training = ValueTraining(settings, out)
        with parallel.Workers(workers) as processes, terminal.progress_bars() as progress:
            bar = progress.add_task("training", total=settings.rounds, note="")

            def show(at: RoundResult) -> None:
                placed = ", ".join(f"{own.mean:.2f}" for own in at.placed.values())
                progress.update(bar, completed=at.rounds, note=f"shapes placed: {placed}")

            training.run(processes, show)
    terminal.console.print(f"wrote {out / 'last.safetensors'}")
