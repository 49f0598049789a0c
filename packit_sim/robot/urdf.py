"""The text of URDF: links, joints, and tools that are parts of several arms."""

from __future__ import annotations

from lxml import etree

from packit_sim.robot.arm import CUP
from packit_sim.robot.cell import TILTED_TOOL, TUBE

TILT = 1.6
"""Largest angle by which a tilting tool turns to a side, radians."""


def link(name: str, mass: float, size: tuple[float, float, float], at: float) -> str:
    """Return a link: a box whose middle is at a height, or nothing if it has no size; m and kg."""
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


def joint(
    name: str,
    kind: str,
    links: tuple[str, str],
    axis: str,
    low: float,
    high: float,
    height: float = 0.0,
) -> str:
    """Return a joint at a height above its parent's origin, with its limits; m and radians."""
    parent, child = links
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {height}"/>'
        f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="1000" velocity="2"/>'
        "</joint>"
    )


def tilting_tip(low: float) -> str:
    """Return the tool's end below a link "head": an axis that tilts it from an angle on, a tube."""
    return (
        joint("tilt", "revolute", ("head", "tube"), "0 1 0", low, TILT, TILTED_TOOL)
        + link("tube", 0.2, (TUBE, TUBE, TILTED_TOOL - CUP), (CUP - TILTED_TOOL) / 2)
        + '<joint name="tip" type="fixed"><parent link="tube"/><child link="tool"/>'
        f'<origin xyz="0 0 {-TILTED_TOOL}"/></joint>' + link("tool", 0.2, (0, 0, 0), 0)
    )


def with_cup(urdf: str, radius: float) -> str:
    """Add a cup of a radius in m to the last link of a URDF."""
    robot = etree.fromstring(urdf.encode())
    form = f'<cylinder radius="{radius}" length="{CUP}"/>'
    cup = f'<origin xyz="0 0 {CUP / 2}"/><geometry>{form}</geometry>'
    robot.findall("link")[-1].append(etree.fromstring(f"<collision>{cup}</collision>"))
    return etree.tostring(robot, encoding="unicode")
