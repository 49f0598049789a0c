"""Compilation of kernels beforehand: small runs of the commands that need them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from packit_sim.cli.terminal import progress_bars
from packit_sim.core.errors import PackItError
from packit_sim.libraries.library import ShapeLibrary

_PARTS = ("coffee-mug", "open-cardboard-box")
"""The shapes that are packed."""

_SIDE_MM = 40.0


def compile_shown() -> None:
    """Run commands on little, side by side, so that their kernels are compiled and stored.

    Raises
    ------
    PackItError
        If a run fails.
    """
    with (
        tempfile.TemporaryDirectory(prefix="packit-compile-") as folder,
        progress_bars() as progress,
        ThreadPoolExecutor() as pool,
    ):
        runs = list(_runs(Path(folder)))
        bar = progress.add_task("compiling", total=len(runs), note="a minute or two, once")
        for done in as_completed([pool.submit(_run, words) for words in runs]):
            done.result()
            progress.advance(bar)


def _runs(folder: Path) -> Iterator[tuple[str, ...]]:
    """Write the inputs of the runs, and list their words."""
    library = ShapeLibrary.open("everyday")
    for id in _PARTS:
        mesh = library[id].mesh.copy()
        mesh.apply_scale(_SIDE_MM)
        mesh.export(folder / f"{id}.stl")
    packed = ("--box", "100x100x100mm", "--iterations", "1", "--out", str(folder / "packed"))
    yield ("pack", str(folder), *packed)
    yield ("demo", "--generations", "1", "--out", str(folder / "demo"))


def _run(words: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "packit_sim", *words], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise PackItError(f"packit {words[0]} failed: {done.stderr.strip() or done.stdout.strip()}")
