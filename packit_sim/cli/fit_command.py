"""`packit fit`: the largest scale at which one part fits into a container."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli.options import (
    ContainerOption,
    FileUnitOption,
    SeedOption,
    TimeOption,
    UpOption,
    WallClearanceOption,
    read_seconds,
)
from packit_sim.cli.stopping import stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.core.length_units import Unit

with lazy_imports():
    import packit_sim
    from packit_sim.cli import output, terminal
    from packit_sim.parts.reading import boxes, distances, files, named_containers, sizes


def fit_command(
    part: Annotated[str, typer.Argument(metavar="PART", help="Mesh file of the part.")],
    box: Annotated[
        str | None, typer.Option("--box", help="Sides of the box, such as 300x200x150mm.")
    ] = None,
    container: ContainerOption = None,
    wall_clearance: WallClearanceOption = "0",
    rotations: Annotated[
        str,
        typer.Option(help="Rotations: fixed, upright, yaw-N, flip-N, axis-N, cube or free."),
    ] = "free",
    unit: FileUnitOption = "mm",
    up: UpOption = None,
    packing: Annotated[
        Path | None,
        typer.Option(help="File for the scaled part in its container, which packit verify reads."),
    ] = None,
    time: TimeOption = "20",
    seed: SeedOption = 0,
) -> None:
    """Find the largest scale at which one part fits into a container.

    In boxes, cylinders and convex meshes every rotation is possible; in other meshes the part is
    turned by the 24 rotations of a cube. The place is checked by the meshes.

    Example: packit fit vase.stl --container prusa-mk4 --wall-clearance 2mm
    """
    if (box is None) == (container is None):
        raise ArgumentError("one container is needed: choose --box 300x200x150mm, or --container")
    if packing is not None:
        output.prepare_folder(packing, part, container, field="items")
    asked = str(box or container)
    length: Unit = boxes.box_unit(named_containers.without_names(asked)[0]) or unit
    settings = packit_sim.PackSettings(
        wall_clearance=distances.read_wall_clearance(wall_clearance, length),
        unit=length,
        reading=files.ReadSettings(unit, up, rotations, False),
    )
    with stoppable("nothing is written"):
        found = packit_sim.fit(part, asked, read_seconds(time), seed, settings)
    size = f"{sizes.lengths_text(found.size)} {length}"
    angle = found.packing.placements[0].pose.angle
    lines = [
        f"scale      {found.scale:.5g}",
        f"size       {size}",
        f"turned by  {angle:.4g} degrees",
        f"density    {found.packing.density:.3f}",
    ]
    for line in lines:
        terminal.console.print(line, markup=False, highlight=False, soft_wrap=True)
    if packing is not None:
        found.packing.write(packing)
        output.print_written(packing)
