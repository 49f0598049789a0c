"""The rules of the game: which variant of PackIt is played."""

from __future__ import annotations

from dataclasses import dataclass

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.lattice import Triple, box_cells
from packit_sim.physics.settings import PhysicsSettings


@dataclass(frozen=True)
class Rules:
    """How an episode is played.

    Parameters
    ----------
    easy : bool
        Whether a location is chosen before a rotation, as in PackIt-Easy.
    kinematic : bool
        Whether an item must come straight down from the open top to its location.
    physics : PhysicsSettings, optional
        The world in which all items settle after each placement; None keeps items on the grid.
    cells : tuple of int, optional
        Cells of the box along x, y and z; None takes those of the task.

    Raises
    ------
    ValueError
        If the cells are not possible, or both `kinematic` and `physics` are asked for.
    """

    easy: bool = False
    kinematic: bool = False
    physics: PhysicsSettings | None = None
    cells: Triple | None = None

    def __post_init__(self) -> None:
        if self.kinematic and self.physics is not None:
            raise ArgumentError("a box is either kinematic or has physics, not both")
        if self.cells is not None:
            object.__setattr__(self, "cells", box_cells(self.cells))


PACKIT = Rules()
"""The rules of the paper."""
