"""The arms that a cell can have, by name."""

from __future__ import annotations

from pathlib import Path

from packit_sim.core.errors import ArgumentError
from packit_sim.robot.arm import Arm
from packit_sim.robot.cell import PANDA, Cells, RobotCell
from packit_sim.robot.gantry import Gantry
from packit_sim.robot.panda import Panda


def arm_of(cell: RobotCell, cells: Cells) -> Arm:
    """Create the arm of a cell.

    Parameters
    ----------
    cells : Cells
        The cells of the box.

    Returns
    -------
    Arm
        The arm.

    Raises
    ------
    ArgumentError
        If there is no such arm or file, or its URDF has no joints, or other ones than a gantry.
    MissingPackageError
        If the files of the panda, which come with PyBullet, are missing.
    """
    if cell.arm == PANDA:
        return Panda.of(cell, cells)
    if cell.arm != "gantry" and Path(cell.arm).suffix.lower() != ".urdf":
        raise ArgumentError(
            f"arm {cell.arm!r} is not known: choose gantry, panda, or the path of a .urdf file"
        )
    return Gantry.of(cell)
