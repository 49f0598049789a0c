"""What the placement engine's answers cost, beside other ways to get them.

    make bench    (or, once it has set up: .venv/bin/python -m benchmarks.placement --pools 6)

One run, one thread, library meshes. Each pool is 50 shapes of a short evolution; boxes hold items
of its pack up to a density; questions are about the pool's shapes at random scales and rotations.
Prints tables, and writes `benchmarks/results/placement.json` and `.png`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from trimesh import creation

from benchmarks.alternatives import collision_manager_mask, scipy_mask, torch_mask
from packit_sim import Box, EvolutionSettings, Item, Shape, ShapeLibrary, evolve, placement
from packit_sim.core import caches
from packit_sim.core.counters import Counters, counters
from packit_sim.datasets.evolution_settings import SCALES
from packit_sim.engine.collision import collision_mesh
from packit_sim.engine.nofit import MEETINGS
from packit_sim.generation.chromosomes import Chromosome, crossover, mutate
from packit_sim.generation.pack_creator import PackCreator, draw_pool
from packit_sim.generation.strategies import select
from packit_sim.geometry.lattice import BOX_CELLS

RESULTS = Path(__file__).parent / "results"
DENSITIES = (0.0, 0.2, 0.3, 0.4)
BAR_DENSITY = 0.3
PAIR_MEMORY = ("collisions", "no-fit tables", "pairs that met")

Times = dict[str, list[float]]


@dataclass(frozen=True)
class Pool:
    """Shapes, the linear size factor of what is packed of them, and a pack of a short evolution."""

    seed: int
    shapes: tuple[Shape, ...]
    size: float
    pack: Box

    @classmethod
    def evolved(cls, library: ShapeLibrary, seed: int) -> Pool:
        """Without the largest two scales, so that no single item fills half the box."""
        settings = EvolutionSettings(generations=10, scales=SCALES[:3])
        evolution = evolve(library, seed, settings)
        ids = draw_pool(library, settings.pool, np.random.default_rng(seed))
        shapes = tuple(library[id] for id in ids)
        return cls(seed, shapes, evolution.size, evolution.best.replay(library))

    def packed(self, density: float) -> Box:
        """Items of the pack, where they stand: as many as there may be, or a little denser."""
        box = Box()
        for placed in sorted(self.pack.placed, key=lambda placed: placed.item.volume):
            if box.density + placed.item.volume <= 1.05 * density:
                box.place(placed.item, placed.location)
        return box

    def items(self, count: int, rng: np.random.Generator) -> Iterator[Item]:
        """Random shapes, scales and rotations that are not larger than the box."""
        while count:
            shape = self.shapes[rng.integers(len(self.shapes))]
            scale = SCALES[rng.integers(len(SCALES))] * self.size**3
            item = Item(shape, scale, int(rng.integers(24)))
            if placement.fits(BOX_CELLS, item):
                count -= 1
                yield item


def timed(function: Callable[..., Any], *arguments: Any) -> float:
    """Milliseconds of one call."""
    start = time.perf_counter()
    function(*arguments)
    return (time.perf_counter() - start) * 1e3


def prepare(item: Item) -> None:
    """What is made once for a shape and scale, and for each turn of it."""
    _ = item.voxels
    collision_mesh(item)


def preparing(pools: list[Pool], rng: np.random.Generator) -> Times:
    """Items made anew: the first of a shape and scale, its two parts, and further turns."""
    times: Times = defaultdict(list)
    for pool in pools:
        for item in pool.items(30, rng):
            caches.clear("voxels", "turned voxels", "collision meshes")
            upright = item.turned(0)
            voxels = timed(lambda item=upright: item.voxels)
            mesh = timed(collision_mesh, upright)
            times["prepare, first"].append(voxels + mesh)
            times["  of it voxels"].append(voxels)
            times["  of it collision mesh"].append(mesh)
            for rotation in rng.choice(np.arange(1, 24), 4, replace=False).tolist():
                turned = item.turned(rotation)
                times["prepare, further turn"].append(timed(lambda item=turned: item.voxels))
    return times


def questions(
    pools: list[Pool], density: float, rng: np.random.Generator
) -> tuple[Times, Counters]:
    """Masks and BLBF queries at a density, and voxels by FFT beside them."""
    times: Times = defaultdict(list)
    before = counters()
    for pool in pools:
        box = pool.packed(density)
        for item in pool.items(12, rng):
            prepare(item)
            caches.clear("collisions")
            times["BLBF"].append(timed(box.blbf, item))
            caches.clear(*PAIR_MEMORY)
            times["mask, cold"].append(timed(box.feasible, item))
            times["mask, again"].append(timed(box.feasible, item))
            for _ in range(MEETINGS):
                exact = box.feasible(item)
            times["mask, warm"].append(timed(box.feasible, item))
            times["items placed"].append(len(box.placed))
            times["density"].append(box.density)
    counted = counters().since(before)
    for pool in pools:
        box = pool.packed(density)
        for item in pool.items(2, rng):
            exact = box.feasible(item)
            for name, transform in (("scipy", scipy_mask), ("torch", torch_mask)):
                times[f"voxels by FFT, {name}"].append(timed(transform, box, item))
                wrong = transform(box, item) != exact
                times[f"wrong locations, {name}"].append(int(wrong.sum()))
    return times, counted


def slow_ways(pools: list[Pool], rng: np.random.Generator) -> Times:
    """The oracle and trimesh's manager beside the engine's cold mask, question by question."""
    times: Times = defaultdict(list)
    for pool in pools:
        box = pool.packed(BAR_DENSITY)
        for item in pool.items(2, rng):
            prepare(item)
            truth = placement.oracle(box, item)
            times["oracle"].append(timed(placement.oracle, box, item))
            caches.clear(*PAIR_MEMORY)
            own = timed(box.feasible, item)
            times["oracle / cold mask"].append(times["oracle"][-1] / own)
            times["trimesh CollisionManager"].append(timed(collision_manager_mask, box, item))
            assert (box.feasible(item) == truth).all()
            wrong = collision_manager_mask(box, item) != truth
            times["wrong locations, trimesh"].append(int(wrong.sum()))
    return times


def easy(pools: list[Pool], rng: np.random.Generator) -> Times:
    """All 24 rotations at once."""
    times: Times = defaultdict(list)
    for pool in pools:
        box = pool.packed(BAR_DENSITY)
        for item in pool.items(3, rng):
            for rotation in range(24):
                prepare(item.turned(rotation))
            caches.clear(*PAIR_MEMORY)
            times["Easy union, cold"].append(timed(box.feasible_rotations, item))
            for _ in range(MEETINGS + 1):
                box.feasible_rotations(item)
            times["Easy union, warm"].append(timed(box.feasible_rotations, item))
    return times


def chromosomes(pools: list[Pool]) -> tuple[Times, Counters]:
    """What evolution does: each child packed as it comes, and once more."""
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
                came = timed(density, child)
                if generation >= 4:
                    times["chromosome, as it comes"].append(came)
                    times["chromosome, once more"].append(timed(density, child))
                population.append(child)
                densities.append(density(child))
    return times, counters().since(before)


def growth_with_items(pool: Pool, rng: np.random.Generator) -> dict[int, Times]:
    """Questions in a box that fills up with 5 to 50 small items."""
    box = Box()
    series: dict[int, Times] = {}
    while len(box.placed) < 50:
        shape = pool.shapes[rng.integers(len(pool.shapes))]
        item = Item(shape, rng.uniform(0.25, 0.4) ** 3, int(rng.integers(24)))
        location = box.blbf(item)
        if location is None:
            continue
        box.place(item, location)
        if len(box.placed) % 5 == 0:
            times = series[len(box.placed)] = defaultdict(list)
            for question in range(20):
                shape = pool.shapes[question]
                item = Item(shape, rng.uniform(0.3, 0.5) ** 3, int(rng.integers(24)))
                _questions(box, item, times)
    return series


def growth_with_triangles(rng: np.random.Generator) -> dict[int, Times]:
    """Questions about bumpy rings of 500 to 50,000 triangles among others of as many."""
    series: dict[int, Times] = {}
    for triangles in (500, 1500, 5000, 15000, 50000):
        around = round((triangles / 2) ** 0.5)
        shapes = []
        for n in range(4):
            ring = creation.torus(0.5, 0.15 + 0.05 * n, around, around)
            bumps = 1 + 0.05 * np.sin(9 * ring.vertices) @ (1, 2, 3)
            ring.vertices *= bumps[:, None]
            shapes.append(Shape.from_mesh(ring, f"ring {n}"))
        times = series[len(shapes[0].mesh.faces)] = defaultdict(list)
        for _ in range(3):
            box = Box()
            for _ in range(30):
                item = Item(
                    shapes[rng.integers(4)], rng.uniform(0.3, 0.5) ** 3, int(rng.integers(24))
                )
                location = box.blbf(item)
                if location is not None and box.density < BAR_DENSITY:
                    box.place(item, location)
            for _ in range(6):
                item = Item(
                    shapes[rng.integers(4)], rng.uniform(0.3, 0.5) ** 3, int(rng.integers(24))
                )
                caches.clear("voxels", "turned voxels", "collision meshes")
                times["prepare, first"].append(timed(prepare, item))
                for placed in box.placed:
                    prepare(placed.item)
                _questions(box, item, times)
    return series


def growth_with_tables(pools: list[Pool], rng: np.random.Generator) -> dict[int, Times]:
    """Masks of the same items over and over, by the budget of the no-fit tables in kilobytes."""
    series: dict[int, Times] = {}
    boxes = [(pool.packed(BAR_DENSITY), list(pool.items(6, rng))) for pool in pools]
    budget = caches.usage()["no-fit tables"].budget
    for kilobytes in (1, 64, 256, 1024, 4096, 16384):
        caches.clear(*PAIR_MEMORY)
        caches.limit("no-fit tables", kilobytes * 1024)
        times = series[kilobytes] = defaultdict(list)
        for pass_ in range(MEETINGS + 4):
            for box, items in boxes:
                for item in items:
                    asked = timed(box.feasible, item)
                    if pass_ > MEETINGS + 1:
                        times["mask"].append(asked)
        times["tables kept, kB"].append(caches.usage()["no-fit tables"].size / 1024)
    caches.limit("no-fit tables", int(budget))
    return series


def _any_item(shapes: list[Shape], rng: np.random.Generator) -> Item:
    shape = shapes[rng.integers(len(shapes))]
    return Item(shape, rng.uniform(0.3, 0.5) ** 3, int(rng.integers(24)))


def _questions(box: Box, item: Item, times: Times) -> None:
    prepare(item)
    caches.clear(*PAIR_MEMORY)
    times["BLBF"].append(timed(box.blbf, item))
    caches.clear(*PAIR_MEMORY)
    times["mask, cold"].append(timed(box.feasible, item))
    for _ in range(MEETINGS + 1):
        box.feasible(item)
    times["mask, warm"].append(timed(box.feasible, item))


def summary(values: list[float]) -> dict[str, float]:
    low, median, high = np.percentile(values, (10, 50, 90)).tolist()
    return {"median": median, "p10": low, "p90": high, "n": len(values)}


def summaries(times: Times) -> dict[str, dict[str, float]]:
    return {name: summary(values) for name, values in times.items()}


def counts(counted: Counters) -> dict[str, Any]:
    return {
        "undecided share of locations": counted.undecided_share,
        "FCL calls a query": counted.fcl_calls_per_query,
        "queries": counted.queries,
        "caches": {
            name: {"hits": use.hits, "misses": use.misses, "size": use.size, "unit": use.unit}
            for name, use in counted.caches.items()
        },
    }


def bars(result: dict[str, Any]) -> list[dict[str, Any]]:
    """The aims, and what this run says of them; ms, or times."""
    at = result["density"][str(BAR_DENSITY)]
    fft = min(at[f"voxels by FFT, {name}"]["median"] for name in ("scipy", "torch"))
    rows = [
        ("BLBF query", at["BLBF"]["median"], "<=", 0.25),
        ("mask, cold", at["mask, cold"]["median"], "<=", 3),
        ("prepare, first", result["prepare"]["prepare, first"]["median"], "<=", 15),
        ("prepare, further turn", result["prepare"]["prepare, further turn"]["median"], "<=", 0.5),
        ("mask, warm", at["mask, warm"]["median"], "<=", 0.2),
        ("chromosome", result["chromosome"]["chromosome, as it comes"]["median"], "<=", 10),
        ("Easy union, warm", result["easy"]["Easy union, warm"]["median"], "<=", 10),
        ("oracle / cold mask", result["slow ways"]["oracle / cold mask"]["median"], ">=", 500),
        ("FFT / cold mask", fft / at["mask, cold"]["median"], ">=", 1),
    ]
    return [
        {
            "what": what,
            "measured": value,
            "aim": f"{sign} {aim:g}",
            "met": bool(value <= aim if sign == "<=" else value >= aim),
        }
        for what, value, sign, aim in rows
    ]


def show(console: Console, result: dict[str, Any]) -> None:
    table = Table("density 0.3", "measured", "aim", "met", title="aims: ms, or times")
    for row in result["bars"]:
        table.add_row(
            row["what"], f"{row['measured']:.3g}", row["aim"], "yes" if row["met"] else "NO"
        )
    console.print(table)
    table = Table("", "density", "median", "10%", "90%", "n", title="milliseconds, or counts")
    sections = [("", result["prepare"])]
    sections += [(density, times) for density, times in result["density"].items()]
    sections += [("0.3", result["easy"]), ("0.3", result["slow ways"]), ("", result["chromosome"])]
    for density, times in sections:
        for name, row in times.items():
            if "median" in row:
                cells = [f"{row[key]:.3g}" for key in ("median", "p10", "p90")]
                table.add_row(name, density, *cells, str(row["n"]))
    console.print(table)
    for name in ("items", "triangles", "tables"):
        series = result["growth"][name]
        table = Table(name, *next(iter(series.values())), title=f"growth with {name}: medians")
        for size, times in series.items():
            table.add_row(size, *(f"{row['median']:.3g}" for row in times.values()))
        console.print(table)


def draw(result: dict[str, Any], file: Path) -> None:
    figure = Figure(figsize=(12, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    ways = {}
    at = result["density"][str(BAR_DENSITY)]
    for name in ("mask, warm", "mask, cold", "voxels by FFT, torch", "voxels by FFT, scipy"):
        ways[name] = at[name]
    for name in ("trimesh CollisionManager", "oracle"):
        ways[name] = result["slow ways"][name]
    medians = [row["median"] for row in ways.values()]
    spread = [
        [row["median"] - row["p10"] for row in ways.values()],
        [row["p90"] - row["median"] for row in ways.values()],
    ]
    own = ["tab:blue" if name.startswith("mask") else "tab:gray" for name in ways]
    axes[0, 0].barh(list(ways), medians, xerr=spread, color=own)
    axes[0, 0].set(xscale="log", xlabel="ms", title="a whole mask at density 0.3 (10% to 90%)")
    for name in ("BLBF", "mask, warm", "mask, cold"):
        rows = [result["density"][str(density)][name] for density in DENSITIES]
        _line(axes[0, 1], list(DENSITIES), rows, name)
    axes[0, 1].set(yscale="log", xlabel="density", ylabel="ms", title="by density")
    for axis, series, label in (
        (axes[1, 0], "items", "items placed"),
        (axes[1, 1], "triangles", "triangles an item"),
    ):
        growth = result["growth"][series]
        for name in next(iter(growth.values())):
            _line(axis, [int(n) for n in growth], [times[name] for times in growth.values()], name)
        axis.set(yscale="log", xlabel=label, ylabel="ms", title=f"by {label}")
    axes[1, 1].set_xscale("log")
    for axis in (axes[0, 1], axes[1, 0], axes[1, 1]):
        axis.legend()
        axis.grid(alpha=0.3)
    figure.savefig(file, dpi=100)


def _line(axis: Any, at: list[float], rows: list[dict[str, float]], name: str) -> None:
    axis.plot(at, [row["median"] for row in rows], marker="o", label=name)
    axis.fill_between(at, [row["p10"] for row in rows], [row["p90"] for row in rows], alpha=0.15)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pools", type=int, default=6, help="how many pools of 50 shapes")
    parser.add_argument("--seed", type=int, default=0, help="the first pool's")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for JSON and picture")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=100)
    rng = np.random.default_rng(arguments.seed)
    library = ShapeLibrary.open("everyday")
    seeds = range(arguments.seed, arguments.seed + arguments.pools)
    pools = [Pool.evolved(library, seed) for seed in seeds]
    with console.status("asking"):
        questions(pools[:1], BAR_DENSITY, rng)  # compiles, and plans the FFTs
        easy(pools[:1], rng)
        made = preparing(pools, rng)
        packed, packing = chromosomes(pools)
        rotated = easy(pools, rng)
        answers = {str(density): questions(pools, density, rng) for density in DENSITIES}
        growth = {
            "items": growth_with_items(pools[0], rng),
            "triangles": growth_with_triangles(rng),
            "tables": growth_with_tables(pools, rng),
        }
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        slow = slow_ways(pools, rng)
    result: dict[str, Any] = {
        "command": "python -m benchmarks.placement",
        "pools": arguments.pools,
        "seed": arguments.seed,
        "library": {"name": library.name, "digest": library.digest},
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
        "peak memory before the oracle, MB": peak,
        "prepare": summaries(made),
        "chromosome": summaries(packed) | {"counts": counts(packing)},
        "easy": summaries(rotated),
        "density": {
            density: summaries(times) | {"counts": counts(counted)}
            for density, (times, counted) in answers.items()
        },
        "slow ways": summaries(slow),
        "growth": {
            name: {str(size): summaries(times) for size, times in series.items()}
            for name, series in growth.items()
        },
    }
    result["bars"] = bars(result)
    show(console, result)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "placement.json").write_text(json.dumps(result, indent=1) + "\n")
    draw(result, arguments.out / "placement.png")
    console.print(f"peak memory before the oracle: {peak:.0f} MB; kept in {arguments.out}")


if __name__ == "__main__":
    main()
