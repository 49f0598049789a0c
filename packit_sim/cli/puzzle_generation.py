"""`packit generate --puzzle`: datasets of boxes that were cut into pieces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import typer

from packit_sim.cli.output import print_written
from packit_sim.cli.stopping import NOTHING_WRITTEN, stoppable
from packit_sim.cli.terminal import progress_bars
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.pack_files import WHOLE
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Puzzle, PuzzleName
from packit_sim.game.generation.puzzles import LIBRARY_FOLDER, PuzzleJob, generate_puzzles

PIECES = 16
"""The number of pieces by default."""

_SHARED = {"out", "packs", "seed"}
"""Options of evolved datasets that puzzles have too."""

_OWN = {"puzzle", "pieces", "shapes"}
"""Options that only puzzles have."""


def check_options(context: typer.Context) -> None:
    """Raise ArgumentError if options of puzzles and of evolution are mixed."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    given = [name for name, source in sources.items() if source and source.name == "COMMANDLINE"]
    is_puzzle = "puzzle" in given
    wrong = [n for n in given if n not in _SHARED and (n in _OWN) is not is_puzzle]
    if not wrong:
        return
    option = f"--{wrong[0].replace('_', '-')}"
    raise ArgumentError(
        f"{option} has no effect {'with' if is_puzzle else 'without'} --puzzle: leave it out"
    )


def write_puzzles(
    cuts: Sequence[str],
    pieces: Sequence[int],
    packs: int,
    seed: int,
    out: Path,
    shapes: Path | None,
) -> None:
    """Generate puzzles and the library of their pieces, and print where they are."""
    names = cast(tuple[PuzzleName, ...], tuple(dict.fromkeys(cuts)))  # the job checks them
    job = PuzzleJob(names, tuple(dict.fromkeys(pieces)), packs, seed)
    with stoppable(NOTHING_WRITTEN), progress_bars() as progress:
        bar = progress.add_task("puzzles", total=len(list(job.records)), note="")

        def show(pack: Pack) -> None:
            record = pack.provenance
            assert isinstance(record, Puzzle)
            progress.update(bar, advance=1, note=f"{record.cuts}, {record.pieces} pieces")

        found = generate_puzzles(job, out, shapes, show)
    print_written(shapes or out / LIBRARY_FOLDER, ": the pieces")
    print_written(out / f"{WHOLE}.jsonl", f": {len(found)} packs")
