"""The import of a library, with its progress and its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from packit_sim.cli.output import print_written, write_json
from packit_sim.cli.shape_tables import report_table
from packit_sim.cli.stopping import NOTHING_WRITTEN, stoppable
from packit_sim.cli.terminal import console, progress_bars
from packit_sim.core.errors import PackItError
from packit_sim.core.files import claimed, lock_path
from packit_sim.core.plain_text import listed
from packit_sim.libraries import stored
from packit_sim.libraries.importer import ImportOutcome, ImportSettings, import_library
from packit_sim.libraries.library import ShapeLibrary


def import_shown(
    opened: ShapeLibrary,
    out: Path,
    name: str,
    version: str,
    settings: ImportSettings,
    *,
    source: str,
    report: Path,
    splits: Mapping[str, Sequence[str]] | None = None,
    overwrite: bool = False,
) -> ShapeLibrary:
    """Import the shapes of a library into a stored one, and print what became of them.

    Parameters
    ----------
    out : Path
        The folder to write.
    source : str
        The argument that opened the library, for the report and messages.
    report : Path
        The JSON file of the report.
    splits : mapping of str to sequence of str, optional
        The splits of the library; by default all shapes are imported, and divided.
    overwrite : bool
        Whether a library in the folder is replaced.

    Returns
    -------
    ShapeLibrary
        The stored library.

    Raises
    ------
    PackItError
        If the folder exists already, or none of the meshes can be a shape.
    """
    ids = opened.ids if splits is None else sorted(set().union(*splits.values()))
    missing = [
        ImportOutcome(id, id, id.rpartition("/")[0], str(opened.path), problem)
        for id, problem in opened.missing.items()
    ]

    def write_report(outcomes: list[ImportOutcome]) -> None:
        shapes = [asdict(outcome) for outcome in outcomes + missing]
        write_json(report, {"source": source, "shapes": shapes})

    with (
        stoppable(NOTHING_WRITTEN),
        claimed(lock_path(out), out),
        progress_bars() as progress,
    ):
        stored.remove_unfinished(out)
        if out.exists() and not overwrite:
            raise PackItError(f"{out} exists already: choose another folder, or give --overwrite")
        bar = progress.add_task("importing", total=len(ids), note="")

        def advance(outcome: ImportOutcome) -> None:
            progress.update(bar, advance=1, note=outcome.id)

        outcomes = import_library(
            [opened.source.candidate(id) for id in ids],
            out,
            name,
            version,
            settings,
            splits,
            advance,
            write_report,
        )
    outcomes += missing
    console.print(report_table(outcomes))
    kept = sum(outcome.problem is None for outcome in outcomes)
    console.print(f"{kept} shapes kept, {len(outcomes) - kept} refused")
    if joined := [outcome.name for outcome in outcomes if outcome.parts > 1]:
        console.print(
            f"Files with several parts: {listed(joined)}. The parts of a file become one rigid "
            "shape; to pack them separately, write each part to a separate file.",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )
    print_shells(outcome.name for outcome in outcomes if outcome.is_shell)
    if not kept:
        raise PackItError(f"{source}: none of its meshes can be a shape: {out} is not written")
    library = ShapeLibrary.open(out)
    print_written(out, f": {library}")
    return library


def print_shells(names: Iterable[str]) -> None:
    """Print of which meshes the volume is only that of a shell, if there are any."""
    if shells := list(names):
        console.print(
            f"Open meshes: {listed(shells)}. Their volume is only that of a thin sheet, and other "
            "items may be placed inside; if they are meant to be solid, close their surface.",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )
