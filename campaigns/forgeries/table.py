"""The results of the campaign: counts by kind of forgery, and the table of the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from scipy.stats import binomtest

from benchmarks.common import markdown_table
from campaigns.forgeries.trials import KINDS, Trial

NAME = "forgeries"

_COLUMNS = ("tried", "refused", "verified", "named", "open", "wrong", "resumed")


def counted(trials: list[Trial]) -> dict[str, Counter[str]]:
    """Count trials by kind: right answers by what they are, open ones, and wrong ones."""
    rows: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    for one in trials:
        row = rows[one.kind]
        row["tried"] += 1
        row["resumed"] += one.resumed
        if one.faults:
            row["wrong"] += 1
        elif one.judged == "open":
            row["open"] += 1
        else:
            row[one.outcome] += 1
    return rows


def table(results: Mapping[str, Any]) -> str:
    """Tabulate results in Markdown."""
    total: Counter[str] = Counter()
    for row in results["kinds"].values():
        total.update(row)
    rows = [_row(kind, row) for kind, row in results["kinds"].items()]
    rows.append(_row("**all**", total))
    head = ("forgery", *_COLUMNS[:5], "wrong", "wrong at most (95%)")
    return (
        f"{markdown_table(head, rows)}\nPackIt-Sim {results['version']}; seed {results['seed']}; "
        f"{total['resumed']:,} parts resumed.\n"
    )


def _row(name: str, row: Mapping[str, int]) -> tuple[str, ...]:
    tried = row.get("tried", 0)
    high = binomtest(row.get("wrong", 0), tried).proportion_ci(0.95, "exact").high if tried else 1.0
    return (name, *(f"{row.get(each, 0):,}" for each in _COLUMNS[:6]), f"{high:.3%}")
