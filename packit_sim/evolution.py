"""The Pack Creator and the evolution around it (paper, section 3).

A chromosome says in which order a pool's shapes are tried, at which scales and in which rotations;
the Pack Creator puts each at its bottom-left-back-fill location, or leaves it outside where there
is none. Evolution searches for the chromosome of the densest pack.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from packit_sim import rotations
from packit_sim.box import Box
from packit_sim.lattice import BOX_CELLS, Triple, box_cells
from packit_sim.library import ShapeLibrary
from packit_sim.packs import LibraryRef, Pack
from packit_sim.shapes import Item, Shape

SCALES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""The ratios of volumes at which shapes are packed."""


@dataclass(frozen=True)
class EvolutionSettings:
    """The paper's numbers; the two mutation rates are ours, it doesn't give its own.

    pool: shapes drawn, by uniform category, then uniform shape.
    population: chromosomes a generation; the best `elite` survive, `lucky` of the others by chance,
        and children fill the rest.
    generations: at most.
    patience: stop after so many generations without improvement.
    keep_every: the best pack so far is kept at generation 0 and every so many.
    scales: ratios of volumes to choose from.
    size_range: one linear factor on all of a pack's items is drawn from it.
    swap_rate: chance that a child has two places of its order exchanged.
    point_rate: chance for each scale and each rotation of a child to be drawn anew.
    cells: of the box, an axis.
    """

    pool: int = 50
    population: int = 100
    elite: int = 25
    lucky: int = 25
    generations: int = 1000
    patience: int = 100
    keep_every: int = 50
    scales: tuple[float, ...] = SCALES
    size_range: tuple[float, float] = (0.75, 1.0)
    swap_rate: float = 0.5
    point_rate: float = 0.02
    cells: Triple = BOX_CELLS

    def __post_init__(self) -> None:
        """Raises ValueError that names the setting that is out of range."""
        checks = {
            "pool": self.pool >= 1,
            "population": self.population > self.survivors,
            "elite": self.elite >= 1,
            "lucky": self.lucky >= 0,
            "generations": self.generations >= 0,
            "patience": self.patience >= 1,
            "keep_every": self.keep_every >= 1,
            "scales": len(self.scales) > 0 and all(s > 0 for s in self.scales),
            "size_range": 0 < self.size_range[0] <= self.size_range[1],
            "swap_rate": 0 <= self.swap_rate <= 1,
            "point_rate": 0 <= self.point_rate <= 1,
        }
        for name, holds in checks.items():
            if not holds:
                raise ValueError(
                    f"evolution setting {name} = {getattr(self, name)!r} is not possible"
                )
        box_cells(self.cells)

    @property
    def survivors(self) -> int:
        return self.elite + self.lucky


@dataclass(frozen=True, eq=False)
class Chromosome:
    """How to pack a pool of n shapes.

    order: (n,) a permutation of the pool. scales: (n,) indices into the settings' scales, and
    rotations: (n,) 0 to 23, both by shape of the pool, not by order.
    """

    order: npt.NDArray[np.int64]
    scales: npt.NDArray[np.int64]
    rotations: npt.NDArray[np.int64]

    @classmethod
    def random(cls, settings: EvolutionSettings, rng: np.random.Generator) -> Chromosome:
        return cls(
            rng.permutation(settings.pool),
            rng.integers(len(settings.scales), size=settings.pool),
            rng.integers(rotations.COUNT, size=settings.pool),
        )


@dataclass(frozen=True)
class Generation:
    """Where evolution stands: its number, the best and the mean density, and the best pack."""

    number: int
    best: float
    mean: float
    pack: Pack


@dataclass(frozen=True)
class Evolution:
    """What came of it: the best pack, the best ones kept on the way, best density by generation."""

    best: Pack
    kept: tuple[Pack, ...]
    densities: tuple[float, ...]


def draw_pool(library: ShapeLibrary, count: int, rng: np.random.Generator) -> tuple[Shape, ...]:
    """Shapes of a uniform category, then a uniform shape of it; one may come more than once."""
    categories = list(library.categories.values())
    drawn = []
    for _ in range(count):
        ids = categories[rng.integers(len(categories))]
        drawn.append(library[ids[rng.integers(len(ids))]])
    return tuple(drawn)


class PackCreator:
    """Packs a pool of shapes as a chromosome says (paper, section 3.1).

    pool: the shapes. scales: to choose from, the pack's size factor included. box: reused.
    """

    def __init__(self, pool: Sequence[Shape], scales: Sequence[float], cells: Triple) -> None:
        self.pool = pool
        self.scales = scales
        self.box = Box(cells)
        self._item = cache(lambda n, scale, rotation: Item(pool[n], scales[scale], rotation))

    def pack(self, chromosome: Chromosome) -> Box:
        """The box with every item that has a feasible location when its turn comes."""
        self.box.clear()
        for n in chromosome.order:
            item = self._item(n, chromosome.scales[n], chromosome.rotations[n])
            location = self.box.blbf(item)
            if location is not None:
                self.box.place(item, location)
        return self.box


