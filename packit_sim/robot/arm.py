"""Arms: what all of them have in common, and the route on which one moves an item."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.robot.cell import Cells

CUP = 0.010
"""Height of a cup, m."""

STATION_REACH = 0.10
"""Metres around the middle of the station that an arm must reach."""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Points through which the tool passes while it moves one item, in this order.

    Each point is an array (5,): the middle of the cup's face, in m, the angle about the vertical of
    the item, and the tilt of the tool towards there, in radians. The first is above the station,
    the last of `approach` where it grips the item. `insertion` leads straight from above the box to
    where it is released.
    """

    approach: Sequence[Floats]
    lifted: Floats
    insertion: Sequence[Floats]
    retreat: Floats

    @property
    def pick(self) -> Floats:
        """Where the tool grips the item."""
        return self.approach[-1]

    @property
    def place(self) -> Floats:
        """The point at which the tool releases the item."""
        return self.insertion[-1]


@dataclass(frozen=True, eq=False)
class Route:
    """The joints of an arm after each time step while it moves one item, (n, joints) each.

    Attributes
    ----------
    start : ndarray of float64, shape (joints,)
        Where it starts.
    approach, carry, leave : ndarray of float64
        To the item, with the item to where it is released, and away from there.
    lifted : int
        Steps of `carry` after which the item is lifted.
    abandon : ndarray of float64
        From there, if the item is lost.
    """

    start: Floats
    approach: Floats
    carry: Floats
    leave: Floats
    lifted: int
    abandon: Floats

    def after_loss(self, steps: int) -> Floats:
        """Return the way after the item was lost in a step of `carry`: up, or back, and away."""
        back = self.carry[steps : self.lifted]
        if steps > self.lifted:
            back = self.carry[self.lifted : steps][::-1]
        return np.concatenate((back, self.abandon))


def tool_rotation(yaw: Floats | float, tilt: Floats | float) -> Floats:
    """Return the rotations (..., 3, 3) of a tool that is tilted, and then turned about z."""
    none = np.zeros(np.shape(tilt))
    across = np.stack((-np.sin(yaw) + none, np.cos(yaw) + none, none), axis=-1)
    axis = np.stack((np.cos(yaw) * np.sin(tilt), np.sin(yaw) * np.sin(tilt), np.cos(tilt)), axis=-1)
    return np.stack((np.cross(across, axis), across, axis), axis=-1)


class Arm(ABC):
    """An arm whose tool points straight down.

    Attributes
    ----------
    urdf : str
        The text of its URDF. Its last link is the tool: the origin is the middle of the cup's face,
        z points up.
    base : Motion
        Where its base is, in m.
    bodies : sequence of Trimesh
        The meshes of its links, in m.
    """

    urdf: str
    base: Motion
    bodies: Sequence[trimesh.Trimesh]

    @abstractmethod
    def matrices(self, joints: Floats) -> Floats:
        """Return where the bodies are, in m, and last the tool.

        Parameters
        ----------
        joints : ndarray of float64, shape (n, joints)
            Positions of the joints, in m and radians.

        Returns
        -------
        ndarray of float64, shape (n, bodies + 1, 4, 4)
            Their poses.
        """

    def poses(self, joints: Floats) -> list[Motion]:
        """Return the `matrices` of one position of the joints as motions."""
        return [Motion.from_matrix(matrix) for matrix in self.matrices(joints[None])[0]]

    @abstractmethod
    def check(self, cells: Cells, longest: float) -> None:
        """Check that the arm reaches all of the box and the station.

        Parameters
        ----------
        cells : Cells
            The cells of the box.
        longest : float
            The longest extent of an item, m: it has to pass above the rim.

        Raises
        ------
        ArgumentError
            If it does not.
        """

    @abstractmethod
    def route(self, path: ToolPath, load: trimesh.Trimesh, seed: Sequence[int]) -> Route | None:
        """Plan how to move an item.

        Parameters
        ----------
        path : ToolPath
            Where the tool passes.
        load : Trimesh
            The item at the station, in m.
        seed : sequence of int
            Seed of the planner.

        Returns
        -------
        Route or None
            The route; None if there is none, or it was not found.
        """
