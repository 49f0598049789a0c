"""Items that the arm has put into the box, or has tried to."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from packit_sim.core.caches import cached_property
from packit_sim.geometry.items import ItemInBox, PosedItem
from packit_sim.geometry.shapes import Item
from packit_sim.physics.convex.fitting import MeasuredPiece
from packit_sim.physics.settling import FittedItem, moved_parts
from packit_sim.robot.cell import COLLAPSE_ANGLE, COLLAPSE_DISTANCE
from packit_sim.robot.recording import Recording


class Outcome(enum.StrEnum):
    """The result of an attempt to put an item into the box."""

    PLACED = "placed"
    NO_GRASP = "no grasp"
    NO_PATH = "no path"
    LOST = "lost"


@dataclass(frozen=True, eq=False)
class ExecutedItem(FittedItem):
    """An item after the attempt to put it into the box, and where it is now.

    Attributes
    ----------
    chosen : ItemInBox
        The placement that was chosen for it: in the game a location of the grid.
    planned : PosedItem
        Where the arm was to release it: the chosen placement, lowered to the item's support.
    outcome : Outcome
        What became of it.
    posed : PosedItem
        Where it is now; an item that is not in the box is at the station or next to the box.
    landed : PosedItem
        Where it was when everything had come to rest after its own attempt.
    inside : bool
        Whether it is wholly inside the box, below its rim.
    recording : Recording
        What the arm and the items did meanwhile.
    parts : tuple of MeasuredPiece
        Its convex pieces in its own frame, as they were fitted in between those of others.
    """

    chosen: ItemInBox
    planned: PosedItem
    outcome: Outcome
    posed: PosedItem
    landed: PosedItem
    inside: bool
    recording: Recording
    parts: tuple[MeasuredPiece, ...] = ()

    @property
    def item(self) -> Item:
        """The item, in the rotation of its placement."""
        return self.chosen.item

    @property
    def counts(self) -> bool:
        """True if it is inside: its volume counts."""
        return self.inside

    @cached_property
    def displacement(self) -> tuple[float, float]:
        """Distance in box units, and angle in degrees, from where it was to be released."""
        return apart(self.planned, self.landed)

    @cached_property
    def moved(self) -> tuple[float, float]:
        """Distance and angle from where it came to rest."""
        return apart(self.landed, self.posed)

    @cached_property
    def parts_there(self) -> tuple[MeasuredPiece, ...]:
        return moved_parts(self.parts, self.posed.pose)

    @property
    def collapsed(self) -> bool:
        """True if it moved far from where it came to rest."""
        return movement(self.landed, self.posed) > 1

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ExecutedItem):
            return NotImplemented
        return (self.chosen, self.outcome, self.posed) == (other.chosen, other.outcome, other.posed)

    def __hash__(self) -> int:
        return hash((self.chosen, self.posed))


def apart(one: PosedItem, other: PosedItem) -> tuple[float, float]:
    """Return the distance of two poses of an item in box units, and the angle in degrees."""
    motion = other.pose @ one.pose.inverse()
    shift = other.center - one.center
    return float((shift @ shift) ** 0.5), motion.angle


def movement(one: PosedItem, other: PosedItem) -> float:
    """Return how far an item moves between two poses, relative to a collapse: above 1 it is one."""
    shift, angle = apart(one, other)
    return max(shift / COLLAPSE_DISTANCE, angle / COLLAPSE_ANGLE)
