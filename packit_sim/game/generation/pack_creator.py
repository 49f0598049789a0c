"""The Pack Creator, which packs a pool of shapes by a chromosome (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from packit_sim.box import Box
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.generation.chromosomes import Chromosome
from packit_sim.geometry.lattice import ORIGIN, Triple
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary

_SLACK = 1e-9
"""Tolerance for the rounding of sums of volumes."""


def draw_pool(library: ShapeLibrary, count: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Draw ids: a uniform category, then a uniform shape of it, with replacement."""
    categories = list(library.categories.values())
    drawn = []
    for _ in range(count):
        ids = categories[rng.integers(len(categories))]
        drawn.append(ids[rng.integers(len(ids))])
    return tuple(drawn)


@dataclass(frozen=True)
class Recipe:
    """The ingredients of a Pack Creator, which can be sent to another process.

    Attributes
    ----------
    pool : tuple of str
        The ids of the shapes.
    size : float
        The linear factor on all items.
    scales : tuple of float
        The scales of items without it, ratios of volumes.
    cells : tuple of int
        The box's cells along x, y and z.
    digest : str
        The digest of the library; recipes with different libraries are not equal.
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
        """Draw a pool and a size."""
        pool = draw_pool(library, settings.pool, rng)
        size = float(rng.uniform(*settings.size_range))
        return cls(pool, size, settings.scales, settings.cells, library.digest, library)

    def creator(self) -> PackCreator:
        """Create the Pack Creator; errors are those of loading a shape."""
        scales = [scale * self.size**3 for scale in self.scales]
        return PackCreator([self.library[id] for id in self.pool], scales, self.cells)


class PackCreator:
    """Packs a pool of shapes, one by one, at their bottom-left-back-fill locations.

    Parameters
    ----------
    scales : sequence of float
        The scales of items, including the pack's size factor.
    cells : tuple of int
        The box's cells along x, y and z.

    Attributes
    ----------
    box : Box
        The box, which every pack reuses.
    """

    def __init__(self, pool: Sequence[Shape], scales: Sequence[float], cells: Triple) -> None:
        self.box = Box(cells)
        self._item = cache(lambda n, scale, rotation: Item(pool[n], scales[scale], rotation))

    def pack(self, chromosome: Chromosome) -> Box:
        """Pack every item that has a feasible location in its turn, and return the box."""
        self.density(chromosome)
        return self.box

    def density(self, chromosome: Chromosome, threshold: float = 0.0) -> float:
        """Compute the density of the box of `pack`.

        Parameters
        ----------
        threshold : float, default: 0.0
            The density below which the result does not matter.

        Returns
        -------
        float
            The density, or 0 if it is below the threshold.

        Notes
        -----
        Packing stops as soon as all remaining items together could not reach the threshold. An item
        that fits nowhere now will not fit later, so the largest remaining item is tested early. If
        it fits, its location is where its search starts in its turn.
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
        possible = plain_sum(item.volume for item in items)
        wanted = threshold * self.box.volume - _SLACK
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
