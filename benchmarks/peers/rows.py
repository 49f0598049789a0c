"""Measures: a row for each packing, a summary for each peer, and the file of both."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.posed import Posed
from benchmarks.peers.validity import QualityScores
from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.files import replace_text
from packit_sim.game.datasets.packs import Task
from packit_sim.game.datasets.provenance import RETURN_SLACK
from packit_sim.geometry.lattice import CELLS_PER_UNIT

DIGITS = 6
"""Decimals of shares and seconds in the file."""


@dataclass(frozen=True)
class Row:
    """The measures of one packing.

    Attributes
    ----------
    peer : str
        Name of the peer.
    together : int
        Number of tasks whose items share the box.
    task : str
        Digest of the (joined) task.
    items, placed : int
        Number of items, and of those that were placed.
    share : float
        Placed volume over the items' volume.
    density : float
        Placed volume over the box's volume.
    kept, kept_density : float
        The same after conflicts are resolved (see `QualityScores`).
    pairs : int
        Number of pairs of items in conflict.
    outside : int
        Number of items beyond a wall.
    seconds : float
        CPU seconds, including everything computed from the meshes.
    """

    peer: str
    together: int
    task: str
    items: int
    placed: int
    share: float
    density: float
    kept: float
    kept_density: float
    pairs: int
    outside: int
    seconds: float

    @classmethod
    def of(
        cls, peer: str, together: int, task: Task, packing: Sequence[Posed], seconds: float
    ) -> Row:
        scores = QualityScores.of(packing, task.cells)
        placed = sum(posed.item.volume for posed in packing)
        kept = sum(packing[n].item.volume for n in scores.kept)
        box = float(np.prod(np.array(task.cells) / CELLS_PER_UNIT))
        return cls(
            peer,
            together,
            task.digest,
            len(task.items),
            len(packing),
            round(placed / task.volume, DIGITS),
            round(placed / box, DIGITS),
            round(kept / task.volume, DIGITS),
            round(kept / box, DIGITS),
            len(scores.pairs),
            len(scores.outside),
            round(seconds, DIGITS),
        )

    @property
    def valid(self) -> bool:
        return not (self.pairs or self.outside)


@dataclass(frozen=True)
class Summary:
    """A peer's measures over some tasks.

    Attributes
    ----------
    peer : str
        Name of the peer.
    together : int
        Number of tasks whose items share a box.
    packings : int
        Number of packings.
    share, density, kept, kept_density, pairs : Estimate
        Means of the measures of `Row`.
    valid, complete : Estimate
        Percentages of packings without conflict, and of those that also have every item.
    outside : int
        Number of items beyond a wall.
    seconds : float
        Median CPU seconds.
    difference : Comparison
        Paired difference of `kept` from the reference.
    """

    peer: str
    together: int
    packings: int
    share: Estimate
    density: Estimate
    kept: Estimate
    kept_density: Estimate
    valid: Estimate
    complete: Estimate
    pairs: Estimate
    outside: int
    seconds: float
    difference: Comparison

    @classmethod
    def of(cls, rows: Sequence[Row], reference: Sequence[Row]) -> Summary:
        """Summarise a peer's rows, and compare them with a reference's for the same tasks."""
        assert [row.task for row in rows] == [row.task for row in reference]

        def mean(values: Iterable[float]) -> Estimate:
            return Estimate.of(list(values))

        return cls(
            rows[0].peer,
            rows[0].together,
            len(rows),
            mean(row.share for row in rows),
            mean(row.density for row in rows),
            mean(row.kept for row in rows),
            mean(row.kept_density for row in rows),
            mean(100.0 * row.valid for row in rows),
            mean(100.0 * (row.valid and row.placed == row.items) for row in rows),
            mean(float(row.pairs) for row in rows),
            sum(row.outside for row in rows),
            float(np.median([row.seconds for row in rows])),
            Comparison.of(
                [row.kept for row in rows], [row.kept for row in reference], RETURN_SLACK
            ),
        )


def summaries(rows: Iterable[Row], reference: str) -> list[Summary]:
    """Summarise each peer for each number of joined tasks, in the order of their first rows."""
    groups: dict[tuple[int, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.together, row.peer), []).append(row)
    return [
        Summary.of(own, groups[together, reference])
        for (together, _), own in sorted(groups.items(), key=lambda group: group[0][0])
    ]


def write(file: Path, head: Mapping[str, Any], means: Sequence[Summary], rows: list[Row]) -> None:
    """Write the file atomically, as JSON with one row per line."""
    text = json.dumps({**head, "summary": [asdict(each) for each in means]}, indent=1)
    lines = ",\n".join(f"  {json.dumps(asdict(row))}" for row in rows)
    replace_text(file, f'{text.removesuffix("}").rstrip()},\n "rows": [\n{lines}\n ]\n}}\n')


def read(file: Path, head: Mapping[str, Any]) -> list[Row]:
    """Read the rows of a file for the same library, of peers with unchanged settings."""
    if not file.exists():
        return []
    raw = json.loads(file.read_text())
    if raw["library"] != head["library"]:
        return []
    same = {name for name, settings in head["peers"].items() if raw["peers"].get(name) == settings}
    return [Row(**row) for row in raw["rows"] if row["peer"] in same]
