"""Settings of evolution: the paper's numbers, recorded with each pack that evolved."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.lattice import BOX_CELLS, Triple, box_cells

SCALES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""The ratios of volumes at which shapes are packed."""

SearchName = Literal["generational", "elitist"]

SEARCHES: tuple[str, ...] = get_args(SearchName)
"""Ways to choose the next chromosomes (see `searches`)."""


@dataclass(frozen=True)
class EvolutionSettings:
    """The paper's numbers; the two mutation rates are ours, it doesn't give its own.

    pool: shapes drawn, by uniform category, then uniform shape.
    population: chromosomes a generation; the best `elite` survive, `lucky` of the others by chance,
        and children fill the rest.
    generations: at most.
    patience: stop after so many generations without improvement.
    keep_every: the best pack so far is kept at generation 0 and every so many.
    scales: ratios of volumes to choose from.
    size_range: one linear factor on all of a pack's items is drawn from it.
    swap_rate: chance that a child has two places of its order exchanged.
    point_rate: chance for each scale and each rotation of a child to be drawn anew.
    search: which of the `SEARCHES` chooses the next chromosomes; the paper's is "generational".
    cells: of the box, an axis.
    """

    pool: int = 50
    population: int = 100
    elite: int = 25
    lucky: int = 25
    generations: int = 1000
    patience: int = 100
    keep_every: int = 50
    scales: tuple[float, ...] = SCALES
    size_range: tuple[float, float] = (0.75, 1.0)
    swap_rate: float = 0.5
    point_rate: float = 0.02
    search: SearchName = "generational"
    cells: Triple = BOX_CELLS

    def __post_init__(self) -> None:
        """Raises ValueError that names the setting that is out of range."""
        checks = {
            "pool": (self.pool >= 1, "at least 1"),
            "population": (
                self.population > self.survivors,
                f"more than the {self.survivors} survivors",
            ),
            "elite": (self.elite >= 1, "at least 1"),
            "lucky": (self.lucky >= 0, "at least 0"),
            "generations": (self.generations >= 0, "at least 0"),
            "patience": (self.patience >= 1, "at least 1"),
            "keep_every": (self.keep_every >= 1, "at least 1"),
            "scales": (
                len(self.scales) > 0 and all(s > 0 for s in self.scales),
                "one number above 0 or more",
            ),
            "size_range": (
                0 < self.size_range[0] <= self.size_range[1],
                "two numbers above 0, the smaller first",
            ),
            "swap_rate": (0 <= self.swap_rate <= 1, "0 to 1"),
            "point_rate": (0 <= self.point_rate <= 1, "0 to 1"),
            "search": (self.search in SEARCHES, f"choose from {', '.join(SEARCHES)}"),
        }
        if self.search == "climbing":  # type: ignore[comparison-overlap]
            raise ArgumentError(
                "evolution setting search = 'climbing': this search was removed, since its "
                f"packs were less dense; choose from {', '.join(SEARCHES)}"
            )
        for name, (holds, valid) in checks.items():
            if not holds:
                raise ArgumentError(
                    f"evolution setting {name} = {getattr(self, name)!r} is not possible: {valid}"
                )
        box_cells(self.cells)

    def to_json(self) -> dict[str, Any]:
        """The settings in JSON's types."""
        fields: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return fields

    @property
    def survivors(self) -> int:
        return self.elite + self.lucky

    @property
    def children(self) -> int:
        """Chromosomes a generation, after the first."""
        return self.population - self.survivors
