"""Chromosomes, and what evolution does with them: crossover and mutation (paper, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.geometry import rotations


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
