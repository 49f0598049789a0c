"""`packit selftest`: random cases in which the engine and the oracle must agree."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from packit_sim.cli.options import SeedOption, WorkersOption
from packit_sim.cli.stopping import RESUMABLE
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import output, terminal
    from packit_sim.core import parallel

COMPARISONS = (
    "cold",
    "warm",
    "tables",
    "rotations",
    "union",
    "rotations at",
    "restored",
    "other order",
    "BLBF",
    "one location",
    "why not",
    "table offsets",
    "kinematic",
    "clear",
    "ways up",
    "shared volumes",
)
"""The counts, by their names in the file of totals."""

if TYPE_CHECKING:
    from packit_sim.selftest.totals import Totals


def selftest_command(
    minutes: Annotated[
        float,
        typer.Option(min=0.01, max=525_600, help="Minutes during which new cases are started."),
    ] = 1.0,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="File of totals; a run adds to those that it already contains."
        ),
    ] = None,
    replay: Annotated[
        Path | None,
        typer.Option(help="Repeat the case of a file that a run wrote for a difference."),
    ] = None,
) -> None:
    """Compare the engine with the oracle in random cases; exit code 1 if answers differ.

    Cases are boxes filled with library meshes and with hard meshes: unconnected triangles, shells,
    blocks that touch, all sizes, nested surfaces. A difference is reduced to a small file. With
    --out the command can be stopped at any time: repeat it to resume.

    Example: packit selftest --minutes 10 --workers 0

    Example: packit selftest --replay selftest-0-17.json
    """
    if replay is not None:
        _repeat(replay)
        return
    from packit_sim.selftest import case_runs, volumes  # creates shapes

    if out is not None:
        output.prepare_folder(out)
    if not volumes.is_available():
        terminal.console.print("boolean volumes are left out: pip install manifold3d")
    totals, stopped = None, False
    with parallel.Workers(workers) as processes, terminal.progress_bars() as progress:
        bar = progress.add_task("comparing", total=round(60 * minutes), note="")
        start = time.monotonic()
        try:
            for totals in case_runs.run(seed, minutes, processes, out):
                millions = totals.count("locations") / 1e6
                note = f"{millions:.2f} million locations, {len(totals.differences)} differences"
                progress.update(bar, completed=int(time.monotonic() - start), note=note)
        except KeyboardInterrupt:
            stopped = True
    if totals is not None:
        _print_totals(totals)
    if stopped:
        terminal.console.print(f"stopped: {RESUMABLE if out else 'no file of totals was given'}")
    if totals is not None and totals.differences:
        raise typer.Exit(1)
    if stopped:
        raise typer.Exit(130)


def _print_totals(totals: Totals) -> None:
    table = output.simple_table("items", "cases", "masks", "locations", "core-s", "differences")
    for name, kind in totals.kinds.items():
        numbers = [f"{kind.counts.get(count, 0):,}" for count in ("cases", "masks", "locations")]
        table.add_row(name, *numbers, f"{kind.core_seconds:,.0f}", str(kind.differences))
    seeds = ", ".join(totals.seeds)
    table.caption = (
        f"PackIt-Sim {totals.version}, seeds: {seeds}, {totals.seconds / 60:.1f} minutes"
    )
    terminal.console.print(table)
    others = {name: totals.count(name) for kind in totals.kinds.values() for name in kind.counts}
    compared = (f"{name} {others[name]:,}" for name in COMPARISONS if name in others)
    terminal.console.print(f"compared: {', '.join(compared)}", highlight=False)
    for found in totals.differences:
        text = f"case {found.number} of seed {found.seed}: {found.check}: {found.message}"
        note = f"; packit selftest --replay {found.replay}" if found.replay else ""
        terminal.console.print(text + note, markup=False, soft_wrap=True, style="red")


def _repeat(file: Path) -> None:
    from packit_sim.selftest.comparisons import differences
    from packit_sim.selftest.replays import read_replay

    check, case = read_replay(file)
    found = differences(case, check)
    for each in found:
        terminal.console.print(f"{each.check}: {each.message}", markup=False, soft_wrap=True)
    terminal.console.print(f"{check}: {len(found)} differences")
    if found:
        raise typer.Exit(1)
