"""Searches, which choose the next chromosomes: the paper's generations, or an elitist search.

Searches have the ask-and-tell interface of evolutionary optimisation: `ask` returns chromosomes,
and `tell` takes their densities, batch by batch. A density below the search's `threshold` may be
given as 0, because it does not matter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from msgspec import Struct

from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.generation.chromosomes import Chromosome, crossover, mutate


class SearchState(Struct, frozen=True):
    """The state of a search, as checkpoints record it.

    Attributes
    ----------
    population : list
        The genes of each chromosome.
    """

    population: list[list[list[int]]]
    densities: list[float]


class EvolutionStrategy(ABC):
    """A search for dense packs.

    Attributes
    ----------
    population : list of Chromosome
        The chromosomes that the search continues from.
    """

    def __init__(self, settings: EvolutionSettings) -> None:
        self.settings = settings
        self.population: list[Chromosome] = []
        self.densities: list[float] = []

    def ask(self, rng: np.random.Generator) -> list[Chromosome]:
        """Return the chromosomes to pack next: first a random population, then children."""
        if not self.population:
            return [Chromosome.random(self.settings, rng) for _ in range(self.settings.population)]
        return self._children(rng)

    @abstractmethod
    def tell(self, chromosomes: Sequence[Chromosome], densities: Sequence[float]) -> None:
        """Take the densities of the chromosomes that `ask` returned, 0 if below the threshold."""

    @property
    @abstractmethod
    def threshold(self) -> float:
        """The density below which a child can't survive."""

    @abstractmethod
    def _children(self, rng: np.random.Generator) -> list[Chromosome]: ...

    def _child(self, parents: Sequence[Chromosome], rng: np.random.Generator) -> Chromosome:
        """Create a child of two random parents, or of a single one twice."""
        a, b = rng.choice(len(parents), size=2, replace=len(parents) < 2)
        return mutate(crossover(parents[a], parents[b], rng), self.settings, rng)

    @property
    def state(self) -> SearchState:
        """The chromosomes that the search continues from, for `restore`."""
        population = [chromosome.to_json() for chromosome in self.population]
        return SearchState(population, list(self.densities))

    def restore(self, state: SearchState) -> None:
        """Continue from the state of a search of the same kind."""
        self.population = [Chromosome.from_json(genes) for genes in state.population]
        self.densities = list(state.densities)


class Generational(EvolutionStrategy):
    """The paper's search: the best survive, and some others by chance; children fill the rest.

    The others are drawn regardless of their densities, so a density below the elite's never
    matters.
    """

    def tell(self, chromosomes: Sequence[Chromosome], densities: Sequence[float]) -> None:
        self.population += chromosomes
        self.densities += densities

    @property
    def threshold(self) -> float:
        """The lowest density of the elite, which never falls."""
        if not self.densities:
            return 0.0
        return sorted(self.densities, reverse=True)[self.settings.elite - 1]

    def _children(self, rng: np.random.Generator) -> list[Chromosome]:
        survivors = select(self.densities, self.settings, rng)
        self.population = [self.population[n] for n in survivors]
        self.densities = [self.densities[n] for n in survivors]
        return [self._child(self.population, rng) for _ in range(self.settings.children)]


class Elitist(EvolutionStrategy):
    """The best parents and children survive, no two of them with the same density.

    A (mu + lambda) strategy with the same operators; equal densities are mostly equal packs.
    """

    def tell(self, chromosomes: Sequence[Chromosome], densities: Sequence[float]) -> None:
        everyone = dict(zip(self.densities, self.population, strict=True))
        for density, chromosome in zip(densities, chromosomes, strict=True):
            everyone.setdefault(density, chromosome)
        ranked = sorted(everyone, reverse=True)[: self.settings.survivors]
        self.densities, self.population = ranked, [everyone[density] for density in ranked]

    @property
    def threshold(self) -> float:
        full = len(self.densities) >= self.settings.survivors
        return self.densities[-1] if full else 0.0

    def _children(self, rng: np.random.Generator) -> list[Chromosome]:
        return [self._child(self.population, rng) for _ in range(self.settings.children)]


def search_of(settings: EvolutionSettings) -> EvolutionStrategy:
    """Create the search that the settings name."""
    kinds: dict[str, Callable[[EvolutionSettings], EvolutionStrategy]] = {
        "generational": Generational,
        "elitist": Elitist,
    }
    return kinds[settings.search](settings)


def select(
    densities: Sequence[float], settings: EvolutionSettings, rng: np.random.Generator
) -> list[int]:
    """Select the survivors: the best `elite`, best first, and `lucky` of the others by chance."""
    elite = np.argsort(-np.asarray(densities), kind="stable")[: settings.elite]
    others = np.setdiff1d(np.arange(len(densities)), elite)
    lucky = rng.choice(others, size=settings.lucky, replace=False)
    return [*elite.tolist(), *lucky.tolist()]
