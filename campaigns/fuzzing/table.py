"""The table of the page on hostile files, from the results file."""

from __future__ import annotations

from benchmarks.common import markdown_table
from campaigns import common
from campaigns.fuzzing.readers import READERS

NAME = "fuzzing"
"""The name of the results file."""

PAGE = "hostile-files"

HOSTILE = common.ROOT / "tests" / "hostile"
"""Files that were found, by the name of their reader."""

HEAD = ("files", "inputs", "minutes", "edges reached", "found and fixed", "open")

_NOTHING = {"inputs": 0, "seconds": 0, "edges": 0, "findings": 0}


def table() -> str:
    """Return the table in Markdown, a row for each reader."""
    results = common.read_results(NAME).get("readers", {})
    rows = []
    totals = [0.0] * 4
    for name, reader in READERS.items():
        row = results.get(name, _NOTHING)
        fixed = sum(1 for _ in (HOSTILE / name).glob("*"))
        summed = [row["inputs"], row["seconds"] / 60, fixed, row["findings"]]
        totals = [total + value for total, value in zip(totals, summed, strict=True)]
        rows.append(_row(reader.what, f"{row['edges']:,}", summed))
    return markdown_table(HEAD, [*rows, _row("**all**", "", totals)])


def write_table() -> None:
    """Write the table into its page."""
    common.write_into_page(PAGE, table())


def _row(what: str, edges: str, values: list[float]) -> list[str]:
    inputs, minutes, fixed, found = (f"{value:,.0f}" for value in values)
    return [what, inputs, minutes, edges, fixed, found]
