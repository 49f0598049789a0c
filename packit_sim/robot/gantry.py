"""The gantry, an ideal machine of three axes and a wrist, and others of its kind from URDF."""

from __future__ import annotations

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
from packit_sim.robot.arm import CUP, STATION_REACH, TUBE, Arm, Route, ToolPath
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.motion import straight

KINDS = ("prismatic", "prismatic", "prismatic", "revolute")
"""The joints from the base to the tool of an arm that is driven: x, y, z and a wrist."""

FARTHEST = 1e3
"""Largest length in a URDF, m, and largest angle in radians."""

SMALLEST = 1e-4
"""Smallest side of a box in a URDF, m."""

MOST_BOXES = 200
"""Most boxes of the links in a URDF."""


def _link(name: str, mass: float, size: tuple[float, float, float], at: float) -> str:
    x, y, z = size
    geometry = (
        f'<origin xyz="0 0 {at}"/><geometry><box size="{x} {y} {z}"/></geometry>' if x else ""
    )
    solid = f"<visual>{geometry}</visual><collision>{geometry}</collision>" if geometry else ""
    moment = max(mass, 1.0)
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="{moment}" '
        f'iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>{solid}</link>'
    )


def _joint(name: str, kind: str, links: tuple[str, str], axis: str, low: float, high: float) -> str:
    parent, child = links
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="1000" velocity="2"/>'
        "</joint>"
    )


GANTRY = "".join(
    (
        '<robot name="gantry">',
        _link("base", 10.0, (0, 0, 0), 0),
        _joint("x", "prismatic", ("base", "bridge"), "1 0 0", -0.1, 1.0),
        _link("bridge", 5.0, (0.06, 2.4, 0.06), 1.56),
        _joint("y", "prismatic", ("bridge", "trolley"), "0 1 0", -0.1, 1.5),
        _link("trolley", 5.0, (0.10, 0.10, 0.08), 1.48),
        _joint("z", "prismatic", ("trolley", "column"), "0 0 1", 0.0, 1.0),
        _link("column", 2.0, (TUBE, TUBE, 1.5 - CUP), 0.75 + CUP / 2),
        _joint("wrist", "revolute", ("column", "tool"), "0 0 1", -6.3, 6.3),
        _link("tool", 0.2, (0, 0, 0), 0),
        "</robot>",
    )
)
"""The ideal machine: three axes and a wrist; the tool's origin is the face of the cup."""


@dataclass(frozen=True, eq=False)
class Gantry(Arm):
    """An arm that moves its tool along x, y and z, and turns it about z.

    Attributes
    ----------
    cell : RobotCell
        The cell.
    low, high : tuple of float
        The limits of its four joints, in m and radians.
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
            return cls.read(GANTRY, cell)
        path = Path(cell.arm)
        with naming(path), located(path, ArgumentError):
            return cls.read(read_whole(path), cell)

    @classmethod
    def read(cls, urdf: str | bytes, cell: RobotCell) -> Gantry:
        """Read the text of a URDF, or raise ArgumentError."""
        try:
            text = urdf.decode() if isinstance(urdf, bytes) else urdf
            parser = etree.XMLParser(resolve_entities=False, no_network=True)
            robot = etree.fromstring(text.encode(), parser)
            if robot.getroottree().docinfo.doctype:  # others that read it would follow its entities
                raise ArgumentError("the URDF has a DOCTYPE, which it does not need: leave it out")
            joints = [one for one in robot.iter("joint") if one.get("type") != "fixed"]
            found = tuple(str(one.get("type")) for one in joints)
            if not found:
                raise ArgumentError("the URDF has no joints that move: an arm needs some")
            if found != KINDS:
                raise ArgumentError(
                    f"the URDF has the joints {', '.join(found)}: this needs {', '.join(KINDS)}"
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

    def poses(self, joints: Floats) -> list[Motion]:
        """Return where the bodies are, in m, and last the tool."""
        moved = [Motion.shift(np.where(np.arange(3) <= n, joints[:3], 0.0)) for n in self.movers]
        return [*moved, Motion.shift(joints[:3])]

    def check(self, cells: Cells, longest: float) -> None:
        cell, size, station = self.cell, self.cell.size(cells), self.cell.station(cells)
        highest = float(size[2]) + 2 * cell.clearance + longest
        if highest > self.high[2]:
            raise ArgumentError(
                f"a box {size[2]:.3g} m high is higher than the reach of arm {cell.arm!r}: an item "
                f"{longest:.3g} m long passes above its rim at {highest:.3g} m, the arm goes up to "
                f"{self.high[2]:.3g} m"
            )
        for axis, name in enumerate("xy"):
            need = 0.0, max(float(size[axis]), float(station[axis]) + STATION_REACH)
            if need[0] < self.low[axis] or need[1] > self.high[axis]:
                raise ArgumentError(
                    f"arm {cell.arm!r} can't reach the box and the station: along {name} they are "
                    f"from {need[0]:.3g} to {need[1]:.3g} m, the arm moves from "
                    f"{self.low[axis]:.3g} to {self.high[axis]:.3g} m"
                )

    def route(self, path: ToolPath, load: trimesh.Trimesh, seed: Sequence[int]) -> Route:
        """Plan straight moves: its joints are those of the path."""
        up = self._timed(path.pick, path.lifted)
        return Route(
            start=path.home,
            approach=self._timed(path.home, path.over_pick, path.pick),
            carry=np.concatenate((up, self._timed(path.lifted, path.over_place, path.place))),
            leave=self._timed(path.place, path.retreat),
            lifted=len(up),
            abandon=np.empty((0, len(KINDS))),
        )

    def _timed(self, *points: Floats) -> Floats:
        return np.concatenate([straight(*ends, self.cell) for ends in pairwise(points)])


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
