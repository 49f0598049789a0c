"""What a peer is, and what it makes of a task: items in their poses, on no grid but its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from packit_sim.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.shapes import Item

AXIS_ORDERS: tuple[int, ...] = tuple(
    sorted(np.unique(rotations.AXES, axis=0, return_index=True)[1].tolist())
)
"""Six of the 24 rotations, the first of each order of the axes: all the ways a cuboid can lie."""

ALL_ROTATIONS = tuple(range(rotations.COUNT))


@dataclass(frozen=True, eq=False)
class Posed:
    """An item in its rotation. centre: (3,) of its bounding box, in box units."""

    item: Item
    centre: npt.NDArray[np.float64]

    @property
    def pose(self) -> npt.NDArray[np.float64]:
        """(4, 4) shape-to-box matrix."""
        pose = np.eye(4)
        pose[:3, :3] = self.item.linear
        pose[:3, 3] = self.centre
        return pose


class Peer(Protocol):
    """Packs what fits of a task's items, in an order and in rotations of its own choice."""

    @property
    def name(self) -> str: ...

    def pack(self, task: Task) -> list[Posed]:
        """The items that it placed, in that order."""
        ...


def largest_first(task: Task) -> list[Item]:
    """The items by volume, as they come where that ties."""
    return sorted(task.items, key=lambda item: -item.volume)
