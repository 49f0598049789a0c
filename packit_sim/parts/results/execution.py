"""Execution of packings: a robot arm puts the parts of each box in, in their recorded order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackFormatError, located
from packit_sim.core.length_units import check_unit
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.posed_parts import posed
from packit_sim.parts.reading.units import factor
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.executed_item import ExecutedItem
from packit_sim.robot.plans import ExecutedPlan, execute_plan


class _Unit(Struct):
    unit: str = ""


def execute_packing(
    file: Path | str,
    cell: RobotCell | None = None,
    callback: Callable[[tuple[ExecutedItem, ...]], None] | None = None,
) -> list[ExecutedPlan]:
    """Let an arm pack the boxes of a packing, in simulated physics.

    Parameters
    ----------
    file : Path or str
        A packing that `packit verify` accepts, in boxes with nothing else in them, such as the
        record of `packit pack`, with a unit of length.
    cell : RobotCell, optional
        The robot cell. Its `edge` becomes the longest side of the box.
    callback : callable, optional
        Called after each part with all of its box that were tried.

    Returns
    -------
    list of ExecutedPlan
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
        _executed(packing, box, metres, cell or RobotCell(), callback)
        for box in sorted({placement.box for placement in packing.placements})
    ]


def _executed(
    packing: Packing,
    box: int,
    metres: float,
    cell: RobotCell,
    callback: Callable[[tuple[ExecutedItem, ...]], None] | None,
) -> ExecutedPlan:
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
    return execute_plan(posed(own), cells, cell, callback=callback)
