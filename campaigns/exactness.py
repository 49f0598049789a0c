"""The page about `packit selftest`: write the tables of the totals of its runs.

packit selftest --minutes 120 --seed 2 --out campaigns/results/exactness.json
python -m campaigns.exactness
"""

from __future__ import annotations

from argparse import ArgumentParser, RawDescriptionHelpFormatter

from benchmarks.common import markdown_table
from campaigns.common import RESULTS, write_into_page
from packit_sim.selftest.totals import KindTotals, Totals

FILE = RESULTS / "exactness.json"

ITEMS = {
    "library": "library meshes",
    "soups": "triangles that share nothing, and hand-made shapes",
    "shells": "open surfaces and thin plates",
    "contacts": "blocks that touch, or nearly do",
    "extremes": "from a fraction of a cell to the whole box",
    "nested": "thin walls, and what may be inside them",
}

COMPARISONS = {
    "cold": "masks with empty caches",
    "warm": "masks with full caches",
    "tables": "masks from no-fit tables",
    "rotations": "masks of the 24 rotations",
    "union": "unions of 24 masks (PackIt-Easy)",
    "restored": "masks after placing, undoing and restoring a snapshot",
    "other order": "masks and cells with the items placed in another order",
    "kinematic": "kinematic masks: clear only where feasible",
    "BLBF": "bottom-left-back locations",
    "one location": "single locations",
    "rotations at": "feasible rotations at single locations",
    "why not": "which items and walls block a location",
    "table offsets": "offsets of a pair in its no-fit table",
    "clear": "locations that are clear by all pairs of triangles",
    "ways up": "ways out of the box in steps of a fine cell",
    "shared volumes": "pairs of items by their boolean volume",
}


def tables(totals: Totals) -> str:
    """Write the tables of the page."""
    everything = KindTotals(
        {name: totals.count(name) for kind in totals.kinds.values() for name in kind.counts},
        sum(kind.differences for kind in totals.kinds.values()),
        sum(kind.core_seconds for kind in totals.kinds.values()),
    )
    rows = [_row("**all**", everything)]
    rows += [_row(text, totals.kinds[name]) for name, text in ITEMS.items() if name in totals.kinds]
    head = ("items", "cases", "masks", "locations", "inside the box", "core-s", "differences")
    counts, found = everything.counts, [each.check for each in totals.differences]
    compared = markdown_table(
        ("compared", "number", "differences"),
        [
            (text, f"{counts[name]:,}", found.count(name))
            for name, text in COMPARISONS.items()
            if name in counts
        ],
    )
    seeds, minutes = ", ".join(totals.seeds), totals.seconds / 60
    return (
        f"{markdown_table(head, rows)}\nPackIt-Sim {totals.version}; {totals.machine}; seeds "
        f"{seeds}; {minutes:,.0f} minutes, of which {everything.core_seconds / 60:,.0f} of "
        f"processor time. {counts['by meshes']:,} of the locations with empty caches were left "
        f"to the meshes.\n\n{compared}"
    )


def _row(name: str, kind: KindTotals) -> tuple[str, ...]:
    numbers = [f"{kind.counts[count]:,}" for count in ("cases", "masks", "locations", "inside")]
    return (name, *numbers, f"{kind.core_seconds:,.0f}", f"{kind.differences:,}")


def main() -> None:
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    write_into_page("exactness", tables(Totals.read(FILE)))


if __name__ == "__main__":
    main()
