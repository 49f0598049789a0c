"""What a chromosome costs: the Pack Creator on pools of 50 library shapes.

    .venv/bin/python benchmarks/chromosome.py [--pools 4] [--generations 10]

For each pool, evolution's own workload is timed: the chromosomes of a short evolution, by
generation, once every item is prepared. Prints medians and writes nothing.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from packit_sim import placement
from packit_sim.evolution import (
    Chromosome,
    EvolutionSettings,
    PackCreator,
    crossover,
    draw_pool,
    mutate,
    select,
)
from packit_sim.library import ShapeLibrary
from packit_sim.occupancy import Placed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pools", type=int, default=4)
    parser.add_argument("--generations", type=int, default=10)
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    table = Table(
        "pool",
        "size",
        "first packing, ms",
        "median, ms",
        "90%, ms",
        "items",
        "density",
        "FCL calls",
    )
    for seed in range(arguments.pools):
        table.add_row(*_measure(library, seed, arguments.generations))
    table.caption = "one chromosome of 50 shapes, one thread; 'first' prepares every item anew"
    Console(width=120).print(table)


def _measure(library: ShapeLibrary, seed: int, generations: int) -> list[str]:
    settings = EvolutionSettings()
    rng = np.random.default_rng(seed)
    pool = draw_pool(library, settings.pool, rng)
    size = float(rng.uniform(*settings.size_range))
    creator = PackCreator(pool, [s * size**3 for s in settings.scales], settings.cells)
    first, again, items, calls = [], [], [], []

    def measured(chromosome: Chromosome) -> float:
        first.append(_seconds(creator, chromosome))
        with _FclCalls() as counted:
            again.append(_seconds(creator, chromosome))
        items.append(len(creator.box.placed))
        calls.append(counted.calls / settings.pool)
        return creator.box.density

    population = [Chromosome.random(settings, rng) for _ in range(settings.population)]
    densities = [measured(chromosome) for chromosome in population]
    for _ in range(generations):
        survivors = select(densities, settings, rng)
        population = [population[n] for n in survivors]
        densities = [densities[n] for n in survivors]
        while len(population) < settings.population:
            a, b = rng.choice(settings.survivors, size=2, replace=False)
            population.append(mutate(crossover(population[a], population[b], rng), settings, rng))
            densities.append(measured(population[-1]))
    return [
        str(seed),
        f"{size:.2f}",
        f"{np.median(first) * 1e3:.1f}",
        f"{np.median(again) * 1e3:.1f}",
        f"{np.percentile(again, 90) * 1e3:.1f}",
        f"{np.median(items):.0f}",
        f"{max(densities):.3f}",
        f"{np.mean(calls):.2f} an item",
    ]


def _seconds(creator: PackCreator, chromosome: Chromosome) -> float:
    start = time.perf_counter()
    creator.pack(chromosome)
    return time.perf_counter() - start


class _FclCalls:
    """Counts the engine's calls of FCL while it is entered."""

    def __enter__(self) -> _FclCalls:
        self.calls = 0
        self._collides = placement.collides

        def counted(a: Placed, b: Placed) -> bool:
            self.calls += 1
            return self._collides(a, b)

        placement.collides = counted
        return self

    def __exit__(self, *exc: object) -> None:
        placement.collides = self._collides


if __name__ == "__main__":
    main()
