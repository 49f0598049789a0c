"""The table of the page on growth, from the results file."""

from __future__ import annotations

from benchmarks.common import markdown_table
from campaigns import common
from campaigns.fuzzing.readers import READERS

NAME = "growth"
"""The name of the results file, and of the page."""

HEAD = ("files", "kinds of repetition", "largest exponent", "findings")


def table() -> str:
    """Return the table in Markdown, a row for each reader that was measured."""
    results = common.read_results(NAME).get("readers", {})
    rows = []
    for name, reader in READERS.items():
        if name in results:
            own = results[name]
            found = "; ".join(f"{what}: {exponent:.2f}" for what, exponent in own["findings"])
            row = [reader.what, f"{own['kinds']:,}", f"{own['largest']:.2f}", found or "none"]
            rows.append([cell.replace("|", "\\|") for cell in row])
    return markdown_table(HEAD, rows)


def write_table() -> None:
    """Write the table into its page."""
    common.write_into_page(NAME, table())
