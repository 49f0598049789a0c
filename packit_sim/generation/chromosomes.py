"""Chromosomes, and what evolution does with them: crossover and mutation (paper, section 3)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry import rotations
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
            "pool": self.pool >= 1,
            "population": self.population > self.survivors,
            "elite": self.elite >= 1,
            "lucky": self.lucky >= 0,
            "generations": self.generations >= 0,
            "patience": self.patience >= 1,
            "keep_every": self.keep_every >= 1,
            "scales": len(self.scales) > 0 and all(s > 0 for s in self.scales),
            "size_range": 0 < self.size_range[0] <= self.size_range[1],
            "swap_rate": 0 <= self.swap_rate <= 1,
            "point_rate": 0 <= self.point_rate <= 1,
            "search": self.search in SEARCHES,
        }
        if self.search == "climbing":  # type: ignore[comparison-overlap]
            raise ValueError(
                "evolution setting search = 'climbing': this search was removed, since its "
                f"packs were less dense; choose from {', '.join(SEARCHES)}"
            )
        for name, holds in checks.items():
            if not holds:
                raise ArgumentError(
                    f"evolution setting {name} = {getattr(self, name)!r} is not possible"
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


@dataclass(frozen=True, eq=False)
class Chromosome:
    """How to pack a pool of n shapes.

    order: (n,) a permutation of the pool. scales: (n,) indices into the settings' scales, and
    rotations: (n,) 0 to 23, both by shape of the pool, not by order.
    """

    order: npt.NDArray[np.int64]
    scales: npt.NDArray[np.int64]
    rotations: npt.NDArray[np.int64]

    @classmethod
    def random(cls, settings: EvolutionSettings, rng: np.random.Generator) -> Chromosome:
        return cls(
            rng.permutation(settings.pool),
            rng.integers(len(settings.scales), size=settings.pool),
            rng.integers(rotations.COUNT, size=settings.pool),
        )

    def to_json(self) -> list[list[int]]:
        """The three arrays as lists."""
        return [self.order.tolist(), self.scales.tolist(), self.rotations.tolist()]

    @classmethod
    def from_json(cls, genes: Sequence[Sequence[int]]) -> Chromosome:
        order, scales, turns = (np.array(gene, dtype=np.int64) for gene in genes)
        return cls(order, scales, turns)


def crossover(a: Chromosome, b: Chromosome, rng: np.random.Generator) -> Chromosome:
    """A child: order crossover on the order, single-point crossover on scales and rotations."""
    n = len(a.order)
    start, stop = sorted(rng.integers(n + 1, size=2).tolist())
    scale_point, rotation_point = rng.integers(n + 1, size=2).tolist()
    return Chromosome(
        order_crossover(a.order, b.order, start, stop),
        np.concatenate([a.scales[:scale_point], b.scales[scale_point:]]),
        np.concatenate([a.rotations[:rotation_point], b.rotations[rotation_point:]]),
    )


def order_crossover(
    a: npt.NDArray[np.int64], b: npt.NDArray[np.int64], start: int, stop: int
) -> npt.NDArray[np.int64]:
    """Davis' order crossover: a's part [start, stop) in its place, around it the rest in b's order.

    The rest is filled in from `stop` on, cyclically, in the order in which b has it from `stop` on.
    """
    n = len(a)
    rest = np.roll(b, -stop)
    rest = rest[~np.isin(rest, a[start:stop])]
    child = np.empty_like(a)
    child[start:stop] = a[start:stop]
    child[np.arange(stop, stop + n - (stop - start)) % n] = rest
    return child


def mutate(
    chromosome: Chromosome, settings: EvolutionSettings, rng: np.random.Generator
) -> Chromosome:
    """Ordered mutation (two places of the order exchanged) and point mutation of the rest."""
    n = len(chromosome.order)
    order = chromosome.order.copy()
    if rng.random() < settings.swap_rate:
        places = rng.integers(n, size=2)
        order[places] = order[places[::-1]]
    fresh = Chromosome.random(settings, rng)
    new_scale, new_rotation = rng.random((2, n)) < settings.point_rate
    return Chromosome(
        order,
        np.where(new_scale, fresh.scales, chromosome.scales),
        np.where(new_rotation, fresh.rotations, chromosome.rotations),
    )
