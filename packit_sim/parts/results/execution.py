"""Execution of packings: a robot arm puts the parts of each box in, in their recorded order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackFormatError, located
from packit_sim.core.sums import plain_sum
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.posed_parts import posed
from packit_sim.parts.reading.units import check_unit, factor
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.measures import inside_volume, measures, resting_poses
from packit_sim.robot.plans import execute_plan
from packit_sim.robot.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class ExecutedBox:
    """A box of a packing after an arm packed it.

    Attributes
    ----------
    names : tuple of str
        The names of its parts, in their order.
    trajectory : Trajectory
        What the arm and the parts did.
    inside : int
        The number of parts that are wholly inside the box at the end, below its rim.
    executed : float
        Their volume, relative to that of all parts of the box.
    scores : dict of str to number
        The measures (see `robot.measures.measures`).
    """

    names: tuple[str, ...]
    trajectory: Trajectory
    inside: int
    executed: float
    scores: dict[str, int | float]


class _Unit(Struct):
    unit: str = ""


def execute_packing(file: Path | str, cell: RobotCell | None = None) -> list[ExecutedBox]:
    """Let an arm pack the boxes of a packing, in simulated physics.

    Parameters
    ----------
    file : Path or str
        A packing that `packit verify` accepts, in boxes with nothing else in them, such as the
        record of `packit pack`, with a unit of length.
    cell : RobotCell, optional
        The robot cell. Its `edge` becomes the longest side of the box.

    Returns
    -------
    list of ExecutedBox
        The boxes with parts.

    Raises
    ------
    PackFormatError
        If the file is not of this form, or names no unit.
    ArgumentError
        If a container is not a box, or the arm can't reach it or lift a part.
    MeshError
        If a mesh can't be used.
    """
    packing = Packing.read(file)
    with located(file, PackFormatError):
        named = typed_json.decode(read_bytes(Path(file)), _Unit, PackFormatError, "a packing")
        if not named.unit:
            raise PackFormatError("field 'unit' is missing: an arm needs real sizes, such as 'mm'")
    metres = factor(check_unit(named.unit), "m")
    return [
        _executed(packing, box, metres, cell or RobotCell())
        for box in sorted({placement.box for placement in packing.placements})
    ]


def _executed(packing: Packing, box: int, metres: float, cell: RobotCell) -> ExecutedBox:
    container = packing.container_of(box)
    if form_of(container) != "box" or container.is_strip or container.obstacles:
        raise ArgumentError(
            f"an arm can't pack {container.name!r}: choose boxes with nothing fixed in them"
        )
    placements = tuple(one for one in packing.placements if one.box == box)
    own = replace(packing, container=container, placements=placements, containers=())
    cell = replace(cell, edge=container.longest * metres)
    x, y, z = (100 * side / container.longest for side in container.size)
    cells: Cells = (x, y, z)
    tried = execute_plan(posed(own), cells, cell)
    trajectory = Trajectory.of(cell, cells, tried)
    items = [one.item for one in tried]
    ends = resting_poses(trajectory)[-1]
    return ExecutedBox(
        names=tuple(packing.types[one.type].name for one in placements),
        trajectory=trajectory,
        inside=sum(cell.holds(cells, end) for end in ends.values()),
        executed=inside_volume(trajectory) / plain_sum(item.volume for item in items),
        scores=measures(trajectory, items),
    )
