"""`packit verify`: the oracle's check of packs."""

from __future__ import annotations

from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import DatasetLibraryOption, SplitOption, checked_dataset, packing_file
from packit_sim.cli.stopping import stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import inputs, terminal
    from packit_sim.game.datasets import dataset_checks, pack_files
    from packit_sim.parts.results import verification


def verify_command(
    dataset: Annotated[
        str,
        typer.Argument(
            metavar="DATASET",
            autocompletion=completion.datasets,
            help="Dataset or results: a name (see `packit datasets list`), a folder or a file; or "
            "a packing: a .json file, or the folder of `packit pack`.",
        ),
    ],
    split: SplitOption = None,
    library: DatasetLibraryOption = None,
) -> None:
    """Check packs with the oracle; exit code 1 if one is wrong.

    Packings are checked too: mesh files with poses, written by `packit pack`, `packit nest
    --packing` or another tool. The record of `packit pack` is also compared with the request
    that it contains; the last line names what was not checked. Linked pairs are parts that
    can't be moved apart without turning, like two links of a chain. The fields of a packing are
    described at https://packit-sim.readthedocs.io (Reference, File formats).

    Example: packit verify everyday-v1 --split test

    Example: packit verify packed
    """
    packing = packing_file(dataset)
    if packing:
        for option, value in (("--split", split), ("--library", library)):
            if value is not None:
                raise ArgumentError(
                    f"{option} has no effect on {dataset}, which is a packing: leave it out"
                )
        report = verification.verify_record(packing)
        verdict = f"density {report.density:.3f}, {len(report.problems)} problems"
        verdict += f"\nlinked pairs: {report.linked}" if report.linked else ""
    else:
        checked_dataset(dataset)
        opened = inputs.open_library(library, dataset, split)
        with stoppable("the check is not complete"), terminal.progress_bars() as progress:
            bar = progress.add_task("verifying", total=None, note="")
            report = dataset_checks.verify_dataset(
                packit_sim.dataset_file(dataset, split)
                if split
                else pack_files.dataset_path(dataset),
                opened,
                lambda done, total: progress.update(bar, completed=done, total=total),
            )
        verdict = f"{report.packs - report.broken} of {report.packs} packs hold"
    for problem in report.problems:
        terminal.console.print(str(problem), highlight=False, soft_wrap=True, markup=False)
    terminal.console.print(verdict, highlight=False, soft_wrap=True, markup=False)
    if report.not_judged:
        terminal.console.print(report.not_judged, soft_wrap=True, markup=False)
    if not report.is_valid:
        raise typer.Exit(1)
