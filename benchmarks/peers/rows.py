"""What was measured: a row for each packing, a summary for each peer, and the file of both."""

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
from packit_sim.datasets.packs import Task
from packit_sim.evaluation.evaluation import SLACK
from packit_sim.geometry.lattice import CELLS_PER_UNIT

DIGITS = 6
"""Of shares and seconds, in the file."""


@dataclass(frozen=True)
class Row:
    """A packing.

    together: how many tasks its items are of. task: their digest. items, placed: how many.
    share: of the items' volume that was placed. density: placed volume over the box's.
    kept, kept_density: the same of what is left when conflicts are resolved (see `QualityScores`).
    pairs: of items in conflict. outside: items beyond a wall. seconds: of processor time, with all
    that is made of the meshes for it.
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
        verdict = QualityScores.of(packing, task.cells)
        placed = sum(posed.item.volume for posed in packing)
        kept = sum(packing[n].item.volume for n in verdict.kept)
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
            len(verdict.pairs),
            len(verdict.outside),
            round(seconds, DIGITS),
        )

    @property
    def valid(self) -> bool:
        return not (self.pairs or self.outside)


@dataclass(frozen=True)
class Summary:
    """A peer over some tasks.

    packings: how many. share, density, kept, kept_density, pairs: means of what `Row` has.
    valid, complete: percent of packings without conflict, and without conflict and with every item.
    seconds: the median. difference: of kept from the reference's, task by task.
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
        """Of one peer's rows, and another's for the same tasks in the same order."""
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
            Comparison.of([row.kept for row in rows], [row.kept for row in reference], SLACK),
        )


def summaries(rows: Iterable[Row], reference: str) -> list[Summary]:
    """One for each peer and number of tasks together, in the order of their first rows."""
    groups: dict[tuple[int, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.together, row.peer), []).append(row)
    return [
        Summary.of(own, groups[together, reference])
        for (together, _), own in sorted(groups.items(), key=lambda group: group[0][0])
    ]


def write(file: Path, head: Mapping[str, Any], made: Sequence[Summary], rows: list[Row]) -> None:
    """The file, whole or not at all: JSON with a row a line."""
    text = json.dumps({**head, "summary": [asdict(each) for each in made]}, indent=1)
    lines = ",\n".join(f"  {json.dumps(asdict(row))}" for row in rows)
    replace_text(file, f'{text.removesuffix("}").rstrip()},\n "rows": [\n{lines}\n ]\n}}\n')


def read(file: Path, head: Mapping[str, Any]) -> list[Row]:
    """The rows of a file that was made with the same settings, of a peer that is unchanged."""
    if not file.exists():
        return []
    raw = json.loads(file.read_text())
    if raw["library"] != head["library"]:
        return []
    same = {name for name, settings in head["peers"].items() if raw["peers"].get(name) == settings}
    return [Row(**row) for row in raw["rows"] if row["peer"] in same]
