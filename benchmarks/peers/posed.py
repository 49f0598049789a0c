"""The protocol of a peer, and its result: items in poses that need not be on the grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from packit_sim.game.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.motions import affine
from packit_sim.geometry.shapes import Item

AXIS_ORDERS: tuple[int, ...] = tuple(
    sorted(np.unique(rotations.AXES, axis=0, return_index=True)[1].tolist())
)
"""Six of the 24 rotations, the first of each order of the axes: all orientations of a cuboid."""

ALL_ROTATIONS = tuple(range(rotations.COUNT))


@dataclass(frozen=True, eq=False)
class Posed:
    """An item in its rotation, with the centre (3,) of its bounding box in box units."""

    item: Item
    centre: npt.NDArray[np.float64]

    @property
    def pose(self) -> npt.NDArray[np.float64]:
        """Matrix (4, 4) from shape to box coordinates."""
        return affine(self.item.linear, self.centre)


class Peer(Protocol):
    """A method that packs the items of a task that fit, choosing their order and rotations."""

    @property
    def name(self) -> str: ...

    def pack(self, task: Task) -> list[Posed]:
        """Pack a task; return the placed items in their order."""
        ...


def largest_first(task: Task) -> list[Item]:
    """Sort the items by decreasing volume; ties keep their order."""
    return sorted(task.items, key=lambda item: -item.volume)
