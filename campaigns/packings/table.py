"""The results of the campaign: counts by format, and the table of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import binomtest

from benchmarks.common import markdown_table
from campaigns.packings.lists import WRITERS
from campaigns.packings.part_files import KINDS

NAME = "packings"

Trial = Mapping[str, Any]


def totals(trials: Mapping[str, Trial]) -> dict[str, Any]:
    """Count trials by format; those with a problem are listed by seed."""
    rows = {}
    groups = {kind: [one for one in trials.values() if kind in one["parts"]] for kind in KINDS}
    groups |= {
        f"list: {kind}": [one for one in trials.values() if one["list"] == kind] for kind in WRITERS
    }
    for kind, own in groups.items():
        rows[kind] = _row(own, kind) | {"parts": sum(one["parts"].get(kind, 0) for one in own)}
    for name in ("by cells", "of bricks", "around a keep-out", "separable"):
        own = [one for one in trials.values() if one[name]]
        rows[f"search: {name}"] = _row(own, "") | {"parts": _parts(own)}
    every = list(trials.values())
    whole = _row(every, "") | {"parts": _parts(every)}
    problems = {seed: one["problems"] for seed, one in trials.items() if one["problems"]}
    return {
        "formats": rows | {"all": whole},
        "items": sum(one["packed"] for one in trials.values()),
        "seconds": round(sum(one["seconds"] for one in trials.values())),
        "problems": problems,
    }


def _parts(trials: Sequence[Trial]) -> int:
    return sum(sum(one["parts"].values()) for one in trials)


def _row(trials: Sequence[Trial], kind: str) -> dict[str, int]:
    """Count packings, and those in which something is wrong or unread for a format."""
    about = [
        [each for each in one["problems"] if not kind or not each["kinds"] or kind in each["kinds"]]
        for one in trials
    ]
    wrong = [own for own in about if any(not each["is_unread"] for each in own)]
    unread = [own for own in about if own and own not in wrong]
    return {"packings": len(trials), "wrong": len(wrong), "unread": len(unread)}


def table(results: Mapping[str, Any]) -> str:
    """Tabulate results in Markdown."""
    rows = []
    for name, row in results["formats"].items():
        n, wrong = row["packings"], row["wrong"]
        if not n:
            continue
        high = binomtest(wrong, n).proportion_ci(0.95, "exact").high
        right = n - wrong - row["unread"]
        cells = (f"{n:,}", f"{row['parts']:,}", f"{right:,}", row["unread"], wrong, f"{high:.2%}")
        rows.append((f"**{name}**" if name == "all" else name, *cells))
    head = ("format", "packings", "parts", "right", "unread", "wrong", "wrong at most (95%)")
    return (
        f"{markdown_table(head, rows)}\nPackIt-Sim {results['version']}; {results['items']:,} "
        f"packed items; seeds {results['seeds']}; "
        f"{results['seconds'] / 60:,.0f} minutes of trials.\n"
    )
