"""Which chromosomes to try next: the paper's generations, or an elitist search.

Searches have the ask-and-tell interface of evolutionary optimisation: `ask` returns chromosomes,
and `tell` takes their densities, batch by batch. A density below the search's `threshold` may be
given as 0, since it can't matter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from msgspec import Struct

from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.generation.chromosomes import Chromosome, crossover, mutate


class SearchState(Struct, frozen=True):
    """The state of a search, as checkpoints record it.

    Attributes
    ----------
    population : list
        The genes of each chromosome.
    densities : list of float
        Their densities.
    """

    population: list[list[list[int]]]
    densities: list[float]


class Search(ABC):
    """A search for dense packs.

    Parameters
    ----------
    settings : EvolutionSettings
        The settings.

    Attributes
    ----------
    population : list of Chromosome
        The chromosomes that the search continues from.
    densities : list of float
        Their densities.
    """

    def __init__(self, settings: EvolutionSettings) -> None:
        self.settings = settings
        self.population: list[Chromosome] = []
        self.densities: list[float] = []

    def ask(self, rng: np.random.Generator) -> list[Chromosome]:
        """The chromosomes to pack next: first a random population, then children."""
        if not self.population:
            return [Chromosome.random(self.settings, rng) for _ in range(self.settings.population)]
        return self._children(rng)

    @abstractmethod
    def tell(self, chromosomes: Sequence[Chromosome], densities: Sequence[float]) -> None:
        """Takes the densities of what was asked for; 0 for one below the threshold."""

    @property
    @abstractmethod
    def threshold(self) -> float:
        """A density that a child must have to be of any use."""

    @abstractmethod
    def _children(self, rng: np.random.Generator) -> list[Chromosome]: ...

    def _child(self, parents: Sequence[Chromosome], rng: np.random.Generator) -> Chromosome:
        """Of two parents by chance, who are one where there is only one."""
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


class Generational(Search):
    """The paper's: the best survive, and some others by chance; children fill the rest.

    Those others are drawn whatever their densities are, so that a density below the best ones'
    never matters.
    """

    def tell(self, chromosomes: Sequence[Chromosome], densities: Sequence[float]) -> None:
        self.population += chromosomes
        self.densities += densities

    @property
    def threshold(self) -> float:
        """The least density of the elite, which never falls."""
        if not self.densities:
            return 0.0
        return sorted(self.densities, reverse=True)[self.settings.elite - 1]

    def _children(self, rng: np.random.Generator) -> list[Chromosome]:
        survivors = select(self.densities, self.settings, rng)
        self.population = [self.population[n] for n in survivors]
        self.densities = [self.densities[n] for n in survivors]
        return [self._child(self.population, rng) for _ in range(self.settings.children)]


class Elitist(Search):
    """Parents and children compete: the best of all survive, no two of them equally dense.

    A (mu + lambda) strategy with the same operators; what is equally dense is mostly the same pack.
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


def search_of(settings: EvolutionSettings) -> Search:
    """A new search of the kind that the settings name."""
    kinds: dict[str, Callable[[EvolutionSettings], Search]] = {
        "generational": Generational,
        "elitist": Elitist,
    }
    return kinds[settings.search](settings)


def select(
    densities: Sequence[float], settings: EvolutionSettings, rng: np.random.Generator
) -> list[int]:
    """Who survives: the best `elite`, the best first, and `lucky` of the others by chance."""
    elite = np.argsort(-np.asarray(densities), kind="stable")[: settings.elite]
    others = np.setdiff1d(np.arange(len(densities)), elite)
    lucky = rng.choice(others, size=settings.lucky, replace=False)
    return [*elite.tolist(), *lucky.tolist()]
