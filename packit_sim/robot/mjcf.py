"""The text of MJCF, the format of MuJoCo: a cell without its arm, and items as free bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lxml import etree

from packit_sim.geometry.arrays import Floats
from packit_sim.robot.cell import GRAVITY, WALL, RobotCell


def mjcf(
    cell: RobotCell,
    sides: Floats,
    meshes: Sequence[str],
    masses: Sequence[float],
    poses: Mapping[int, Sequence[float]],
) -> str:
    """Describe the table, the box and the items in it.

    Parameters
    ----------
    sides : ndarray
        Inner sides of the box in m.
    meshes : sequence of str
        The mesh file of each item.
    masses : sequence of float
        The mass of each in kg.
    poses : mapping of int to sequence of float
        Position in m and quaternion (w, x, y, z) of those that are shown, by number.

    Returns
    -------
    str
        The model. Body `item N` has a free joint, whose `qpos` is a pose.
    """
    model = etree.Element("mujoco", model="packit cell")
    etree.SubElement(
        model, "option", timestep=_text([cell.world.step]), gravity=_text([0, 0, -GRAVITY])
    )
    default = etree.SubElement(model, "default")
    etree.SubElement(default, "geom", friction=_text([cell.friction, 0.005, 0.0001]))
    assets, world = etree.SubElement(model, "asset"), etree.SubElement(model, "worldbody")
    etree.SubElement(world, "geom", name="table", type="plane", size="2 2 0.1")
    x, y, z = sides.tolist()
    wide = WALL * cell.edge
    walls = {
        "left": ((-wide, -wide), (0, y + wide)),
        "right": ((x, -wide), (x + wide, y + wide)),
        "back": ((0, -wide), (x, 0)),
        "front": ((0, y), (x, y + wide)),
    }
    for name, ((low_x, low_y), (high_x, high_y)) in walls.items():
        half = ((high_x - low_x) / 2, (high_y - low_y) / 2, z / 2)
        middle = (low_x + half[0], low_y + half[1], half[2])
        etree.SubElement(world, "geom", name=name, type="box", size=_text(half), pos=_text(middle))
    for n, pose in sorted(poses.items()):
        name = f"item {n}"
        etree.SubElement(assets, "mesh", name=name, file=meshes[n], inertia="convex")
        body = etree.SubElement(world, "body", name=name, pos=_text(pose[:3]), quat=_text(pose[3:]))
        etree.SubElement(body, "freejoint", name=name)
        etree.SubElement(body, "geom", type="mesh", mesh=name, mass=_text([masses[n]]))
    return etree.tostring(model, encoding="unicode", pretty_print=True)


def _text(numbers: Sequence[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
