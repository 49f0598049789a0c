"""A search by the operators of DEAP, an off-the-shelf library for evolution."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from deap import algorithms, base, tools

from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.generation.chromosomes import Chromosome
from packit_sim.game.generation.strategies import EvolutionStrategy
from packit_sim.geometry import rotations

TOURNAMENT = 3
"""Chromosomes in a tournament, as in DEAP's examples; the densest wins."""

CROSSOVER = 0.7
"""Share of children by crossover, as in DEAP's examples; the others are by mutation."""

RATE = 0.02
"""Probability that a mutation changes a gene (a place, scale or rotation), as in ours."""


class Density(base.Fitness):  # type: ignore[misc] # DEAP has no hints
    weights = (1.0,)


@dataclass
class Individual:
    """A chromosome as three lists, which DEAP's operators change in place."""

    genes: list[list[int]]
    fitness: Density

    @classmethod
    def of(cls, chromosome: Chromosome, density: float) -> Individual:
        return cls(chromosome.to_json(), Density((density,)))


class Tournaments(EvolutionStrategy):
    """DEAP's (mu + lambda): tournaments among parents and children; the best is kept.

    Children are created by partially matched crossover of the order and two-point crossover of
    scales and rotations, or by shuffling places and redrawing genes.
    """

    def __init__(self, settings: EvolutionSettings) -> None:
        super().__init__(settings)
        self._toolbox = base.Toolbox()
        self._toolbox.register("clone", copy.deepcopy)
        self._toolbox.register("mate", _mate)
        self._toolbox.register("mutate", _mutate, scales=len(settings.scales))

    def tell(self, chromosomes: Sequence[Chromosome], densities: Sequence[float]) -> None:
        self.population += chromosomes
        self.densities += densities

    @property
    def threshold(self) -> float:
        """Always 0: any density may win a tournament."""
        return 0.0

    def _children(self, rng: np.random.Generator) -> list[Chromosome]:
        everyone = [
            Individual.of(chromosome, density)
            for chromosome, density in zip(self.population, self.densities, strict=True)
        ]
        with _seeded(rng):
            kept = tools.selBest(everyone, 1)
            kept += tools.selTournament(everyone, self.settings.survivors - 1, TOURNAMENT)
            children = algorithms.varOr(
                kept, self._toolbox, self.settings.children, CROSSOVER, 1 - CROSSOVER
            )
        self.population = [Chromosome.from_json(one.genes) for one in kept]
        self.densities = [one.fitness.values[0] for one in kept]
        return [Chromosome.from_json(one.genes) for one in children]


def _mate(a: Individual, b: Individual) -> tuple[Individual, Individual]:
    for cross, ours, theirs in zip(
        (tools.cxPartialyMatched, tools.cxTwoPoint, tools.cxTwoPoint), a.genes, b.genes, strict=True
    ):
        cross(ours, theirs)
    return a, b


def _mutate(individual: Individual, scales: int) -> tuple[Individual]:
    order, sizes, turns = individual.genes
    tools.mutShuffleIndexes(order, RATE)
    tools.mutUniformInt(sizes, 0, scales - 1, RATE)
    tools.mutUniformInt(turns, 0, rotations.COUNT - 1, RATE)
    return (individual,)


@contextmanager
def _seeded(rng: np.random.Generator) -> Iterator[None]:
    """Seed Python's generator, which DEAP uses, from ours; restore it afterwards."""
    before = random.getstate()
    random.seed(int(rng.integers(2**63)))
    try:
        yield
    finally:
        random.setstate(before)
