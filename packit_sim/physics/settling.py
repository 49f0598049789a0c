"""What becomes of placed items when they are let go: where they come to rest, and in what touch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.engine.occupancy import ItemInBox, Load
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.poses import Pose
from packit_sim.physics.convex.decomposition import Decomposition, decompose
from packit_sim.physics.convex.fitting import Part, fitted
from packit_sim.physics.convex.pieces import Floats, Piece
from packit_sim.physics.settings import INSIDE, PhysicsSettings
from packit_sim.physics.world import WALLS, World

_LOOK = 10
"""Steps of time from one look at the speeds to the next."""


@dataclass(frozen=True, eq=False)
class SettledItem:
    """What became of a placed item.

    move: (4, 4), from where it was packed to where it ended, in box units. displacement: how far
    its bounding box's centre moved, and farthest: how far the point of its mesh that moved most, in
    box units. rotation: degrees. items: numbers of those that it presses on or that press on it at
    the end, and walls: which of `WALLS`. inside: whether all of it is in the box (see `INSIDE`).
    """

    placed: ItemInBox
    move: Floats
    displacement: float
    farthest: float
    rotation: float
    items: tuple[int, ...]
    walls: tuple[str, ...]
    inside: bool

    @property
    def vertices(self) -> Floats:
        """(n, 3) of its mesh, where it ended, in box units."""
        return _moved(self.placed, self.move)

    @property
    def pose(self) -> Pose:
        """Where a picture shows it."""
        return Pose.from_matrix(self.move @ self.placed.pose, np.cbrt(self.placed.item.scale))


@dataclass(frozen=True, eq=False)
class Settled:
    """What became of a box's items.

    items: in the order of placing. size: (3,) of the box. seconds: that it took them, and
    at_rest: whether they came to rest before the time ran out. energy: in J, at the start and at
    the end. cut: the share of the pieces' volume that was cut away at the start (see `fitting`).
    """

    items: tuple[SettledItem, ...]
    size: Floats
    seconds: float
    at_rest: bool
    energy: tuple[float, float]
    cut: float


def settle(box: Load, settings: PhysicsSettings | None = None) -> Settled:
    """Lets go of all that is placed, at once, until it is at rest or the time is over.

    Items start where they were packed, without speed. The same box and settings give the same
    answer on one machine. Shapes that are new are decomposed first: see `decompose_all` for many.
    """
    settings = settings or PhysicsSettings()
    items, cut = _pieces(box.placed, settings)
    with World(_size(box), settings) as world:
        free = [world.add(*both) for both in zip(items, _masses(box, settings), strict=True)]
        return _simulated(world, box, settings, cut, free, [])


def settle_each(box: Load, settings: PhysicsSettings | None = None) -> Settled:
    """Lets go of each item by itself, where it was packed, on those placed before it.

    Those are held where they were packed, and what comes later is not there yet: it is what the
    hand sees that packs the box and lets go. All is simulated at once, in one world in which only
    an item and those before it meet. Else as `settle`.
    """
    settings = settings or PhysicsSettings()
    items, cut = _pieces(box.placed, settings)
    with World(_size(box), settings) as world:
        held = [world.add(pieces, 0.0) for pieces in items]
        free = [world.add(*both) for both in zip(items, _masses(box, settings), strict=True)]
        for n, one in enumerate(free):
            for other in (*free[:n], *held[n:]):
                world.ignore(one, other)
        return _simulated(world, box, settings, cut, free, held)


def _size(box: Load) -> Floats:
    return np.array(box.cells) * CELL


def _masses(box: Load, settings: PhysicsSettings) -> list[float]:
    """In kg."""
    masses = [p.item.volume * settings.side**3 * settings.density for p in box.placed]
    least = settings.lightest * max(masses, default=0.0)
    return [max(mass, least) for mass in masses]


def _pieces(
    items: Sequence[ItemInBox], settings: PhysicsSettings
) -> tuple[list[list[Piece]], float]:
    """The pieces of items in their places, and the share of their volume that was cut away."""
    whole = [
        _parts(placed, decompose(placed.item.shape, settings.decomposition)) for placed in items
    ]
    if not settings.fitted:
        return [[piece for piece, _ in parts] for parts in whole], 0.0
    pieces = fitted(whole, [p.vertices[p.item.mesh.faces] for p in items])
    before = sum(piece.volume for parts in whole for piece, _ in parts)
    after = sum(piece.volume for own in pieces for piece in own)
    return pieces, 1 - after / before if items else 0.0


def _parts(placed: ItemInBox, decomposition: Decomposition) -> list[Part]:
    size = float(np.cbrt(placed.item.scale))
    return [
        (piece.moved(placed.pose[:3, :3], placed.pose[:3, 3]), out * size)
        for piece, out in zip(decomposition.pieces, decomposition.overhangs, strict=True)
    ]


def _simulated(
    world: World,
    box: Load,
    settings: PhysicsSettings,
    cut: float,
    free: Sequence[int],
    held: Sequence[int],
) -> Settled:
    """Lets time go by.

    free, held: the world's numbers of the items as they move, and as they are held for others.
    """
    energy, calm, seconds = world.energy, 0.0, 0.0
    look = _LOOK * settings.step
    while calm < settings.calm and seconds < settings.limit:
        for _ in range(_LOOK):
            world.step()
        seconds += look
        calm = calm + look if (world.speeds < settings.rest).all() else 0.0
    moves, contacts = world.moves, world.contacts
    known = {number: n for numbers in (held, free) for n, number in enumerate(numbers)}
    items = []
    for placed, own in zip(box.placed, free, strict=True):
        met = [b if a == own else a for a, b in contacts if own in (a, b)]
        items.append(
            _settled(
                placed,
                moves[own],
                tuple(sorted(known[other] for other in met if isinstance(other, int))),
                tuple(wall for wall in WALLS if wall in met),
                _size(box),
            )
        )
    at_rest = calm >= settings.calm
    return Settled(tuple(items), _size(box), seconds, at_rest, (energy, world.energy), cut)


def _settled(
    placed: ItemInBox, move: Floats, items: tuple[int, ...], walls: tuple[str, ...], size: Floats
) -> SettledItem:
    before, after = _moved(placed, np.eye(4)), _moved(placed, move)
    center = move[:3, :3] @ placed.center + move[:3, 3]
    return SettledItem(
        placed,
        move,
        float(np.linalg.norm(center - placed.center)),
        float(np.linalg.norm(after - before, axis=1).max()),
        math.degrees(math.acos(min(1.0, max(-1.0, (np.trace(move[:3, :3]) - 1) / 2)))),
        items,
        walls,
        bool((after > -INSIDE).all() and (after < size + INSIDE).all()),
    )


def _moved(placed: ItemInBox, move: Floats) -> Floats:
    """(n, 3) vertices of an item's mesh, moved from its place, in box units."""
    return placed.vertices @ move[:3, :3].T + move[:3, 3]
