"""Evolution of dense packs (paper, section 3): reproducible, parallel and resumable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct, structs

from packit_sim.core.checks import check_same
from packit_sim.core.errors import StateError
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.datasets.provenance import Evolved
from packit_sim.game.generation.chromosomes import Chromosome
from packit_sim.game.generation.pack_creator import PackCreator, Recipe
from packit_sim.game.generation.strategies import SearchState, search_of
from packit_sim.libraries.library import ShapeLibrary

if TYPE_CHECKING:
    from packit_sim.core.parallel import Workers

BATCHES_PER_WORKER = 4
"""Batches of a generation's children for each worker; several, so that no worker waits long."""


@dataclass(frozen=True)
class Generation:
    """A generation of an evolution.

    Attributes
    ----------
    number : int
        The number of the generation, from 0.
    evaluated : int
        The number of chromosomes evaluated so far.
    best : float
        The best density so far.
    pack : Pack
        The pack with this density.
    """

    number: int
    evaluated: int
    best: float
    pack: Pack


class EvolutionState(Struct, frozen=True):
    """The whole state of an evolution, as checkpoints record it.

    Attributes
    ----------
    random : dict
        The state of the random generator.
    stale : int
        Generations without improvement.
    evaluated : int
        The number of chromosomes evaluated so far.
    densities : list of float
        The best density after each generation.
    kept : list of Pack
        The history.
    best : Pack, optional
        The densest pack; None before the first generation.
    """

    seed: int
    settings: EvolutionSettings
    random: dict[str, Any]
    search: SearchState
    stale: int
    evaluated: int
    densities: list[float]
    kept: list[Pack]
    best: Pack | None


class Evolution:
    """The evolution of one pack, generation by generation.

    The same library, seed and settings lead to the same packs, with any number of workers, and also
    if the evolution is stopped and resumed.

    Parameters
    ----------
    library : ShapeLibrary
        The library of shapes, or one of its splits.
    settings : EvolutionSettings, optional
        The settings; by default the paper's.

    Attributes
    ----------
    densities : list of float
        The best density after each generation.
    kept : list of Pack
        The best pack after generation 0 and every `keep_every` generations (see `Evolved`).
    evaluated : int
        The number of chromosomes evaluated so far.
    """

    def __init__(
        self, library: ShapeLibrary, seed: int, settings: EvolutionSettings | None = None
    ) -> None:
        self.settings = settings or EvolutionSettings()
        self.seed = seed
        self._rng = np.random.default_rng(seed)
        self._recipe = Recipe.drawn(library, self.settings, self._rng)
        self._search = search_of(self.settings)
        self._stale = 0
        self.evaluated = 0
        self.densities: list[float] = []
        self.kept: list[Pack] = []

    @property
    def size(self) -> float:
        """The linear factor on all items of the packs."""
        return self._recipe.size

    @property
    def best(self) -> Pack:
        """The densest pack.

        Raises
        ------
        StateError
            If `step` was not called yet.
        """
        if not self.densities:
            raise StateError("nothing is packed yet: call step() first")
        return self._best

    @property
    def is_over(self) -> bool:
        """True if the limit on generations, or on those without improvement, is reached."""
        return (
            len(self.densities) > self.settings.generations or self._stale >= self.settings.patience
        )

    def step(self, workers: Workers | None = None) -> Generation:
        """Evolve one generation, in this process or on workers."""
        chromosomes = self._search.ask(self._rng)
        densities = self._evaluate(chromosomes, workers)
        self._search.tell(chromosomes, densities)
        self.evaluated += len(chromosomes)
        number = len(self.densities)
        champion = int(np.argmax(densities))
        if not self.densities or densities[champion] > self.densities[-1]:
            self._best = self._pack(chromosomes[champion], number)
            self._stale = 0
        else:
            self._stale += 1
        self.densities.append(self._best.density)
        if number % self.settings.keep_every == 0:
            after = structs.replace(self._best.provenance, after=number)
            self.kept.append(replace(self._best, provenance=after))
        return Generation(number, self.evaluated, self._best.density, self._best)

    @property
    def state(self) -> EvolutionState:
        """The whole state, for `restore`."""
        return EvolutionState(
            seed=self.seed,
            settings=self.settings,
            random=dict(self._rng.bit_generator.state),
            search=self._search.state,
            stale=self._stale,
            evaluated=self.evaluated,
            densities=list(self.densities),
            kept=list(self.kept),
            best=self._best if self.densities else None,
        )

    def restore(self, state: EvolutionState) -> None:
        """Resume from the state of an evolution of the same library.

        Raises
        ------
        ArgumentError
            If it has another seed or other settings.
        """
        check_same(seed=(state.seed, self.seed), settings=(state.settings, self.settings))
        self._rng.bit_generator.state = state.random
        self._search.restore(state.search)
        self._stale, self.evaluated = state.stale, state.evaluated
        self.densities, self.kept = list(state.densities), list(state.kept)
        if state.best is not None:
            self._best = state.best

    def _evaluate(self, chromosomes: Sequence[Chromosome], workers: Workers | None) -> list[float]:
        threshold = self._search.threshold
        if workers is None:
            return densities(self._recipe, chromosomes, threshold)
        count = min(len(chromosomes), BATCHES_PER_WORKER * workers.count)
        batches = [(self._recipe, chromosomes[n::count], threshold) for n in range(count)]
        found = [0.0] * len(chromosomes)
        for n, batch in enumerate(workers.map(densities, batches)):
            found[n::count] = batch
        return found

    def _pack(self, chromosome: Chromosome, number: int) -> Pack:
        return Pack.of(
            _creator(self._recipe).pack(chromosome),
            LibraryRef.of(self._recipe.library),
            Evolved(seed=self.seed, generation=number, size=self.size, settings=self.settings),
        )


def evolve(
    library: ShapeLibrary,
    seed: int,
    settings: EvolutionSettings | None = None,
    on_generation: Callable[[Generation], None] = lambda generation: None,
    *,
    workers: Workers | None = None,
) -> Evolution:
    """Evolve a pack to the end.

    Parameters
    ----------
    library : ShapeLibrary
        The library of shapes, or one of its splits.
    settings : EvolutionSettings, optional
        The settings; by default the paper's.
    on_generation : callable
        Called with each `Generation`.
    workers : Workers, optional
        The workers that evaluate chromosomes; by default this process does.

    Returns
    -------
    Evolution
        The evolution, whose `best` is the densest pack.

    Examples
    --------
    >>> from packit_sim import EvolutionSettings, ShapeLibrary, evolve
    >>> library = ShapeLibrary.open("everyday").split("train")
    >>> settings = EvolutionSettings(pool=10, population=6, elite=2, lucky=1, generations=2)
    >>> evolution = evolve(library, seed=2, settings=settings)
    >>> evolution.evaluated
    12
    >>> [round(density, 3) for density in evolution.densities]
    [0.349, 0.349, 0.353]
    >>> evolution.best.density == evolution.densities[-1]
    True
    """
    evolution = Evolution(library, seed, settings)
    while not evolution.is_over:
        on_generation(evolution.step(workers))
    return evolution


def densities(
    recipe: Recipe, chromosomes: Sequence[Chromosome], threshold: float = 0.0
) -> list[float]:
    """Compute the density of each chromosome's pack, 0 for those below the threshold."""
    creator = _creator(recipe)
    return [creator.density(chromosome, threshold) for chromosome in chromosomes]


@lru_cache(maxsize=1)
def _creator(recipe: Recipe) -> PackCreator:
    """Return the Pack Creator of a pool; a process packs for one pool at a time."""
    return recipe.creator()
