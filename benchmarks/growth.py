"""How the cost of queries grows with items, with triangles and with the memory for tables."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from trimesh import creation

from benchmarks.common import PAIR_CACHES, Times, milliseconds
from benchmarks.pools import DENSITY, Pool, prepare, random_item, time_queries
from packit_sim import Box, Item, Shape
from packit_sim.core import caches
from packit_sim.placement import MEETINGS_BEFORE_TABLE


def growth_with_items(pool: Pool, rng: np.random.Generator) -> dict[int, Times]:
    """Time queries in a box that is filled with 5 to 50 small items."""
    box = Box()
    series: dict[int, Times] = {}
    while len(box.placed) < 50:
        if box.fill(random_item(pool.shapes, rng, 0.25, 0.4)) is None:
            continue
        if len(box.placed) % 5 == 0:
            times = series[len(box.placed)] = defaultdict(list)
            for shape in pool.shapes[:20]:
                item = Item(shape, rng.uniform(0.3, 0.5) ** 3, int(rng.integers(24)))
                time_queries(box, item, times)
    return series


def growth_with_triangles(rng: np.random.Generator) -> dict[int, Times]:
    """Time queries with bumpy rings of 500 to 50,000 triangles each."""
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
                item = random_item(shapes, rng)
                if box.density < DENSITY:
                    box.fill(item)
            for _ in range(6):
                item = random_item(shapes, rng)
                caches.clear("voxels", "turned voxels", "collision meshes")
                times["prepare, first"].append(milliseconds(prepare, item))
                for placed in box.placed:
                    prepare(placed.item)
                time_queries(box, item, times)
    return series


def growth_with_tables(pools: list[Pool], rng: np.random.Generator) -> dict[int, Times]:
    """Time masks of the same items repeatedly, by the memory for no-fit tables in kilobytes."""
    series: dict[int, Times] = {}
    boxes = [(pool.packed(DENSITY), list(pool.items(6, rng))) for pool in pools]
    budget = caches.usage()["no-fit tables"].budget
    for kilobytes in (1, 64, 256, 1024, 4096, 16384):
        caches.clear(*PAIR_CACHES)
        caches.limit("no-fit tables", kilobytes * 1024)
        times = series[kilobytes] = defaultdict(list)
        for repetition in range(MEETINGS_BEFORE_TABLE + 4):
            for box, items in boxes:
                for item in items:
                    spent = milliseconds(box.feasible, item)
                    if repetition > MEETINGS_BEFORE_TABLE + 1:
                        times["mask"].append(spent)
        times["tables kept, kB"].append(caches.usage()["no-fit tables"].size / 1024)
    caches.limit("no-fit tables", int(budget))
    return series
