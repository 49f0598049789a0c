"""`packit prepare`, `compact` and `score`: convex pieces, compaction and quality of packs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

import packit_sim
from packit_sim.cli.options import (
    DatasetArgument,
    DatasetLibraryOption,
    DecompositionOption,
    SplitOption,
    WorkersOption,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.checks import POSITIVE, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.geometry.lattice import MOVES
from packit_sim.physics.convex.settings import METHODS, DecompositionSettings
from packit_sim.physics.settings import DISTANCE, PhysicsSettings

with lazy_imports():
    from rich import markup

    from packit_sim import placement
    from packit_sim.cli import inputs, output, terminal
    from packit_sim.core import confidence
    from packit_sim.game.datasets import pack_files, provenance
    from packit_sim.geometry import items
    from packit_sim.physics.convex import decomposition as convex

LimitOption = Annotated[int | None, typer.Option(min=1, help="Read only the first N packs.")]
ScoredPack: TypeAlias = "tuple[packit_sim.Pack, Mapping[str, float], Mapping[str, Any]]"
OutOption = Annotated[Path | None, typer.Option("--out", "-o", help="JSON file for all numbers.")]


def prepare_command(
    dataset: DatasetArgument,
    physics: Annotated[
        bool, typer.Option("--physics", help="Decompose the shapes into convex pieces.")
    ] = False,
    split: SplitOption = None,
    library: DatasetLibraryOption = None,
    decomposition: DecompositionOption = METHODS[0],
    workers: WorkersOption = 0,
) -> None:
    """Prepare a dataset for physics: decompose its shapes into convex pieces.

    PackItPhysics-v0, `packit evaluate --physics` and `packit score` simulate convex pieces of
    shapes. A shape takes 3 to 22 s, once: the pieces are kept on disk, for all processes. The
    command can be stopped at any time: repeat it to resume.

    Example: packit prepare everyday-v1 --split train --physics
    """
    if not physics:
        raise ArgumentError("nothing to prepare: give --physics")
    settings = DecompositionSettings(method=decomposition)
    convex.require(settings)
    opened = inputs.open_library(library, dataset, split)
    files = pack_files.dataset_files(dataset, split)
    packs = [pack for file in files for pack in packit_sim.read_packs(file)]
    ids = sorted({item.shape for pack in packs for item in (*pack.items, *pack.outside)})
    with stoppable(RESUMABLE):
        new = inputs.decompose_shown([opened[id] for id in ids], settings, workers)
    terminal.console.print(f"{len(ids)} shapes are prepared, {new} of them now")


def compact_command(
    dataset: DatasetArgument,
    split: SplitOption = None,
    library: DatasetLibraryOption = None,
    limit: LimitOption = None,
    out: OutOption = None,
) -> None:
    """Push the items of packs down, left and back, off the grid, until meshes touch.

    "filled" is the items' volume, divided by the volume of the smallest box around them at the
    bottom left back corner. DATASET may also be results of `packit evaluate`.

    Example: packit compact starter --limit 3 --out compacted.json
    """

    def row(pack: packit_sim.Pack, box: items.BoxState[items.PlacedItem]) -> ScoredPack:
        found = placement.compact(box)
        (filled, pushed), (height, lower) = found.filled, found.height
        numbers = {
            "filled": filled,
            "filled, pushed": pushed,
            "regained": pushed - filled,
            "height": height,
            "height, pushed": lower,
            "mean drop": float(-found.shifts[:, 2].mean()) if box.placed else 0.0,
        }
        return pack, numbers, {"shifts": found.shifts.tolist(), "rounds": found.rounds}

    rows = _rows(_boxes(dataset, split, library, limit, out), row)
    _show(rows)
    _write(out, dataset, rows)


def score_command(
    dataset: DatasetArgument,
    split: SplitOption = None,
    library: DatasetLibraryOption = None,
    limit: LimitOption = None,
    distance: Annotated[
        float, typer.Option(help="Maximum movement of a stable item, in box units.")
    ] = DISTANCE,
    moves: Annotated[
        int, typer.Option(min=1, help="Maximum number of straight moves to insert an item.")
    ] = MOVES,
    decomposition: DecompositionOption = METHODS[0],
    out: OutOption = None,
) -> None:
    """Score the stability of packs under gravity, and whether their items can be inserted.

    All scores are shares of the volume, except counts of items. "reward" is that of the agent, for
    results of `packit evaluate`. A pack takes seconds; the first time, its shapes are also
    decomposed.

    Example: packit score results.jsonl --limit 10
    """
    settings = PhysicsSettings(decomposition=DecompositionSettings(method=decomposition))
    check_range("distance", distance, POSITIVE)
    convex.require(settings.decomposition)

    def row(pack: packit_sim.Pack, box: items.BoxState[items.PlacedItem]) -> ScoredPack:
        found = packit_sim.pack_quality(box, settings, distance=distance, moves=moves)
        played = pack.provenance
        numbers = {"reward": played.total} if isinstance(played, provenance.Played) else {}
        more = {"floating": found.floating, "interlocked": found.disassembly.interlocked}
        return pack, {**numbers, **found.row()}, more

    boxes = _boxes(dataset, split, library, limit, out)
    shapes = [placed.item.shape for _, box in boxes for placed in box.placed]
    inputs.decompose_shown(shapes, settings.decomposition)
    rows = _rows(boxes, row)
    _show(rows)
    _write(out, dataset, rows)


def _boxes(
    dataset: str, split: str | None, library: str | None, limit: int | None, out: Path | None
) -> list[tuple[packit_sim.Pack, items.BoxState[items.PlacedItem]]]:
    """Read packs, with the states of their boxes."""
    if out is not None:
        output.prepare_folder(out, dataset)
    read = packit_sim.read_packs(packit_sim.dataset_file(dataset, split))[:limit]
    opened = inputs.open_library(library, dataset, split)
    return [(pack, pack.contents(opened)) for pack in read]


def _rows(
    boxes: Sequence[tuple[packit_sim.Pack, items.BoxState[items.PlacedItem]]],
    row: Callable[[packit_sim.Pack, items.BoxState[items.PlacedItem]], ScoredPack],
) -> list[ScoredPack]:
    """Measure each pack, with a progress bar."""
    rows = []
    with terminal.progress_bars() as progress:
        bar = progress.add_task("packs", total=len(boxes), note="")
        for pack, box in boxes:
            rows.append(row(pack, box))
            progress.advance(bar)
    return rows


def _show(rows: Sequence[ScoredPack]) -> None:
    """Print the means for each agent, or search, that packed."""
    own: dict[str, list[Mapping[str, float]]] = {}
    for pack, numbers, _ in rows:
        own.setdefault(_maker(pack), []).append(numbers)
    table = output.simple_table()
    table.add_column("mean of packs", no_wrap=True)
    for maker in own:
        table.add_column(markup.escape(maker), justify="right")
    table.add_row("packs", *(str(len(found)) for found in own.values()))
    for name in dict.fromkeys(name for _, numbers, _ in rows for name in numbers):
        table.add_row(name, *(_mean(found, name) for found in own.values()))
    terminal.console.print(table)


def _mean(rows: Sequence[Mapping[str, float]], name: str) -> str:
    values = [numbers[name] for numbers in rows if name in numbers]
    return confidence.format_estimate(confidence.Estimate.of(values), ".3f") if values else ""


def _maker(pack: packit_sim.Pack) -> str:
    return pack.provenance.producer


def _write(out: Path | None, dataset: str, rows: Sequence[ScoredPack]) -> None:
    if out is None:
        return
    each = [
        {"pack": n, "by": _maker(pack), **numbers, **more}
        for n, (pack, numbers, more) in enumerate(rows)
    ]
    output.write_json(out, {"packs": dataset, "each": each})
