"""Pools of shapes, boxes filled from them, and queries to time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.common import PAIR_CACHES, Times, milliseconds
from packit_sim import Box, EvolutionSettings, Item, Shape, ShapeLibrary, evolve, placement
from packit_sim.core import caches
from packit_sim.game.datasets.evolution_settings import SCALES
from packit_sim.game.generation.pack_creator import draw_pool
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.placement import MEETINGS_BEFORE_TABLE, collision_mesh

DENSITY = 0.3
"""The density of boxes for which the aims hold."""


@dataclass(frozen=True)
class Pool:
    """Shapes, the linear size factor of their items, and a pack from a short evolution."""

    seed: int
    shapes: tuple[Shape, ...]
    size: float
    pack: Box

    @classmethod
    def evolved(cls, library: ShapeLibrary, seed: int) -> Pool:
        """Evolve a pack without the two largest scales, so that no item fills half the box."""
        settings = EvolutionSettings(generations=10, scales=SCALES[:3])
        evolution = evolve(library, seed, settings)
        ids = draw_pool(library, settings.pool, np.random.default_rng(seed))
        shapes = tuple(library[id] for id in ids)
        return cls(seed, shapes, evolution.size, evolution.best.replay(library))

    def packed(self, density: float) -> Box:
        """Place items of the pack, smallest first, up to a density (at most 5% above it)."""
        box = Box()
        for placed in sorted(self.pack.placed, key=lambda placed: placed.item.volume):
            if box.density + placed.item.volume <= 1.05 * density:
                box.place(placed.item, placed.location)
        return box

    def items(self, count: int, rng: np.random.Generator) -> Iterator[Item]:
        """Draw random shapes, scales and rotations that are not larger than the box."""
        while count:
            shape = self.shapes[rng.integers(len(self.shapes))]
            scale = SCALES[rng.integers(len(SCALES))] * self.size**3
            item = Item(shape, scale, int(rng.integers(24)))
            if placement.fits(BOX_CELLS, item):
                count -= 1
                yield item


def random_item(
    shapes: Sequence[Shape], rng: np.random.Generator, smallest: float = 0.3, largest: float = 0.5
) -> Item:
    """Draw a shape, a linear scale between two limits, and a rotation."""
    shape = shapes[int(rng.integers(len(shapes)))]
    return Item(shape, rng.uniform(smallest, largest) ** 3, int(rng.integers(24)))


def prepare(item: Item) -> None:
    """Compute what is computed once for a shape and scale, and for each of its rotations."""
    _ = item.voxels
    collision_mesh(item)


def time_queries(box: Box, item: Item, times: Times) -> None:
    """Time a BLBF query, a cold mask and a warm mask."""
    prepare(item)
    caches.clear(*PAIR_CACHES)
    times["BLBF"].append(milliseconds(box.blbf, item))
    caches.clear(*PAIR_CACHES)
    times["mask, cold"].append(milliseconds(box.feasible, item))
    for _ in range(MEETINGS_BEFORE_TABLE + 1):
        box.feasible(item)
    times["mask, warm"].append(milliseconds(box.feasible, item))
