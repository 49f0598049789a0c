"""The Pack Creator: packs a pool of shapes as a chromosome says (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from packit_sim.box import Box
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.generation.chromosomes import Chromosome
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.placement import ORIGIN

_SLACK = 1e-9
"""Rounding of sums of volumes."""


def draw_pool(library: ShapeLibrary, count: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Ids of shapes of a uniform category, then a uniform shape of it; one may come more often."""
    categories = list(library.categories.values())
    drawn = []
    for _ in range(count):
        ids = categories[rng.integers(len(categories))]
        drawn.append(ids[rng.integers(len(ids))])
    return tuple(drawn)


@dataclass(frozen=True)
class Recipe:
    """What a Pack Creator is made of, here or in another process.

    pool: ids of shapes of the library, which `digest` tells from others. size: one linear factor on
    all items. scales: ratios of volumes to choose from, without it. cells: the box's, an axis.
    """

    pool: tuple[str, ...]
    size: float
    scales: tuple[float, ...]
    cells: Triple
    digest: str
    library: ShapeLibrary = field(compare=False)

    @classmethod
    def drawn(
        cls, library: ShapeLibrary, settings: EvolutionSettings, rng: np.random.Generator
    ) -> Recipe:
        """A pool and a size by chance."""
        pool = draw_pool(library, settings.pool, rng)
        size = float(rng.uniform(*settings.size_range))
        return cls(pool, size, settings.scales, settings.cells, library.digest, library)

    def creator(self) -> PackCreator:
        """Raises what loading a shape does."""
        scales = [scale * self.size**3 for scale in self.scales]
        return PackCreator([self.library[id] for id in self.pool], scales, self.cells)


class PackCreator:
    """Packs a pool of shapes: each in its turn at its bottom-left-back-fill location.

    pool: the shapes. scales: to choose from, the pack's size factor included. box: reused.
    """

    def __init__(self, pool: Sequence[Shape], scales: Sequence[float], cells: Triple) -> None:
        self.pool = pool
        self.scales = scales
        self.box = Box(cells)
        self._volume = float(self.box.size.prod())
        self._item = cache(lambda n, scale, rotation: Item(pool[n], scales[scale], rotation))

    def pack(self, chromosome: Chromosome) -> Box:
        """The box with every item that has a feasible location when its turn comes."""
        self.density(chromosome)
        return self.box

    def density(self, chromosome: Chromosome, threshold: float = 0.0) -> float:
        """The density of that box, or 0 where it is below the threshold.

        It is given up as soon as even all items that are left could not lift it there. Room that is
        gone never comes back: so the largest of them is asked early whether there is room for it,
        and where it was found to have some its search goes on when its turn comes.
        """
        self.box.clear()
        genes = zip(
            chromosome.order.tolist(),
            chromosome.scales[chromosome.order].tolist(),
            chromosome.rotations[chromosome.order].tolist(),
            strict=True,
        )
        items = [self._item(*gene) for gene in genes]
        starts: list[Triple | None] = [ORIGIN] * len(items)
        by_volume = sorted(range(len(items)), key=lambda n: items[n].volume)
        waiting = by_volume if threshold > 0 else []
        possible = sum(item.volume for item in items)
        wanted = threshold * self._volume - _SLACK
        for n, item in enumerate(items):
            start = starts[n]
            if start is None:
                continue
            if self.box.fill(item, start) is None:
                possible -= item.volume
            while waiting and possible >= wanted:
                largest = waiting[-1]
                if largest > n:
                    starts[largest] = self.box.blbf(items[largest], starts[largest] or ORIGIN)
                    if starts[largest] is not None:
                        break
                    possible -= items[largest].volume
                waiting.pop()
            if possible < wanted:
                return 0.0
        return self.box.density
