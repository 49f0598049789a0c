"""Containers in the files of packings: sides of a bounding box, and what is inside it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import Struct

from packit_sim.core.errors import ArgumentError, PackFormatError, located
from packit_sim.parts.packings.bounds import PoseRows
from packit_sim.parts.packings.containers import BoxContainer, Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.packings.mesh_paths import file_inside
from packit_sim.parts.packings.placements import Placement

ROUNDING = 1e-6
"""Rounding of sides, relative to the longest."""

FormName = Literal["box", "cylinder", "mesh"]
"""What a container is."""


class RecordedForm(Struct, omit_defaults=True):
    """What is inside a bounding box that is not all of the container.

    Attributes
    ----------
    form : str
        "cylinder", upright, touching all walls; or "mesh".
    mesh : str, optional
        The mesh's file, by its path from the folder.
    pose : tuple of tuple of float, optional
        The matrix (4, 4) from the coordinates in that file to those of the container.
    """

    form: Literal["cylinder", "mesh"]
    mesh: str | None = None
    pose: PoseRows | None = None


def form_of(container: Container) -> FormName:
    """Return what a container is."""
    if isinstance(container, MeshContainer):
        return "mesh"
    return "cylinder" if isinstance(container, CylinderContainer) else "box"


def recorded_container(
    sides: tuple[float, float, float | None],
    form: RecordedForm | None,
    folder: Path,
    field: str,
    obstacles: tuple[ItemType, ...] = (),
) -> Container:
    """Return the container that a file describes.

    Parameters
    ----------
    sides : tuple
        The sides of its bounding box; the last is None for a strip.
    form : RecordedForm, optional
        What is inside the bounding box, if not a box.
    folder : Path
        The folder that has its mesh.
    field : str
        The name of the field, for messages.
    obstacles : tuple of ItemType
        What is in it.

    Returns
    -------
    Container
        The container.

    Raises
    ------
    PackFormatError
        If the sides are not those of such a container.
    MeshError
        If the mesh can't be used.
    """
    x, y, z = sides
    if form is None:
        return BoxContainer((x, y, math.inf if z is None else z), obstacles)
    if z is None:
        raise PackFormatError(f"field {field!r} has no height: only a box may have none")
    if form.form == "cylinder":
        found: Container = CylinderContainer(x, z, obstacles)
    else:
        if form.mesh is None or form.pose is None:
            raise PackFormatError(f"field {field!r} needs 'mesh' and 'pose'")
        own = ItemType.from_file(file_inside(folder, form.mesh))
        vertices = Placement.from_matrix(0, np.array(form.pose)).apply(own.vertices)
        with located(f"field {field!r}", ArgumentError):
            mesh = ItemType(own.name, vertices, own.faces)
            found = MeshContainer(mesh, obstacles)
        if not np.abs(mesh.low).max() <= ROUNDING * found.longest:
            raise PackFormatError(f"field {field!r}: its bounding box does not begin at (0, 0, 0)")
    if not np.allclose(found.size, (x, y, z), rtol=0, atol=ROUNDING * found.longest):
        sizes = (x, y, z), found.size
        stated, true = (" x ".join(f"{side:.6g}" for side in size) for size in sizes)
        raise PackFormatError(f"field {field!r} has a bounding box of {true}, not of {stated}")
    return found
