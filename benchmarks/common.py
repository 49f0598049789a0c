"""What several benchmarks share: arguments, timers, statistics, tables and result files."""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from packit_sim.core.files import replace_text

RESULTS = Path(__file__).parent / "results"

PICTURES = Path(__file__).parents[1] / "docs" / "images"

PAIR_CACHES = ("collisions", "no-fit tables", "pairs that met")
"""The caches of results about pairs of items."""

Times = dict[str, list[float]]


def argument_parser(description: str | None, files: str = "the JSON") -> argparse.ArgumentParser:
    """Create a parser whose help is a module docstring, with the option --out."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help=f"folder for {files}")
    return parser


def resident_memory() -> int:
    """Measure the resident memory of this process, in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def machine() -> dict[str, Any]:
    """Describe this machine for a result file."""
    return {"python": platform.python_version(), "cores": os.cpu_count()}


def write_json(file: Path, result: Mapping[str, Any]) -> None:
    """Write a result file, and its folder."""
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_text(file, json.dumps(result, indent=1) + "\n")


def plot_file(out: Path, name: str) -> Path:
    """Return the file of a plot: in the folder, which is created, or in the documentation's."""
    out.mkdir(parents=True, exist_ok=True)
    return PICTURES / f"benchmark-{name}.png" if out == RESULTS else out / f"{name}.png"


def milliseconds(function: Callable[..., Any], *arguments: Any) -> float:
    """Measure the wall time of one call, in milliseconds."""
    started = time.perf_counter()
    function(*arguments)
    return (time.perf_counter() - started) * 1000


def summary(values: list[float]) -> dict[str, float]:
    """Compute the median, the 10th and 90th percentiles and the sample size."""
    low, median, high = np.percentile(values, (10, 50, 90)).tolist()
    return {"median": median, "p10": low, "p90": high, "n": len(values)}


def summaries(times: Times) -> dict[str, dict[str, float]]:
    """Compute the `summary` of each measure."""
    return {name: summary(values) for name, values in times.items()}


def summary_table(
    rows: Mapping[str, Mapping[str, float]], first: str, median: str, spec: str
) -> Table:
    """Tabulate summaries, one measure a row.

    Parameters
    ----------
    rows : Mapping[str, Mapping[str, float]]
        Summaries by the names of measures.
    first : str
        Header of the column of names.
    median : str
        Header of the column of medians.
    spec : str
        Format of the numbers.

    Returns
    -------
    rich.table.Table
        Names, medians, 10th to 90th percentiles and sample sizes.
    """
    table = Table(first, median, "10% to 90%", "n")
    for name, row in rows.items():
        low, middle, high = (format(row[key], spec) for key in ("p10", "median", "p90"))
        table.add_row(name, middle, f"{low} to {high}", str(row["n"]))
    return table


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Write a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(str, cells))} |\n" for cells in lines)


def table_in_page(page: Path, name: str = "results") -> str:
    """Return what a page has between the comments around its results, or others of a name."""
    found = _block(name).search(page.read_text())
    assert found is not None
    return found[0]


def write_into_page(page: Path, table: str, name: str = "results") -> None:
    """Write results between these comments of a page."""
    replace_text(page, _block(name).sub(lambda _: table, page.read_text(), count=1))


def _block(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<=<!-- {name} -->\n).*?(?=<!-- end of {name} -->)", re.DOTALL)
