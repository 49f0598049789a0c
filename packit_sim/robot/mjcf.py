"""The text of MJCF, the format of MuJoCo: a cell without its arm, and items as free bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from lxml import etree

from packit_sim.robot.cell import GRAVITY, Cells, RobotCell, walls


def mjcf(
    cell: RobotCell,
    cells: Cells,
    meshes: Sequence[str],
    masses: Sequence[float],
    poses: Mapping[int, Sequence[float]],
) -> str:
    """Describe the table, the box and the items in it.

    Parameters
    ----------
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
    for name, (low, high) in walls(cells).items():
        half, middle = (high - low) / 2 * cell.edge, (low + high) / 2 * cell.edge
        etree.SubElement(world, "geom", name=name, type="box", size=_text(half), pos=_text(middle))
    for n, pose in sorted(poses.items()):
        name = f"item {n}"
        etree.SubElement(assets, "mesh", name=name, file=meshes[n], inertia="convex")
        body = etree.SubElement(world, "body", name=name, pos=_text(pose[:3]), quat=_text(pose[3:]))
        etree.SubElement(body, "freejoint", name=name)
        etree.SubElement(body, "geom", type="mesh", mesh=name, mass=_text([masses[n]]))
    return etree.tostring(model, encoding="unicode", pretty_print=True)


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
