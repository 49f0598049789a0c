"""Densification: packs of large items, made denser by replacing items with larger ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct

from packit_sim.box import Box
from packit_sim.core.checks import check_same
from packit_sim.core.errors import PackItError
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.packs import LibraryRef, Pack, PackedItem
from packit_sim.game.datasets.provenance import Densified
from packit_sim.game.generation.holes import Holes
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary

if TYPE_CHECKING:
    from packit_sim.core.parallel import Workers

FIRST_DENSITY = 0.3
"""Density of the loose pack at the beginning, if its items fit."""

LOOSER = 0.9
"""Factor on the volume of the next item after `ATTEMPTS` failures."""

ATTEMPTS = 40
"""Shapes to try for an item of the loose pack before its volume is reduced."""

PAIRS = 0.4
"""Probability that a move replaces two neighbouring items, not one."""

NEIGHBOURS = 4
"""Number of nearest neighbours from which the second item is drawn."""

SAME_SHAPE = 0.25
"""Probability that the shape of a new item is that of an item which it replaces."""

SHARES = (0.25, 0.6)
"""Range of the least volume of a pair's first new item, relative to that of the former pair."""

SHAPES_TRIED = 4
"""Shapes to try for a new item."""

SHIFTS = 0.3
"""Probability that a single item is moved, and not replaced."""

DENSE = 0.8
"""Density that packs hardly reach: items above the floor of such a pack never block growth."""

BLOCKING, SMALLEST_FIRST = 1.2, 0.5
"""If the smallest share is below `BLOCKING` times the floor, the smallest item is chosen first with
probability `SMALLEST_FIRST`."""

EARLY = 0.5
"""Share of the rounds in which the smallest item may be below the floor."""

REPAIR = 5
"""Factor on the first tolerance while an item is below the floor in the second half."""

MORE_ROUNDS = 3
"""Factor on the rounds, after which a pack with an item below the floor is begun again."""

BEGINNINGS = 5
"""Maximum number of attempts to begin a pack."""

PRECISION = 0.01
"""Relative precision of the largest volume of an item."""


class DensificationError(PackItError):
    """A library without enough shapes for a densification, or an item that stays too small."""


class DensificationState(Struct, frozen=True):
    """The whole state of a densification, as checkpoints record it.

    Attributes
    ----------
    random : dict
        The state of the random generator.
    items : tuple of PackedItem
        The items in the box.
    densities : list of float
        The density after each round.
    beginnings : int
        The number of times that the pack was begun.
    """

    seed: int
    settings: DensificationSettings
    random: dict[str, Any]
    items: tuple[PackedItem, ...]
    densities: list[float]
    beginnings: int = 1