def evolve(
    library: ShapeLibrary,
    seed: int,
    settings: EvolutionSettings | None = None,
    on_generation: Callable[[Generation], None] = lambda generation: None,
) -> Evolution:
    """Evolves a pack; the same seed, settings and library give the same one.

    on_generation is called after each generation, the first of which is number 0.
    """
    settings = settings or EvolutionSettings()
    rng = np.random.default_rng(seed)
    pool = draw_pool(library, settings.pool, rng)
    size = float(rng.uniform(*settings.size_range))
    creator = PackCreator(pool, [s * size**3 for s in settings.scales], settings.cells)

    def record(best: Chromosome, number: int) -> Pack:
        return Pack.of(
            creator.pack(best),
            LibraryRef.of(library),
            by="evolution",
            seed=seed,
            generation=number,
            size=size,
            settings=asdict(settings),
        )

    population = [Chromosome.random(settings, rng) for _ in range(settings.population)]
    densities = [creator.pack(chromosome).density for chromosome in population]
    history: list[float] = []
    kept: list[Pack] = []
    best_pack: Pack | None = None
    stale = 0
    for number in range(settings.generations + 1):
        if number:
            survivors = select(densities, settings, rng)
            population = [population[n] for n in survivors]
            densities = [densities[n] for n in survivors]
            for _ in range(settings.population - settings.survivors):
                a, b = rng.choice(settings.survivors, size=2, replace=settings.survivors < 2)
                child = mutate(crossover(population[a], population[b], rng), settings, rng)
                population.append(child)
                densities.append(creator.pack(child).density)
        champion = int(np.argmax(densities))
        stale += 1
        if best_pack is None or densities[champion] > history[-1]:
            best_pack = record(population[champion], number)
            stale = 0
        history.append(densities[champion])
        if number % settings.keep_every == 0:
            kept.append(best_pack)
        on_generation(Generation(number, densities[champion], float(np.mean(densities)), best_pack))
        if stale >= settings.patience:
            break
    assert best_pack is not None
    return Evolution(best_pack, tuple(kept), tuple(history))


def select(
    densities: Sequence[float], settings: EvolutionSettings, rng: np.random.Generator
) -> list[int]:
    """Who survives: the best `elite`, the best first, and `lucky` of the others by chance."""
    ranked = np.argsort(-np.asarray(densities), kind="stable")
    lucky = rng.choice(ranked[settings.elite :], size=settings.lucky, replace=False)
    return [*ranked[: settings.elite].tolist(), *lucky.tolist()]


def crossover(a: Chromosome, b: Chromosome, rng: np.random.Generator) -> Chromosome:
    """A child: order crossover on the order, single-point crossover on scales and rotations."""
    n = len(a.order)
    start, stop = sorted(rng.integers(n + 1, size=2).tolist())
    scale_point, rotation_point = rng.integers(n + 1, size=2).tolist()
    return Chromosome(
        order_crossover(a.order, b.order, start, stop),
        np.concatenate([a.scales[:scale_point], b.scales[scale_point:]]),
        np.concatenate([a.rotations[:rotation_point], b.rotations[rotation_point:]]),
    )


def order_crossover(
    a: npt.NDArray[np.int64], b: npt.NDArray[np.int64], start: int, stop: int
) -> npt.NDArray[np.int64]:
    """Davis' order crossover: a's part [start, stop) in its place, around it the rest in b's order.

    The rest is filled in from `stop` on, cyclically, in the order in which b has it from `stop` on.
    """
    n = len(a)
    rest = np.roll(b, -stop)
    rest = rest[~np.isin(rest, a[start:stop])]
    child = np.empty_like(a)
    child[start:stop] = a[start:stop]
    child[np.arange(stop, stop + n - (stop - start)) % n] = rest
    return child


def mutate(
    chromosome: Chromosome, settings: EvolutionSettings, rng: np.random.Generator
) -> Chromosome:
    """Ordered mutation (two places of the order exchanged) and point mutation of the rest."""
    n = len(chromosome.order)
    order = chromosome.order.copy()
    if rng.random() < settings.swap_rate:
        places = rng.integers(n, size=2)
        order[places] = order[places[::-1]]
    fresh = Chromosome.random(settings, rng)
    new_scale, new_rotation = rng.random((2, n)) < settings.point_rate
    return Chromosome(
        order,
        np.where(new_scale, fresh.scales, chromosome.scales),
        np.where(new_rotation, fresh.rotations, chromosome.rotations),
    )
