"""Measure the placement engine's queries, and alternatives to them.

    make bench    (or, once it has set up: .venv/bin/python -m benchmarks.placement --pools 6)

One run on one thread, with library meshes. Each pool has 50 shapes and a pack from a short
evolution; boxes are filled with items of that pack up to a density, and queries are for shapes of
the pool at random scales and rotations. Prints tables, and writes
`benchmarks/results/placement.json` and `docs/images/benchmark-placement.png`.
"""

from __future__ import annotations

import resource
from collections import defaultdict
from typing import Any

import numpy as np
import torch
from rich.console import Console

from benchmarks.alternatives import collision_manager_mask, scipy_mask, torch_mask
from benchmarks.common import (
    PAIR_CACHES,
    Times,
    argument_parser,
    machine,
    milliseconds,
    plot_file,
    summaries,
    write_json,
)
from benchmarks.growth import growth_with_items, growth_with_tables, growth_with_triangles
from benchmarks.placement_report import DENSITIES, check_aims, draw, show
from benchmarks.pools import DENSITY, Pool, prepare
from packit_sim import EvolutionSettings, ShapeLibrary, placement
from packit_sim.core import caches
from packit_sim.core.counters import Counters, counters
from packit_sim.game.generation.chromosomes import Chromosome, crossover, mutate
from packit_sim.game.generation.pack_creator import PackCreator
from packit_sim.game.generation.strategies import select
from packit_sim.placement import MEETINGS_BEFORE_TABLE, collision_mesh


def time_preparation(pools: list[Pool], rng: np.random.Generator) -> Times:
    """Time the preparation of items: the first of a shape and scale, and further rotations."""
    times: Times = defaultdict(list)
    for pool in pools:
        for item in pool.items(30, rng):
            caches.clear("voxels", "turned voxels", "collision meshes")
            upright = item.turned(0)
            voxels = milliseconds(lambda item=upright: item.voxels)
            mesh = milliseconds(collision_mesh, upright)
            times["prepare, first"].append(voxels + mesh)
            times["  of it voxels"].append(voxels)
            times["  of it collision mesh"].append(mesh)
            for rotation in rng.choice(np.arange(1, 24), 4, replace=False).tolist():
                turned = item.turned(rotation)
                times["prepare, further turn"].append(milliseconds(lambda item=turned: item.voxels))
    return times


def time_all_queries(
    pools: list[Pool], density: float, rng: np.random.Generator
) -> tuple[Times, Counters]:
    """Time masks and BLBF queries at a density, and masks of voxels by FFT."""
    times: Times = defaultdict(list)
    before = counters()
    for pool in pools:
        box = pool.packed(density)
        for item in pool.items(12, rng):
            prepare(item)
            caches.clear("collisions")
            times["BLBF"].append(milliseconds(box.blbf, item))
            caches.clear(*PAIR_CACHES)
            times["mask, cold"].append(milliseconds(box.feasible, item))
            times["mask, again"].append(milliseconds(box.feasible, item))
            for _ in range(MEETINGS_BEFORE_TABLE):
                exact = box.feasible(item)
            times["mask, warm"].append(milliseconds(box.feasible, item))
            times["items placed"].append(len(box.placed))
            times["density"].append(box.density)
    counted = counters().since(before)
    for pool in pools:
        box = pool.packed(density)
        for item in pool.items(2, rng):
            exact = box.feasible(item)
            for name, transform in (("scipy", scipy_mask), ("torch", torch_mask)):
                times[f"voxels by FFT, {name}"].append(milliseconds(transform, box, item))
                wrong = transform(box, item) != exact
                times[f"wrong locations, {name}"].append(int(wrong.sum()))
    return times, counted


def time_slow_alternatives(pools: list[Pool], rng: np.random.Generator) -> Times:
    """Time the oracle and trimesh's manager, and the engine's cold mask of the same items."""
    times: Times = defaultdict(list)
    for pool in pools:
        box = pool.packed(DENSITY)
        for item in pool.items(2, rng):
            prepare(item)
            truth = placement.oracle(box, item)
            times["oracle"].append(milliseconds(placement.oracle, box, item))
            caches.clear(*PAIR_CACHES)
            cold = milliseconds(box.feasible, item)
            times["oracle / cold mask"].append(times["oracle"][-1] / cold)
            times["trimesh CollisionManager"].append(
                milliseconds(collision_manager_mask, box, item)
            )
            assert (box.feasible(item) == truth).all()
            wrong = collision_manager_mask(box, item) != truth
            times["wrong locations, trimesh"].append(int(wrong.sum()))
    return times


