"""The table and the picture of the built-in instances."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw

from benchmarks.common import markdown_table
from benchmarks.nesting.runs import Results, Search
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES
from packit_sim.parts.results import pictures
from packit_sim.render.lettering import font_of

PICTURE = "nesting-builtin.png"

COLUMNS, TILE, LABEL = 4, (480, 360), 36
"""Packings in a row, and the pixels of each and of its label's height."""

FONT = 22

Runs = Sequence[dict[str, Any]]


def builtin(runs: Runs) -> Iterator[str]:
    """Yield the table of our own instances: heights, and the optimum where it is known."""
    if not runs:
        return
    yield "## Built-in strips\n"
    rows = []
    for run in sorted(runs, key=lambda each: BUILTIN_NAMES.index(each["name"])):
        optimum = run["others"].get("optimum")
        known = ("-", "-") if optimum is None else (f"{optimum:g}", f"{run['score'] / optimum:.3f}")
        settings = f"`{run['name']}`", run["rotations"], f"{run['seconds']:g} s", str(run["seed"])
        reached = f"{run['score']:.2f}", f"{run['density']:.3f}"
        rows.append((*settings, *reached, *known, "yes" if run["valid"] else "NO"))
    head = ("instance", "rotations", "time", "seed", "height", "density", "optimum")
    yield markdown_table((*head, "height / optimum", "valid"), rows)


def draw_builtin(results: Results, file: Path) -> None:
    """Draw the best packing of each built-in instance that has a result, in one picture."""
    own = [run for run in results.read().values() if run["kind"] == "builtin"]
    shown = [name for name in BUILTIN_NAMES if any(run["name"] == name for run in own)]
    wide, high = TILE
    rows = -(-len(shown) // COLUMNS)
    whole = Image.new("RGB", (COLUMNS * wide, rows * (high + LABEL)), "white")
    pen = ImageDraw.Draw(whole)
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(shown):
            best = min((run for run in own if run["name"] == name), key=lambda run: run["score"])
            drawn = Path(folder) / "packing.png"
            pictures.draw(results.packing(Search.of(best)), drawn)
            left, top = number % COLUMNS * wide, number // COLUMNS * (high + LABEL)
            with Image.open(drawn) as picture:
                whole.paste(picture.convert("RGB").resize(TILE), (left, top + LABEL))
            text = f"{name}, height {best['score']:.2f}"
            pen.text((left + 12, top + 6), text, "black", font_of(FONT))
    whole.save(file)