class Densification:
    """A pack that becomes denser, round by round.

    At first items of equal volume are packed loosely. Then each move removes an item, or two
    neighbours, and puts back the largest items of random shapes, in any rotation and at any
    location, that fit into the free space; or it moves an item. A move that loses volume is
    accepted with a probability that falls to 0 (simulated annealing). The number of items stays the
    same. In the second half of the rounds items below the floor are replaced first, at a greater
    loss of volume; there are more rounds if one is left, and if that does not help, the pack is
    begun again.

    The same library, seed and settings lead to the same pack, also if the densification is stopped
    and resumed.

    Parameters
    ----------
    library : ShapeLibrary
        The library of shapes, or one of its splits.

    Attributes
    ----------
    densities : list of float
        The density after the loose packing and after each round since.

    Raises
    ------
    DensificationError
        If the library does not have enough shapes that can be large enough.
    """

    def __init__(
        self, library: ShapeLibrary, seed: int, settings: DensificationSettings | None = None
    ) -> None:
        self.settings = settings or DensificationSettings()
        self.seed = seed
        self._library = library
        self._rng = np.random.default_rng(seed)
        self._box = Box(self.settings.cells)
        low, high = self.settings.items
        self._count = int(self._rng.integers(low, high + 1))
        self._shapes = self._draw_shapes()
        self._items: list[PlacedItem] = []
        self._beginnings = 1
        self.densities: list[float] = []

    @property
    def density(self) -> float:
        """The density of the pack."""
        return total_volume(self._items) / self._box.volume

    @property
    def is_over(self) -> bool:
        """True if all rounds are done, and no item is too small."""
        return len(self.densities) > self.settings.rounds and self._holds_floor

    @property
    def best(self) -> Pack:
        """The pack as it is now, its items from bottom to top."""
        box = Box(self.settings.cells)
        for placed in sorted(self._items, key=lambda p: (p.location[2], p.location)):
            box.place(placed.item, placed.location)
        provenance = Densified(
            seed=self.seed, rounds=len(self.densities) - 1, settings=self.settings
        )
        return Pack.of(box, LibraryRef.of(self._library), provenance)

    def step(self, workers: Workers | None = None) -> None:
        """Pack loosely at first, then do one round.

        Parameters
        ----------
        workers : Workers, optional
            Not used: each move follows from the one before.

        Raises
        ------
        DensificationError
            If an item is still too small after five beginnings, each of three times the rounds.
        """
        if len(self.densities) > max(1, MORE_ROUNDS * self.settings.rounds):
            self._begin_again()
        if not self.densities:
            self._pack_loosely()
        else:
            for move in range(self.settings.moves):
                self._move(self._tolerance(move))
        self.densities.append(self.density)

    @property
    def state(self) -> DensificationState:
        """The whole state, for `restore`."""
        return DensificationState(
            seed=self.seed,
            settings=self.settings,
            random=dict(self._rng.bit_generator.state),
            items=tuple(PackedItem.of(placed) for placed in self._items),
            densities=list(self.densities),
            beginnings=self._beginnings,
        )

    def restore(self, state: DensificationState) -> None:
        """Resume from the state of a densification of the same library.

        Raises
        ------
        ArgumentError
            If it has another seed or other settings.
        """
        check_same(seed=(state.seed, self.seed), settings=(state.settings, self.settings))
        self._rng.bit_generator.state = state.random
        self._items = []
        for record in state.items:
            assert record.location is not None
            item = Item(self._library[record.shape], record.scale, record.rotation)
            self._items.append(PlacedItem(item, record.location))
        self.densities = list(state.densities)
        self._beginnings = state.beginnings

    def _begin_again(self) -> None:
        """Empty the box, unless that was done too often."""
        if self._beginnings == BEGINNINGS:
            raise DensificationError(
                f"seed {self.seed}: the smallest item has {100 * self._smallest_share():.2f}% of "
                f"the volume, less than the floor of {100 * self.settings.floor:g}%, after "
                f"{BEGINNINGS} starts with {len(self.densities) - 1} rounds in the last: choose a "
                "lower floor, fewer items or more rounds"
            )
        self._beginnings += 1
        self._items.clear()
        self.densities.clear()

    def _draw_shapes(self) -> list[Shape]:
        """Draw the pool: different shapes that can have the smallest volume in a full box."""
        smallest, fill = self.settings.floor * self._box.volume, self.settings.fill
        shapes = [self._library[id] for id in self._library]
        holes = Holes.of(self._box)
        usable = [s for s in shapes if s.fill <= fill and holes.largest_volume(s) >= smallest]
        drawn = self._rng.permutation(len(usable))[: self.settings.pool]
        if len(drawn) * self.settings.copies < self._count:
            raise DensificationError(
                f"{self._library.path}: {len(usable)} of {len(shapes)} shapes can have "
                f"{100 * self.settings.floor:g}% of the box's volume"
                f"{'' if fill == 1 else f' and fill at most {fill:g} of their bounding boxes'}: "
                "too few for "
                f"{self._count} items with at most {self.settings.copies} of a shape"
            )
        return [usable[n] for n in drawn.tolist()]

    def _tolerance(self, move: int) -> float:
        """Compute the mean loss of volume that a move of the present round may cause."""
        settings = self.settings
        if not (self._is_early or self._holds_floor):
            return REPAIR * settings.tolerance * self._box.volume
        done = (len(self.densities) - 1) * settings.moves + move
        left = max(0.0, 1 - done / (settings.rounds * settings.moves))
        return settings.tolerance * self._box.volume * left**2

    def _pack_loosely(self) -> None:
        """Pack items of the same volume, a smaller one each time that too few of them fit."""
        volume = self._box.volume * min(FIRST_DENSITY / self._count, self.settings.largest)
        failures = 0
        while len(self._items) < self._count:
            if not self._add(self._random_shape(), volume, volume):
                failures += 1
                if failures % ATTEMPTS == 0:
                    volume *= LOOSER
                    self._items.clear()

    def _move(self, tolerance: float) -> None:
        """Move an item, or replace one or two unless too much volume is lost."""
        before = list(self._items)
        share = self._smallest_share()
        former = self._remove()
        if len(former) == 1 and self._rng.random() < SHIFTS:
            placed = self._holes().another(former[0].item, self._rng)
            self._items = before if placed is None else [*self._items, placed]
            return
        smallest = self._smallest(before, former)
        wanted = total_volume(former) + tolerance * math.log(1 - self._rng.random())
        if len(former) == 2:
            min_volume = max(smallest, wanted * self._rng.uniform(*SHARES))
            if self._replace(former, min_volume, max(min_volume, wanted - smallest)):
                wanted -= self._items[-1].item.volume
        if len(self._items) < self._count - 1 or not (
            self._replace(former, max(wanted, smallest), math.inf)
            and (self._is_early or self._holds_floor or self._smallest_share() > share)
        ):
            self._items = before

    def _remove(self) -> list[PlacedItem]:
        """Remove a random item, or two neighbours; the smallest if it has to grow."""
        first = int(self._rng.integers(self._count))
        if not (self._is_early or self._holds_floor) or (
            self._smallest_share() < BLOCKING * self.settings.floor
            and self._rng.random() < SMALLEST_FIRST
        ):
            first = int(np.argmin([placed.item.volume for placed in self._items]))
        chosen = [first]
        if self._count > 1 and self._rng.random() < PAIRS:
            centers = np.array([placed.center for placed in self._items])
            nearest = np.argsort(np.linalg.norm(centers - centers[first], axis=1), kind="stable")
            others = nearest[nearest != first][:NEIGHBOURS]
            chosen.append(int(self._rng.choice(others)))
        return [self._items.pop(n) for n in sorted(chosen, reverse=True)]

    def _smallest(self, before: list[PlacedItem], former: list[PlacedItem]) -> float:
        """Compute the minimum volume of a new item.

        It is the floor now, and that of a pack as dense as `DENSE` unless a former item is smaller:
        small items are replaced by larger ones, and not the reverse.
        """
        now = self.settings.floor * total_volume(before)
        later = self.settings.floor * DENSE * self._box.volume
        return max(now, min(later, *(placed.item.volume for placed in former)))

    def _replace(self, former: list[PlacedItem], min_volume: float, max_volume: float) -> bool:
        """Add an item of the first of some random shapes that fits."""
        return any(
            self._add(self._shape_like(former), min_volume, max_volume) for _ in range(SHAPES_TRIED)
        )

    def _add(self, shape: Shape, min_volume: float, max_volume: float) -> bool:
        """Add the largest item of a shape that fits, unless the shape is in the box too often."""
        used = sum(placed.item.shape is shape for placed in self._items)
        max_volume = min(max_volume, self.settings.largest * self._box.volume)
        if used >= self.settings.copies or min_volume > max_volume:
            return False
        placed = self._holes().largest(shape, min_volume, max_volume, self._rng, PRECISION)
        if placed is not None:
            self._items.append(placed)
        return placed is not None

    def _holes(self) -> Holes:
        """Bring the box up to date, and return its free space."""
        self._box.restore(BoxState(self._box.cells, tuple(self._items)))
        return Holes.of(self._box)

    def _random_shape(self) -> Shape:
        return self._shapes[int(self._rng.integers(len(self._shapes)))]

    def _shape_like(self, former: list[PlacedItem]) -> Shape:
        """Draw the shape of one of the former items, or any shape of the pool."""
        if self._rng.random() < SAME_SHAPE:
            return former[int(self._rng.integers(len(former)))].item.shape
        return self._random_shape()

    @property
    def _is_early(self) -> bool:
        """True while items may be too small: they start equal, and grow one after the other."""
        return len(self.densities) <= EARLY * self.settings.rounds

    @property
    def _holds_floor(self) -> bool:
        return self._smallest_share() >= self.settings.floor

    def _smallest_share(self) -> float:
        volumes = [placed.item.volume for placed in self._items]
        return min(volumes) / plain_sum(volumes)


def total_volume(items: list[PlacedItem]) -> float:
    """Compute the volume of all items."""
    return plain_sum(placed.item.volume for placed in items)
