"""Settling: the poses in which placed items come to rest under gravity, and their contacts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import AtPose, Contents, ItemInBox, PosedItem, triangles
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.physics.convex.decomposition import Decomposition, decompose
from packit_sim.physics.convex.fitting import FittedItems, MeasuredPiece
from packit_sim.physics.settings import DISTANCE, INSIDE, PhysicsSettings
from packit_sim.physics.world import WALLS_AND_FLOOR, World

FITTED_BUDGET = 5_000
"""Cached pieces of items that are fitted together."""


class FittedItem(AtPose, ABC):
    """Base of items whose convex pieces stay as they were fitted, whatever moves.

    Pieces that are cut anew would move items that have come to rest.
    """

    @property
    @abstractmethod
    def parts_there(self) -> Sequence[MeasuredPiece]:
        """Its convex pieces where it is."""


def moved_parts(parts: Iterable[MeasuredPiece], motion: Motion) -> tuple[MeasuredPiece, ...]:
    """Return pieces after a motion."""
    moved = ((piece.moved(motion.rotation, motion.translation), out) for piece, out in parts)
    return tuple(moved)


@dataclass(frozen=True, eq=False)
class SettledItem(FittedItem):
    """An item that gravity has moved.

    Attributes
    ----------
    start : ItemInBox
        The item where it was released.
    parts : sequence of MeasuredPiece
        Its convex pieces there, as they were fitted in between those of others.
    move : Motion
        The motion from there to where it ended, in box units.
    items : tuple of int
        Numbers of the items with which it is in contact at the end.
    walls : tuple of str
        The walls, or "floor", with which it is in contact at the end, in the order of the world.
    inside : bool
        Whether all of it is inside the box (see `INSIDE`).
    landed : PosedItem, optional
        The item the first time that everything was at rest; None before that.
    """

    start: ItemInBox
    parts: Sequence[MeasuredPiece]
    move: Motion
    items: tuple[int, ...]
    walls: tuple[str, ...]
    inside: bool
    landed: PosedItem | None = None

    @cached_property
    def posed(self) -> PosedItem:
        """Item where it ended."""
        return PosedItem(self.item, self.start.matrix).moved(self.move)

    @cached_property
    def parts_there(self) -> tuple[MeasuredPiece, ...]:
        return moved_parts(self.parts, self.move)

    @property
    def item(self) -> Item:
        """The item, in the rotation in which it was placed."""
        return self.start.item

    @property
    def displacement(self) -> float:
        """Distance by which the centre of its bounding box moved, in box units."""
        return float(np.linalg.norm(self.move.apply(self.start.center) - self.start.center))

    @cached_property
    def farthest(self) -> float:
        """Largest distance by which a point of its mesh moved, in box units."""
        return farthest(self.start.vertices, self.move.apply(self.start.vertices))

    @property
    def rotation(self) -> float:
        """Angle of the motion, in degrees."""
        return self.move.angle

    @cached_property
    def drift(self) -> float:
        """Largest distance of a point of its mesh from where it landed, in box units."""
        return np.inf if self.landed is None else farthest(self.landed.vertices, self.vertices)

    @property
    def counts(self) -> bool:
        """True if it is inside and stable: less than `DISTANCE` from where it landed."""
        return self.inside and self.drift < DISTANCE

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SettledItem):
            return NotImplemented
        return (self.posed, self.inside, self.landed) == (other.posed, other.inside, other.landed)

    def __hash__(self) -> int:
        return hash(self.posed)


@dataclass(frozen=True, eq=False)
class Settled:
    """The items of a box after they settled.

    Attributes
    ----------
    items : tuple of SettledItem
        The items, in the order of placing.
    size : ndarray of float64, shape (3,)
        Extents of the box, in box units.
    seconds : float
        Simulated time.
    at_rest : bool
        Whether all items came to rest within the time limit.
    energy : tuple of float
        Energy at the start and at the end, in J.
    """

    items: tuple[SettledItem, ...]
    size: Floats
    seconds: float
    at_rest: bool
    energy: tuple[float, float]


def settle(box: Contents[ItemInBox], settings: PhysicsSettings | None = None) -> Settled:
    """Release all items at once, and simulate them until they are at rest.

    Parameters
    ----------
    box : Contents
        The box and the items in it, which start without speed.
    settings : PhysicsSettings, optional
        The simulated world.

    Returns
    -------
    Settled
        The items afterwards; the same on one machine for the same box and settings.

    Raises
    ------
    PhysicsError
        If an item can't be decomposed into convex pieces. Shapes that were not decomposed before
        take seconds: see `decompose_all` for many.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import Box, DecompositionSettings, Item, PhysicsSettings, Shape, settle
    >>> brick = Item(Shape.from_mesh(trimesh.creation.box((4, 2, 1)), "brick"), scale=0.5)
    >>> box = Box()
    >>> _ = box.place(brick, (4, 4, 10))  # 0.4 above the floor
    >>> settings = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))
    >>> settled = settle(box, settings)
    >>> settled.at_rest, settled.items[0].walls
    (True, ('floor',))
    >>> round(settled.items[0].displacement, 2)
    0.4
    """
    settings = settings or PhysicsSettings()
    return settle_fitted(box, fitted_items(box.placed, settings), settings)


def settle_fitted(
    box: Contents[ItemInBox], known: FittedItems, settings: PhysicsSettings
) -> Settled:
    """Release all items at once, of which the pieces are fitted already (see `settle`)."""
    with World(_size(box), settings) as world:
        both = zip(known.pieces, masses(box, settings), strict=True)
        free = [world.add(pieces, mass) for pieces, mass in both]
        return _simulate(world, box, known, free, [])


def settle_each(box: Contents[ItemInBox], settings: PhysicsSettings | None = None) -> Settled:
    """Release each item alone, among fixed items that were placed before it.

    This models a box that is packed by hand. All items are simulated together, in one world in
    which each collides only with those before it.

    Parameters
    ----------
    box : Contents
        The box and the items in it, which start without speed.
    settings : PhysicsSettings, optional
        The simulated world.

    Returns
    -------
    Settled
        The items afterwards.

    Raises
    ------
    PhysicsError
        If an item can't be decomposed into convex pieces.
    """
    settings = settings or PhysicsSettings()
    known = fitted_items(box.placed, settings)
    with World(_size(box), settings) as world:
        fixed = [world.add(pieces, 0.0) for pieces in known.pieces]
        both = zip(known.pieces, masses(box, settings), strict=True)
        free = [world.add(pieces, mass) for pieces, mass in both]
        for n, one in enumerate(free):
            for other in (*free[:n], *fixed[n:]):
                world.ignore(one, other)
        return _simulate(world, box, known, free, fixed)


def _size(box: Contents[ItemInBox]) -> Floats:
    return np.array(box.cells) * CELL


def masses(box: Contents[ItemInBox], settings: PhysicsSettings) -> list[float]:
    """Compute the mass of each item, in kg."""
    found = [p.item.volume * settings.side**3 * settings.density for p in box.placed]
    least = settings.min_mass_ratio * max(found, default=0.0)
    return [max(mass, least) for mass in found]


def fitted_items(items: Sequence[ItemInBox], settings: PhysicsSettings) -> FittedItems:
    """Fit the convex pieces of items where they are, so that those of no two overlap.

    Parameters
    ----------
    settings : PhysicsSettings
        The decomposition, and whether pieces are cut.

    Returns
    -------
    FittedItems
        The pieces of each item, in box units.
    """
    whole = _whole(items, settings)
    if not items or not settings.fitted:
        return FittedItems.kept(whole, [triangles(one) for one in items])
    *before, last = items
    return _fitted(tuple(before), settings).with_one(whole, triangles(last))


def fitted_with(
    items: Sequence[FittedItem], new: ItemInBox, settings: PhysicsSettings
) -> FittedItems:
    """Fit the pieces of one more item in between those of others, which have kept theirs."""
    parts = [one.parts_there for one in items]
    known = FittedItems.kept(parts, [triangles(one.posed) for one in items])
    (whole,) = _whole([new], settings)
    if not settings.fitted:
        return FittedItems.kept([*parts, whole], [*known.surfaces, triangles(new)])
    return known.with_one([*known.divided, whole], triangles(new))


@bounded_cache(
    "fitted",
    FITTED_BUDGET,
    "pieces",
    size=lambda known: sum(map(len, known.divided)),
    key=lambda items, settings: (items, settings.decomposition),
)
def _fitted(items: tuple[ItemInBox, ...], settings: PhysicsSettings) -> FittedItems:
    """Fit the items among which one more is released: often several, one after the other."""
    return FittedItems.of(_whole(items, settings), [triangles(placed) for placed in items])


def _whole(items: Sequence[ItemInBox], settings: PhysicsSettings) -> list[list[MeasuredPiece]]:
    """Return the pieces of items where they are, before they are fitted."""
    return [_parts(one, decompose(one.item.shape, settings.decomposition)) for one in items]


def _parts(placed: ItemInBox, decomposition: Decomposition) -> list[MeasuredPiece]:
    size = float(np.cbrt(placed.item.scale))
    return [
        (piece.moved(placed.linear, placed.center), out * size)
        for piece, out in zip(decomposition.pieces, decomposition.distances, strict=True)
    ]


def _simulate(
    world: World,
    box: Contents[ItemInBox],
    fitted: FittedItems,
    free: Sequence[int],
    fixed: Sequence[int],
) -> Settled:
    """Simulate the items until they are at rest.

    free, fixed: the world's numbers of the moving items, and of the fixed ones.
    """
    energy = world.energy
    seconds, at_rest = world.run()
    moves, contacts = world.moves, world.contacts
    known = {number: n for numbers in (fixed, free) for n, number in enumerate(numbers)}
    size = _size(box)
    items = []
    for start, parts, own in zip(box.placed, fitted.measured, free, strict=True):
        met = [b if a == own else a for a, b in contacts if own in (a, b)]
        settled = SettledItem(
            start,
            parts,
            moves[own],
            tuple(sorted(known[other] for other in met if isinstance(other, int))),
            tuple(wall for wall in WALLS_AND_FLOOR if wall in met),
            is_inside(start, moves[own], size),
        )
        items.append(replace(settled, landed=settled.posed) if at_rest else settled)
    return Settled(tuple(items), size, seconds, at_rest, (energy, world.energy))


def farthest(before: Floats, after: Floats) -> float:
    """Compute the largest distance between points (n, 3) before and after."""
    return float(np.linalg.norm(after - before, axis=1).max())


def is_inside(start: ItemInBox, move: Motion, size: Floats) -> bool:
    """Decide whether an item is inside a box of extents (3,) after a motion."""
    vertices = move.apply(start.vertices)
    return bool((vertices > -INSIDE).all() and (vertices < size + INSIDE).all())
