"""`packit reproduce`: the paper's tables and figures, one command each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli.options import (
    AddressOption,
    BackendOption,
    DatasetLibraryOption,
    SeedOption,
    WorkersOption,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.choices import Split
from packit_sim.core.errors import PackItError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.core.suggestions import did_you_mean
from packit_sim.game.paper.names import (
    EVOLUTION,
    PORTFOLIO,
    QUICK_EVOLUTIONS,
    QUICK_SECONDS,
    QUICK_TASKS,
    TABLE_NAMES,
)

with lazy_imports():
    from packit_sim.cli import reproductions
    from packit_sim.core import parallel
    from packit_sim.render import plots

BENCHMARK = "everyday-v1"
"""The dataset of the benchmark."""

HISTORY = "everyday-v1-history"
"""The dataset of packs from the course of evolutions, for the figure."""

ALL = "all"

CHOICES = (*TABLE_NAMES, EVOLUTION, ALL, PORTFOLIO)
"""The tables and figures by name; `ALL` stands for those before it."""


def reproduce_command(
    what: Annotated[str, typer.Argument(help=f"What to reproduce: {', '.join(CHOICES)}.")] = ALL,
    dataset: Annotated[str, typer.Option(help="Dataset of the tables' tasks.")] = BENCHMARK,
    split: Annotated[
        Split | None, typer.Option(help="Split of the dataset; for the benchmark: test.")
    ] = None,
    history_dataset: Annotated[
        str,
        typer.Option(
            metavar="DATASET", help="Dataset of `packit generate --history`, for evolution."
        ),
    ] = HISTORY,
    library: DatasetLibraryOption = None,
    seed: SeedOption = 0,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help=f"Play only {QUICK_TASKS} tasks and {QUICK_EVOLUTIONS} evolutions, and search "
            f"for {QUICK_SECONDS:g} s in the portfolio: takes minutes.",
        ),
    ] = False,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for tables, pictures and results.")
    ] = Path("reproduced"),
    workers: WorkersOption = 0,
    backend: BackendOption = "loky",
    address: AddressOption = None,
) -> None:
    """Reproduce a table or figure of the paper, and print our numbers next to the paper's.

    The portfolio is beyond the paper: returns of rules with searches over processor seconds.
    It takes over two core-hours, and is not part of "all".

    The command can be stopped at any time: repeat it to resume.

    Example: packit reproduce table1 --quick
    """
    if what not in CHOICES:
        raise PackItError(
            f"there is no table or figure {what!r}: {did_you_mean(what, CHOICES)}"
            f"choose from {', '.join(CHOICES)}"
        )
    plots.require()
    if dataset == BENCHMARK and split is None:
        split = "test"
    names = (*TABLE_NAMES, EVOLUTION) if what == ALL else (what,)
    tables = [name for name in names if name in TABLE_NAMES]
    with (
        stoppable(RESUMABLE),
        reproductions.prepared(out, names),
        parallel.Workers(workers, backend, address) as processes,
    ):
        run = reproductions.Run(library, seed, quick, out, processes)
        if tables:
            reproductions.write_tables(tables, dataset, split, run)
        if EVOLUTION in names:
            reproductions.write_evolution(history_dataset, run)
        if PORTFOLIO in names:
            reproductions.write_portfolio(dataset, split, run)
