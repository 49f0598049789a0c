"""Arms as URDF: links, joints and limits, and where an arm can reach."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.files import naming
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import Triple
from packit_sim.robot.cell import RobotCell

TUBE = 0.005
"""Side of the square tube that carries a cup, m: its corners are inside the smallest cup."""

CUP = 0.010
"""Height of a cup, m."""

KINDS = ("prismatic", "prismatic", "prismatic", "revolute")
"""The joints from the base to the tool of an arm that is driven: x, y, z and a wrist."""


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


@dataclass(frozen=True)
class LinkBox:
    """A box of a link, m.

    Attributes
    ----------
    joint : int
        The number of the last joint that moves the link.
    size, center : tuple of float
        Extents, and the middle in the link's frame.
    """

    joint: int
    size: tuple[float, float, float]
    center: tuple[float, float, float]


@dataclass(frozen=True)
class Arm:
    """An arm that moves its tool along x, y and z, and turns it about z.

    Attributes
    ----------
    urdf : str
        The text of its URDF.
    low, high : tuple of float
        The limits of its four joints, in m and radians.
    boxes : tuple of LinkBox
        The boxes of its links.
    """

    urdf: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    boxes: tuple[LinkBox, ...]

    @classmethod
    def of(cls, cell: RobotCell) -> Arm:
        """Read the arm of a cell.

        Parameters
        ----------
        cell : RobotCell
            The cell.

        Returns
        -------
        Arm
            The arm.

        Raises
        ------
        ArgumentError
            If there is no such arm or file, or its URDF has no joints, or other ones than the
            gantry.
        """
        if cell.arm == "gantry":
            return cls.read(GANTRY)
        path = Path(cell.arm)
        if path.suffix.lower() != ".urdf":
            raise ArgumentError(
                f"arm {cell.arm!r} is not known: choose gantry, or the path of a .urdf file"
            )
        with naming(path):
            text = path.read_text()
        with located(path, ArgumentError):
            return cls.read(text)

    @classmethod
    def read(cls, urdf: str) -> Arm:
        """Read the text of a URDF, or raise ArgumentError."""
        try:
            parser = etree.XMLParser(resolve_entities=False, no_network=True)
            robot = etree.fromstring(urdf.encode(), parser)
            joints = [one for one in robot.iter("joint") if one.get("type") != "fixed"]
            found = tuple(str(one.get("type")) for one in joints)
            if not found:
                raise ArgumentError("the URDF has no joints that move: an arm needs some")
            if found != KINDS:
                raise ArgumentError(
                    f"the URDF has the joints {', '.join(found)}: this needs {', '.join(KINDS)}"
                )
            limits = [one.find("limit").attrib for one in joints]
            low, high = (tuple(float(one[end]) for one in limits) for end in ("lower", "upper"))
            children = [str(one.find("child").get("link")) for one in joints]
            boxes = [box for link in robot.iter("link") for box in _boxes(link, children)]
        except (etree.XMLSyntaxError, AttributeError, KeyError, ValueError) as error:
            if isinstance(error, ArgumentError):
                raise
            raise ArgumentError(f"the URDF can't be read: {error}") from None
        return cls(urdf, low, high, tuple(boxes))

    def check(self, cell: RobotCell, cells: Triple, longest: float) -> None:
        """Check that the arm reaches all of the box and the station.

        Parameters
        ----------
        cell : RobotCell
            The cell.
        cells : Triple
            The cells of the box.
        longest : float
            The longest extent of an item, m: it has to pass above the rim.

        Raises
        ------
        ArgumentError
            If it does not.
        """
        size, station = cell.size(cells), cell.station(cells)
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


STATION_REACH = 0.10
"""Metres around the middle of the station that the arm must reach."""


def _boxes(link: Any, children: list[str]) -> list[LinkBox]:
    """Return the collision boxes of a link that moves."""
    if link.get("name") not in children:
        return []
    joint, found = children.index(str(link.get("name"))), []
    for collision in link.iter("collision"):
        box, origin = collision.find("geometry/box"), collision.find("origin")
        if box is None:
            raise ArgumentError(f"link {link.get('name')!r} has a shape that is no box")
        x, y, z = map(float, str(box.get("size")).split())
        a, b, c = map(float, str("0 0 0" if origin is None else origin.get("xyz")).split())
        found.append(LinkBox(joint, (x, y, z), (a, b, c)))
    return found


def box_shift(box: LinkBox, joints: Floats) -> Floats:
    """Return how far the first three joints have moved a box, (3,) in m."""
    moved = np.zeros(3)
    reached = min(box.joint, 2) + 1
    moved[:reached] = joints[:reached]
    return moved
