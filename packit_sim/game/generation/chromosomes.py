"""Chromosomes, their crossover and their mutation (paper, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.geometry import rotations


@dataclass(frozen=True, eq=False)
class Chromosome:
    """A way to pack a pool of n shapes.

    Attributes
    ----------
    order : ndarray of int64, shape (n,)
        The order of packing, a permutation of the pool.
    scales : ndarray of int64, shape (n,)
        The index of the scale of each shape of the pool in the settings.
    rotations : ndarray of int64, shape (n,)
        The rotation of each shape of the pool, 0 to 23.
    """

    order: npt.NDArray[np.int64]
    scales: npt.NDArray[np.int64]
    rotations: npt.NDArray[np.int64]

    @classmethod
    def random(cls, settings: EvolutionSettings, rng: np.random.Generator) -> Chromosome:
        """Draw a chromosome uniformly."""
        return cls(
            rng.permutation(settings.pool),
            rng.integers(len(settings.scales), size=settings.pool),
            rng.integers(rotations.COUNT, size=settings.pool),
        )

    def to_json(self) -> list[list[int]]:
        """Return the three arrays as lists."""
        return [self.order.tolist(), self.scales.tolist(), self.rotations.tolist()]

    @classmethod
    def from_json(cls, genes: Sequence[Sequence[int]]) -> Chromosome:
        """Create a chromosome from the lists of `to_json`."""
        order, scales, turns = (np.array(gene, dtype=np.int64) for gene in genes)
        return cls(order, scales, turns)


def crossover(a: Chromosome, b: Chromosome, rng: np.random.Generator) -> Chromosome:
    """Combine parents: order crossover of the order, single-point crossover of the rest."""
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
    """Combine two permutations by Davis' order crossover.

    Parameters
    ----------
    a : ndarray of int64, shape (n,)
        The parent whose places `start` to `stop` are kept.
    b : ndarray of int64, shape (n,)
        The parent that gives the order of the rest.
    start : int
        The first place to keep.
    stop : int
        The end of the places to keep.

    Returns
    -------
    ndarray of int64, shape (n,)
        The child. The rest follows from `stop` on, cyclically, in b's order from `stop` on.
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
    """Exchange two places of the order, and draw some scales and rotations again, by chance."""
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
