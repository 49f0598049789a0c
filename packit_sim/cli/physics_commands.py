"""`packit compact` and `packit score`: what is left to gain in packs, and their quality."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from packit_sim.cli.console import (
    LibraryOption,
    PacksArgument,
    PiecesOption,
    SplitOption,
    console,
    prepare_folder,
    progress_bars,
)
from packit_sim.cli.output import simple_table, write_json
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.datasets.pack_files import dataset_file, read_packs
from packit_sim.datasets.packs import Pack
from packit_sim.datasets.provenance import Played
from packit_sim.engine.compaction import compact
from packit_sim.engine.disassembly import MOVES
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.quality import pack_quality
from packit_sim.physics.settings import DISTANCE, METHODS, DecompositionSettings, PhysicsSettings
from packit_sim.placement import BoxState, PlacedItem

LimitOption = Annotated[int | None, typer.Option(min=1, help="Number of packs, from the first.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="JSON file for all numbers.")]


def compact_command(
    packs: PacksArgument,
    split: SplitOption = None,
    library: LibraryOption = "everyday",
    limit: LimitOption = None,
    out: OutOption = None,
) -> None:
    """Push the items of packs together, off the grid: down, left and back, until meshes touch.

    "filled" is the items' volume, divided by the volume of the smallest box around them at the
    bottom left back corner. PACKS may also be results of `packit evaluate`.

    Example: packit compact starter --limit 3 --out compacted.json
    """
    rows = []
    for pack, box in _boxes(packs, split, library, limit, out):
        found = compact(box)
        (filled, pushed), (height, lower) = found.filled, found.height
        numbers = {
            "filled": filled,
            "filled, pushed": pushed,
            "regained": pushed - filled,
            "height": height,
            "height, pushed": lower,
            "mean drop": float(-found.shifts[:, 2].mean()) if box.placed else 0.0,
        }
        rows.append((pack, numbers, {"shifts": found.shifts.tolist(), "rounds": found.rounds}))
    _show(rows)
    _write(out, packs, rows)


def score_command(
    packs: PacksArgument,
    split: SplitOption = None,
    library: LibraryOption = "everyday",
    limit: LimitOption = None,
    distance: Annotated[
        float, typer.Option(help="Maximum movement of a stable item, in box units.")
    ] = DISTANCE,
    moves: Annotated[
        int, typer.Option(min=1, help="Maximum number of straight moves to insert an item.")
    ] = MOVES,
    pieces: PiecesOption = METHODS[0],
    out: OutOption = None,
) -> None:
    """Score packs: whether they are stable under gravity, and whether their items can be inserted.

    All scores are shares of the volume, except counts of items. "reward" is that of the agent, for
    results of `packit evaluate`. A pack takes seconds; the first time also the decomposition of its
    shapes.

    Example: packit score results.jsonl --limit 10
    """
    settings = PhysicsSettings(decomposition=DecompositionSettings(method=pieces))
    rows = []
    for pack, box in _boxes(packs, split, library, limit, out):
        found = pack_quality(box, settings, distance=distance, moves=moves)
        played = pack.provenance
        numbers = {"reward": played.total} if isinstance(played, Played) else {}
        more = {"floating": found.floating, "interlocked": found.disassembly.interlocked}
        rows.append((pack, {**numbers, **found.row()}, more))
    _show(rows)
    _write(out, packs, rows)


Row = tuple[Pack, Mapping[str, float], Mapping[str, Any]]


def _boxes(
    packs: str, split: str | None, library: str, limit: int | None, out: Path | None
) -> Iterator[tuple[Pack, BoxState[PlacedItem]]]:
    """Yield packs with the state of their boxes, with a progress bar."""
    if out is not None:
        prepare_folder(out)
    opened = ShapeLibrary.open(library)
    read = read_packs(dataset_file(packs, split))[:limit]
    with progress_bars() as progress:
        bar = progress.add_task("packs", total=len(read), note="")
        for pack in read:
            yield pack, pack.contents(opened)
            progress.advance(bar)


def _show(rows: Sequence[Row]) -> None:
    """Print the means for each agent, or search, that packed."""
    own: dict[str, list[Mapping[str, float]]] = {}
    for pack, numbers, _ in rows:
        own.setdefault(_maker(pack), []).append(numbers)
    table = simple_table()
    table.add_column("mean of packs", no_wrap=True)
    for maker in own:
        table.add_column(escape(maker), justify="right")
    table.add_row("packs", *(str(len(found)) for found in own.values()))
    for name in dict.fromkeys(name for _, numbers, _ in rows for name in numbers):
        table.add_row(name, *(_mean(found, name) for found in own.values()))
    console.print(table)


def _mean(rows: Sequence[Mapping[str, float]], name: str) -> str:
    values = [numbers[name] for numbers in rows if name in numbers]
    return format_estimate(Estimate.of(values), ".3f") if values else ""


def _maker(pack: Pack) -> str:
    return pack.provenance.producer


def _write(out: Path | None, packs: str, rows: Sequence[Row]) -> None:
    if out is None:
        return
    each = [
        {"pack": n, "by": _maker(pack), **numbers, **more}
        for n, (pack, numbers, more) in enumerate(rows)
    ]
    write_json(out, {"packs": packs, "each": each})