def time_rotation_masks(pools: list[Pool], rng: np.random.Generator) -> Times:
    """Time masks of all 24 rotations at once."""
    times: Times = defaultdict(list)
    for pool in pools:
        box = pool.packed(DENSITY)
        for item in pool.items(3, rng):
            for rotation in range(24):
                prepare(item.turned(rotation))
            caches.clear(*PAIR_CACHES)
            times["Easy union, cold"].append(milliseconds(box.feasible_rotations, item))
            for _ in range(MEETINGS_BEFORE_TABLE + 1):
                box.feasible_rotations(item)
            times["Easy union, warm"].append(milliseconds(box.feasible_rotations, item))
    return times


def time_chromosomes(pools: list[Pool]) -> tuple[Times, Counters]:
    """Time the packing of children as in an evolution, and a second time."""
    times: Times = defaultdict(list)
    settings = EvolutionSettings()
    before = counters()
    for pool in pools:
        rng = np.random.default_rng(pool.seed)
        scales = [s * pool.size**3 for s in settings.scales]
        creator = PackCreator(pool.shapes, scales, settings.cells)

        def density(chromosome: Chromosome, creator: PackCreator = creator) -> float:
            return creator.pack(chromosome).density

        population = [Chromosome.random(settings, rng) for _ in range(settings.population)]
        densities = [density(chromosome) for chromosome in population]
        for generation in range(12):
            survivors = select(densities, settings, rng)
            population = [population[n] for n in survivors]
            densities = [densities[n] for n in survivors]
            while len(population) < settings.population:
                a, b = rng.choice(settings.survivors, size=2, replace=False)
                child = mutate(crossover(population[a], population[b], rng), settings, rng)
                first = milliseconds(density, child)
                if generation >= 4:
                    times["chromosome, as it comes"].append(first)
                    times["chromosome, once more"].append(milliseconds(density, child))
                population.append(child)
                densities.append(density(child))
    return times, counters().since(before)


def counts(counted: Counters) -> dict[str, Any]:
    return {
        "undecided share of locations": counted.undecided_share,
        "mesh comparisons a query": counted.mesh_comparisons_per_query,
        "queries": counted.queries,
        "caches": {
            name: {"hits": use.hits, "misses": use.misses, "size": use.size, "unit": use.unit}
            for name, use in counted.caches.items()
        },
    }


def main() -> None:
    parser = argument_parser(__doc__, "JSON and picture")
    parser.add_argument("--pools", type=int, default=6, help="number of pools of 50 shapes")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first pool")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=100)
    rng = np.random.default_rng(arguments.seed)
    library = ShapeLibrary.open("everyday")
    seeds = range(arguments.seed, arguments.seed + arguments.pools)
    pools = [Pool.evolved(library, seed) for seed in seeds]
    with console.status("measuring"):
        time_all_queries(pools[:1], DENSITY, rng)  # compiles, and plans the FFTs
        time_rotation_masks(pools[:1], rng)
        prepared = time_preparation(pools, rng)
        packed, packing = time_chromosomes(pools)
        rotated = time_rotation_masks(pools, rng)
        queries = {str(density): time_all_queries(pools, density, rng) for density in DENSITIES}
        growth = {
            "items": growth_with_items(pools[0], rng),
            "triangles": growth_with_triangles(rng),
            "tables": growth_with_tables(pools, rng),
        }
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        slow = time_slow_alternatives(pools, rng)
    result: dict[str, Any] = {
        "command": "python -m benchmarks.placement",
        "pools": arguments.pools,
        "seed": arguments.seed,
        "library": {"name": library.name, "digest": library.digest},
        "machine": machine(),
        "peak memory before the oracle, MB": peak,
        "prepare": summaries(prepared),
        "chromosome": summaries(packed) | {"counts": counts(packing)},
        "easy": summaries(rotated),
        "density": {
            density: summaries(times) | {"counts": counts(counted)}
            for density, (times, counted) in queries.items()
        },
        "slow ways": summaries(slow),
        "growth": {
            name: {str(size): summaries(times) for size, times in series.items()}
            for name, series in growth.items()
        },
    }
    result["bars"] = check_aims(result)
    show(console, result)
    write_json(arguments.out / "placement.json", result)
    draw(result, plot_file(arguments.out, "placement"))
    console.print(f"peak memory before the oracle: {peak:.0f} MB; results are in {arguments.out}")


if __name__ == "__main__":
    main()
