"""The gantry, an ideal machine of three axes and a wrist, and others of its kind from URDF.

At level 2 it also tilts its tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from packit_sim.core.checks import shown
from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.files import naming, read_whole
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import IDENTITY, Motion
from packit_sim.robot.arm import CUP, STATION_REACH, Arm, Route, ToolPath, tool_rotation
from packit_sim.robot.cell import TILTED_TOOL, TUBE, Cells, RobotCell
from packit_sim.robot.motion import straight
from packit_sim.robot.presentation import JITTER
from packit_sim.robot.urdf import joint, link, tilting_tip

KINDS = ("prismatic", "prismatic", "prismatic", "revolute")
"""The joints from the base to the tool of an arm that is driven: x, y, z and a wrist."""

FARTHEST = 1e3
"""Largest length in a URDF, m, and largest angle in radians."""

SMALLEST = 1e-4
"""Smallest side of a box in a URDF, m."""

MOST_BOXES = 200
"""Most boxes of the links in a URDF."""


def _bridge(low: float) -> str:
    """Return two axes that move a trolley; along x from a coordinate on."""
    return (
        '<robot name="gantry">'
        + link("base", 10.0, (0, 0, 0), 0)
        + joint("x", "prismatic", ("base", "bridge"), "1 0 0", low, 1.0)
        + link("bridge", 5.0, (0.06, 2.4, 0.06), 1.56)
        + joint("y", "prismatic", ("bridge", "trolley"), "0 1 0", -0.1, 1.5)
        + link("trolley", 5.0, (0.10, 0.10, 0.08), 1.48)
    )


GANTRY = "".join(
    (
        _bridge(-0.1),
        joint("z", "prismatic", ("trolley", "column"), "0 0 1", 0.0, 1.0),
        link("column", 2.0, (TUBE, TUBE, 1.5 - CUP), 0.75 + CUP / 2),
        joint("wrist", "revolute", ("column", "tool"), "0 0 1", -6.3, 6.3),
        link("tool", 0.2, (0, 0, 0), 0),
        "</robot>",
    )
)
"""The ideal machine: three axes and a wrist; the tool's origin is the face of the cup."""

TILTING_GANTRY = "".join(
    (
        _bridge(-0.5),
        joint("z", "prismatic", ("trolley", "column"), "0 0 1", -0.15, 1.2),
        link("column", 2.0, (TUBE, TUBE, 1.5 - TILTED_TOOL), 0.75 + TILTED_TOOL / 2),
        joint("wrist", "revolute", ("column", "head"), "0 0 1", -6.3, 6.3),
        link("head", 0.2, (0, 0, 0), 0),
        tilting_tip(0.0),
        "</robot>",
    )
)
"""The machine of level 2: below the wrist, an axis tilts the tool."""


