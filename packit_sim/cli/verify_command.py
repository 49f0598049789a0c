"""`packit verify`: the oracle's check of packs."""

from __future__ import annotations

from typing import Annotated

import typer

from packit_sim.cli.console import (
    DatasetLibraryOption,
    SplitOption,
    checked_dataset,
    console,
    open_library,
    progress_bars,
)
from packit_sim.cli.output import stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.pack_files import dataset_file, dataset_path
from packit_sim.parts.results.verification import verify_record


def verify_command(
    dataset: Annotated[
        str,
        typer.Argument(
            metavar="DATASET",
            help="Dataset or results: a name (see `packit datasets list`), a folder or a file; or "
            "a packing: a .json file.",
        ),
    ],
    split: SplitOption = None,
    library: DatasetLibraryOption = None,
) -> None:
    """Check packs with the oracle; exit code 1 if one is wrong.

    Packings are checked too: mesh files with poses, written by `packit pack`, `packit nest
    --packing` or another tool. The record of `packit pack` is also compared with what was asked
    for, as far as it says so; a last line names what was not checked. Linked pairs are parts that
    can't be moved apart without turning, like two links of a chain. The fields of a packing are
    described at https://packit-sim.readthedocs.io (Reference, File formats).

    Example: packit verify everyday-v1 --split test

    Example: packit verify packed/packing.json
    """
    if dataset.endswith(".json"):
        for option, value in (("--split", split), ("--library", library)):
            if value is not None:
                raise ArgumentError(
                    f"{option} has no effect on {dataset}, which is a packing: leave it out"
                )
        report = verify_record(dataset)
        verdict = f"density {report.density:.3f}, {len(report.problems)} problems"
        verdict += f"\nlinked pairs: {report.linked}" if report.linked else ""
    else:
        checked_dataset(dataset)
        opened = open_library(library, dataset, split)
        with stoppable("the check is not complete"), progress_bars() as progress:
            bar = progress.add_task("verifying", total=None, note="")
            report = verify_dataset(
                dataset_file(dataset, split) if split else dataset_path(dataset),
                opened,
                lambda done, total: progress.update(bar, completed=done, total=total),
            )
        verdict = f"{report.packs - report.broken} of {report.packs} packs hold"
    for problem in report.problems:
        console.print(str(problem), highlight=False, soft_wrap=True, markup=False)
    console.print(verdict, highlight=False, soft_wrap=True, markup=False)
    if report.not_judged:
        console.print(report.not_judged, soft_wrap=True, markup=False)
    if not report.is_valid:
        raise typer.Exit(1)
