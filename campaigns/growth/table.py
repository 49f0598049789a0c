"""The table of the page on growth, from the results file."""

from __future__ import annotations

from benchmarks.common import markdown_table
from campaigns import common
from campaigns.fuzzing.readers import READERS

NAME = "growth"
"""The name of the results file, and of the page."""

HEAD = ("files", "kinds of repetition", "counted", "largest exponent", "findings")


def table() -> str:
    """Return the table in Markdown, a row for each reader that was measured."""
    results = common.read_results(NAME)
    rows = []
    for name, reader in READERS.items():
        if name not in results.get("readers", {}):
            continue
        own = results["readers"][name]
        counts = {what: float(exponent) for what, exponent in own["counted"].items()}
        findings = {what: each for what, each in counts.items() if each > results["bound"]}
        largest = max(
            [own["largest"], *(each for each in counts.values() if each <= results["bound"])]
        )
        counted = f"{len(counts):,}"
        if missing := len(own["suspects"]) - len(counts):
            counted += f", {missing:,} not yet"
        found = "; ".join(f"{what}: {exponent:.2f}" for what, exponent in findings.items())
        row = [reader.what, f"{own['kinds']:,}", counted, f"{largest:.2f}", found or "none"]
        rows.append([cell.replace("|", "\\|") for cell in row])
    return markdown_table(HEAD, rows)


def write_table() -> None:
    """Write the table into its page."""
    common.write_into_page(NAME, table())