@dataclass(frozen=True, eq=False)
class Gantry(Arm):
    """An arm that moves its tool along x, y and z, and turns it about z; ours of level 2 tilts it.

    Attributes
    ----------
    cell : RobotCell
        The cell.
    low, high : tuple of float
        The limits of its joints, in m and radians.
    movers : tuple of int
        The number of the last joint that moves each body.
    """

    cell: RobotCell
    urdf: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    bodies: tuple[trimesh.Trimesh, ...]
    movers: tuple[int, ...]
    base: Motion = IDENTITY

    @classmethod
    def of(cls, cell: RobotCell) -> Gantry:
        """Read the arm of a cell.

        Parameters
        ----------
        cell : RobotCell
            The cell, with the name of our own or the path of a URDF.

        Returns
        -------
        Gantry
            The arm.

        Raises
        ------
        ArgumentError
            If there is no such file, or its URDF has no joints, or other ones.
        """
        if cell.arm == "gantry":
            return cls.read(GANTRY if cell.level == 1 else TILTING_GANTRY, cell)
        path = Path(cell.arm)
        with naming(path), located(path, ArgumentError):
            return cls.read(read_whole(path), cell)

    @classmethod
    def read(cls, urdf: str | bytes, cell: RobotCell) -> Gantry:
        """Read the text of a URDF, or raise ArgumentError."""
        try:
            text = urdf.decode("utf-8-sig") if isinstance(urdf, bytes) else urdf
            parser = etree.XMLParser(resolve_entities=False, no_network=True)
            robot = etree.fromstring(text.encode(), parser)
            if robot.getroottree().docinfo.doctype:  # others that read it would follow its entities
                raise ArgumentError("the URDF has a DOCTYPE, which it does not need: leave it out")
            joints = [one for one in robot.iter("joint") if one.get("type") != "fixed"]
            found = tuple(str(one.get("type")) for one in joints)
            if not found:
                raise ArgumentError("the URDF has no joints that move: an arm needs some")
            kinds = KINDS if cell.level == 1 else (*KINDS, "revolute")
            if found != kinds:
                raise ArgumentError(
                    f"the URDF has the joints {', '.join(found)}: this needs {', '.join(kinds)}"
                )
            limits = [one.find("limit").attrib for one in joints]
            low, high = (
                tuple(_numbers(one[end], 1, -FARTHEST)[0] for one in limits)
                for end in ("lower", "upper")
            )
            children = [str(one.find("child").get("link")) for one in joints]
            if absent := set(children) - {one.get("name") for one in robot.iter("link")}:
                raise ArgumentError(f"the URDF has no link {shown(min(absent))}")
            if len(list(robot.iter("collision"))) > MOST_BOXES:
                raise ArgumentError(f"the URDF has more than {MOST_BOXES} shapes of links")
            boxes = [box for link in robot.iter("link") for box in _boxes(link, children)]
        except (etree.XMLSyntaxError, AttributeError, KeyError, ValueError) as error:
            if isinstance(error, ArgumentError):
                raise
            raise ArgumentError(f"the URDF can't be read: {error}") from None
        bodies, movers = tuple(body for _, body in boxes), tuple(mover for mover, _ in boxes)
        return cls(cell, text, low, high, bodies, movers)

    def matrices(self, joints: Floats) -> Floats:
        found = np.tile(np.eye(4), (len(joints), len(self.movers) + 1, 1, 1))
        for body, mover in enumerate((*self.movers, 2)):
            axes = slice(min(mover, 2) + 1)
            found[:, body, axes, 3] = joints[:, axes]
        if self.cell.level == 2:
            turns = tool_rotation(joints[:, 3], joints[:, 4])
            head = self.movers.index(len(KINDS))
            found[:, [head, -1], :3, :3] = turns[:, None]
            found[:, [head, -1], 2, 3] += TILTED_TOOL
            found[:, -1, :3, 3] -= TILTED_TOOL * turns[:, :, 2]
        return found

    def check(self, cells: Cells, longest: float) -> None:
        cell, size, station = self.cell, self.cell.size(cells), self.cell.station(cells)
        around, low = STATION_REACH, np.zeros(2)
        if cell.level == 2:  # it comes from all sides, and turns items about the cup
            longest *= math.sqrt(3)
            around = JITTER + longest + cell.clearance + TILTED_TOOL
            low = np.minimum(station[:2] - around, 0.0)
        highest = float(size[2]) + 2 * cell.clearance + longest
        if highest > self.high[2]:
            raise ArgumentError(
                f"a box {size[2]:.3g} m high is higher than the reach of arm {cell.arm!r}: an item "
                f"{longest:.3g} m long passes above its rim at {highest:.3g} m, the arm goes up to "
                f"{self.high[2]:.3g} m"
            )
        for axis, name in enumerate("xy"):
            need = float(low[axis]), max(float(size[axis]), float(station[axis]) + around)
            if need[0] < self.low[axis] or need[1] > self.high[axis]:
                raise ArgumentError(
                    f"arm {cell.arm!r} can't reach the box and the station: along {name} they are "
                    f"from {need[0]:.3g} to {need[1]:.3g} m, the arm moves from "
                    f"{self.low[axis]:.3g} to {self.high[axis]:.3g} m"
                )

    def route(self, path: ToolPath, load: trimesh.Trimesh, seed: Sequence[int]) -> Route:
        """Plan straight moves of its joints between those of the path."""
        up = self._timed(path.pick, path.lifted)
        return Route(
            start=self._joints(path.approach[0]),
            approach=self._timed(*path.approach),
            carry=np.concatenate((up, self._timed(path.lifted, *path.insertion))),
            leave=self._timed(path.place, path.retreat),
            lifted=len(up),
            abandon=np.empty((0, self.cell.joints)),
        )

    def _timed(self, *points: Floats) -> Floats:
        ends = pairwise(map(self._joints, points))
        return np.concatenate([straight(*both, self.cell) for both in ends])

    def _joints(self, point: Floats) -> Floats:
        """Return the joints with which the tool is at a point of a path."""
        if self.cell.level == 1:
            return point[: len(KINDS)]
        axis = tool_rotation(*point[3:].tolist())[:, 2]
        return np.append(point[:3] + TILTED_TOOL * (axis - np.array((0.0, 0.0, 1.0))), point[3:])


def _boxes(link: Any, children: list[str]) -> list[tuple[int, trimesh.Trimesh]]:
    """Return the collision boxes of a link that moves, and its joint for each."""
    if link.get("name") not in children:
        return []
    joint, found = children.index(str(link.get("name"))), []
    for collision in link.iter("collision"):
        box, origin = collision.find("geometry/box"), collision.find("origin")
        if box is None:
            raise ArgumentError(f"link {link.get('name')!r} has a shape that is no box")
        body = trimesh.creation.box(_numbers(str(box.get("size")), 3, SMALLEST))
        shift = "0 0 0" if origin is None else str(origin.get("xyz"))
        body.apply_translation(_numbers(shift, 3, -FARTHEST))
        found.append((joint, body))
    return found


def _numbers(text: str, count: int, low: float) -> list[float]:
    """Read numbers from a lowest one to `FARTHEST`, or raise ValueError."""
    found = [float(one) for one in text.split()]
    if len(found) != count or not all(low <= one <= FARTHEST for one in found):
        raise ValueError(f"{shown(text)} is not {count} of numbers from {low:g} to {FARTHEST:g}")
    return found
