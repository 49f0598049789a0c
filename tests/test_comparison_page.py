"""The page that compares PackIt-Sim with other methods quotes the last measurement."""

import json
from pathlib import Path
from typing import Any

from packit_sim.core.confidence import Estimate

ROOT = Path(__file__).parents[1]
MEASURED = json.loads((ROOT / "benchmarks" / "results" / "peers.json").read_text())
PAGE = (ROOT / "docs" / "benchmarks" / "comparison.md").read_text(encoding="utf-8")

PEERS = {
    "`largest-first/aligned/blbf`, the Heuristic": "largest-first/aligned/blbf",
    "the same, stopping": "largest-first/aligned/blbf, stopping",
    "`largest-first/lowest/blbf`": "largest-first/lowest/blbf",
    "`largest-first/aligned/blbf+lns=50`": "largest-first/aligned/blbf+lns=50",
    "the Heuristic on voxels of 1/100, conservative": "heuristic, voxels 1/100, conservative",
    "the Heuristic on voxels of 1/100, sampled": "heuristic, voxels 1/100, sampled",
    "the Heuristic on voxels of 1/50, sampled": "heuristic, voxels 1/50, sampled",
    "spectral, voxels of 1/100, conservative": "spectral 1/100, conservative",
    "spectral, voxels of 1/100, sampled": "spectral 1/100, sampled",
    "spectral, voxels of 1/50, sampled": "spectral 1/50, sampled",
    "heightmaps, conservative": "heightmaps, conservative",
    "heightmaps, sampled": "heightmaps, sampled",
    "cuboids (packvium, bounding boxes)": "cuboids (packvium)",
}
"""The measured methods, by their names on the page."""


def summary(peer: str, together: int) -> dict[str, Any]:
    (found,) = (
        row for row in MEASURED["summary"] if (row["peer"], row["together"]) == (peer, together)
    )
    return found


def quoted() -> dict[str, list[str]]:
    lines = [line for line in PAGE.splitlines() if line.startswith("| ")]
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]
    return {name: rest for name, *rest in rows if name in PEERS}


def test_the_table_quotes_the_last_measurement() -> None:
    table = quoted()
    assert list(table) == list(PEERS)
    for name, (packed, valid, difference, packings, seconds) in table.items():
        row = summary(PEERS[name], together=1)
        assert row["packings"] == 20, name
        assert packed == f"{row['share']['mean']:.3f}", name
        assert valid == f"{row['kept']['mean']:.3f}", name
        assert packings == f"{row['valid']['mean']:.0f}%", name
        assert seconds == format(row["seconds"], ".2f" if row["seconds"] < 1 else ".1f"), name
        if difference:
            against = Estimate(**row["difference"]["difference"])
            mean = f"{against.mean:+.3f}"
            assert difference == f"{mean} ({against.low:+.2f}, {against.high:+.2f})", name


def test_the_densities_of_two_tasks_are_the_measured_ones() -> None:
    for words, name in (
        ("densest:", "spectral, voxels of 1/100, conservative"),
        ("`lowest`", "`largest-first/lowest/blbf`"),
        ("heightmaps", "heightmaps, conservative"),
        ("cuboids", "cuboids (packvium, bounding boxes)"),
        ("the Heuristic", "`largest-first/aligned/blbf`, the Heuristic"),
    ):
        density = summary(PEERS[name], together=2)["density"]["mean"]
        assert f"{words} {density:.3f}" in " ".join(PAGE.split()), words
