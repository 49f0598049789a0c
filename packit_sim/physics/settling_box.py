"""A box in which gravity has its way: after each item that is placed, all come to rest.

Items are brought on the grid, where they are feasible among those that lie there, and let go. They
end anywhere, in any turn. Each time a new world is made of where they lie, without speed: so what
comes next follows from the state alone, and a snapshot is all that it takes to go back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import ArgumentError, InfeasibleError
from packit_sim.engine import bodies
from packit_sim.engine.base_box import BaseBox
from packit_sim.engine.bodies import Bodies, PosedItem
from packit_sim.engine.feasibility import ORIGIN, Mask, checked_location
from packit_sim.engine.occupancy import PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.physics.convex.pieces import Floats
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import Settled, SettledItem, settle
from packit_sim.physics.stability import DISTANCE


@dataclass(frozen=True, eq=False)
class Lying(PosedItem):
    """A body in a box that settles.

    inside: whether all of it is in the box (see `settling.INSIDE`). landed: its pose the first time
    that all was at rest, None before that.
    """

    inside: bool = True
    landed: Floats | None = None

    @cached_property
    def drift(self) -> float:
        """How far the point of its mesh is that is farthest from where it landed, in box units."""
        if self.landed is None:
            return np.inf
        before = PosedItem(self.item, self.landed).vertices
        return float(np.linalg.norm(self.vertices - before, axis=1).max())

    @property
    def counts(self) -> bool:
        """Whether it is inside and stable: it landed, and is less than 0.05 from there."""
        return self.inside and self.drift < DISTANCE


@dataclass(frozen=True)
class SettlingBoxState:
    """The whole state of a box that settles: its cells an axis, and what lies where. A value."""

    cells: Triple
    placed: tuple[Lying, ...]


class SettlingBox(BaseBox):
    """A box whose items come to rest after each that is placed.

    cells: as of `Box`. settings: of the world; a box unit is half a metre in the usual one.
    Raises ValueError where the cells are not possible.
    """

    _occupancy: Bodies

    def __init__(
        self, cells: Sequence[int] = BOX_CELLS, settings: PhysicsSettings | None = None
    ) -> None:
        super().__init__(cells)
        self.settings = settings or PhysicsSettings()
        self._placed: tuple[Lying, ...] = ()

    @property
    def placed(self) -> tuple[Lying, ...]:
        """What was placed, in that order, as it lies, also what is not in the box any more."""
        return self._placed

    @property
    def counted(self) -> float:
        """Volume of what is inside and stable (see `Lying.counts`), in box units cubed."""
        return sum(lying.item.volume for lying in self._placed if lying.counts)

    @property
    def density(self) -> float:
        """Volume of what is inside and stable over the box's."""
        return self.counted / float(self.size.prod())

    def feasible(self, item: Item) -> Mask:
        return bodies.feasible(self._occupancy, item)

    def blbf(self, item: Item, start: Triple = ORIGIN) -> Triple | None:
        return bodies.blbf(self._occupancy, item, start)

    def place(self, item: Item, location: Sequence[int]) -> Settled:
        """Lets go of an item, and returns what became of all.

        Raises InfeasibleError, and changes nothing, where it is not feasible; PhysicsError where
        its pieces can't be made (see `decomposition.decompose`).
        """
        candidate = PlacedItem(item, checked_location(self.cells, location))
        if not self._can_stand(candidate):
            raise InfeasibleError(
                f"{item.shape.id!r} (scale {item.scale:g}, rotation {item.rotation}) at "
                f"{candidate.location} is not inside the box, or in conflict with what lies there"
            )
        let_go = SettlingBoxState(self.cells, (*self._placed, Lying(item, candidate.pose)))
        settled = settle(let_go, self.settings)
        self._fill(
            tuple(
                _lying(before, after, settled.at_rest)
                for before, after in zip(let_go.placed, settled.items, strict=True)
            )
        )
        return settled

    def put(self, item: Item, location: Sequence[int]) -> float:
        before = self.counted
        self.place(item, location)
        return self.counted - before

    def snapshot(self) -> SettlingBoxState:
        return SettlingBoxState(self.cells, self._placed)

    def restore(self, snapshot: SettlingBoxState) -> None:
        if snapshot.cells != self.cells:
            raise ArgumentError(
                f"a snapshot of a box of {snapshot.cells} cells can't be restored "
                f"in one of {self.cells}"
            )
        if snapshot.placed is not self._placed:
            self._fill(snapshot.placed)

    def _can_stand(self, candidate: PlacedItem) -> bool:
        return bodies.is_feasible(self._occupancy, candidate)

    def _fill(self, placed: tuple[Lying, ...]) -> None:
        self._occupancy = bodies.filled(self.cells, placed)
        self._placed = placed


def _lying(before: Lying, after: SettledItem, at_rest: bool) -> Lying:
    """What became of a body."""
    pose = after.move @ before.pose
    landed = before.landed
    if landed is None and at_rest:
        landed = pose
    return Lying(before.item, pose, after.inside, landed)
