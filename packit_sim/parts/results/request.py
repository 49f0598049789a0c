"""The request of a packing in its record: what was asked for, so that it can be compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, to_builtins

from packit_sim.core.choices import Door, Goal, GroupRule, LoadingOrder
from packit_sim.core.errors import MeshError
from packit_sim.core.length_units import UNITS_CM, Unit
from packit_sim.libraries.mesh_files import read
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.bounds import Extent
from packit_sim.parts.packings.container_files import FormName, form_of
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.mesh_paths import file_inside
from packit_sim.parts.packings.turning import ANY_TURN, Turning
from packit_sim.parts.reading.boxes import BoxType, MeshBox
from packit_sim.parts.reading.file_copies import FileCopies
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.reading.limits import Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.powder import Powder
from packit_sim.parts.reading.prepared import PreparedPart


class RequestedPart(Struct, rename=lambda name: name.replace("_", " ")):
    """A part that was asked for, or that has a place in the box.

    Attributes
    ----------
    mesh : str, optional
        Its file, by its path from the record's folder; None if none of it is packed.
    sha256 : str, optional
        The digest of that file.
    scale : float
        How many of the record's unit the file's unit has.
    deviation : float
        How far the mesh is from the surface of a CAD file, in the file's unit.
    as_many_as_fit : bool
        Whether the count is only the most of it.
    clearance : float, optional
        Its own smallest distance to others, in the file's unit.
    group : str, optional
        The group that it belongs to.
    max_tilt : float
        The most degrees by which it may lean.
    down : tuple of str
        The sides that may face down.
    stop : int, optional
        The stop at which it is delivered.
    """

    name: str
    mesh: str | None
    sha256: str | None
    count: int
    scale: Annotated[float, Meta(gt=0)]
    up: str
    rotations: str
    value: float | None
    priority: int
    mass: float | None
    density: float | None
    no_stack: bool
    max_load: float | None
    deviation: float
    as_many_as_fit: bool = False  # earlier versions had no such parts
    clearance: Annotated[float, Meta(ge=0)] | None = None  # nor this
    group: str | None = None  # nor this
    max_tilt: float = ANY_TURN.max_tilt  # nor this
    down: tuple[str, ...] = ANY_TURN.down  # nor this
    stop: int | None = None  # nor this

    def part(self, folder: Path, unit: Unit, copies: FileCopies) -> Part:
        """Read the part.

        Parameters
        ----------
        copies : FileCopies
            Gets the content of its file, from which the check reads it again.

        Returns
        -------
        Part
            The part, of its file in the folder.

        Raises
        ------
        MeshError
            If its file can't be read, leads out of the folder, or has another digest.
        """
        file = file_inside(folder, self.mesh or "")
        kept: dict[str, bytes] = {}
        mesh = read(file, keep=kept.__setitem__).mesh
        copy = copies.add(kept)
        if copy.digest != self.sha256:
            raise MeshError(f"{file} is another file than the one that was packed, by its SHA-256")
        return Part(
            self.name,
            mesh,
            self.count,
            self.value,
            self.rotations,
            self.priority,
            self.mass,
            self.density,
            self.no_stack,
            self.max_load,
            unit_cm=self.scale * UNITS_CM[unit],
            up=self.up,
            file=file,
            deviation=self.deviation,
            copy=copy,
            as_many_as_fit=self.as_many_as_fit,
            clearance=self.clearance,
            group=self.group,
            turning=Turning(self.max_tilt, self.down),
            stop=self.stop,
        )


class RequestedBox(Struct, rename=lambda name: name.replace("_", " ")):
    """A size of boxes that was asked for, or another container.

    Attributes
    ----------
    form : str
        What it is; the size is that of its bounding box.
    outline : RequestedPart, optional
        Its mesh, if it is one.
    max_mass : float, optional
        The most grams in one.
    max_parts : int, optional
        The most parts in one.
    balance : float, optional
        How far the centre of gravity may be off the middle, in shares of the sides.
    """

    name: str
    size: tuple[Extent, Extent, Extent]
    count: int | None
    form: FormName = "box"  # earlier versions had no other
    outline: RequestedPart | None = None
    max_mass: float | None = None
    max_parts: int | None = None
    balance: float | None = None

    def box(self, folder: Path, unit: Unit, copies: FileCopies) -> BoxType | MeshBox:
        """Return the box, with its mesh if it is one (see `RequestedPart.part`)."""
        limits = Limits(self.max_mass, self.max_parts, self.balance)
        if self.form == "box":
            return BoxType(self.size, self.name, self.count, limits=limits)
        if self.form == "cylinder":
            container = CylinderContainer(self.size[0], self.size[2], name=self.name)
            return BoxType(self.size, self.name, self.count, container, limits)
        if self.outline is None:
            raise MeshError(f"the container {self.name!r} has no mesh")
        return MeshBox(self.outline.part(folder, unit, copies), self.name, self.count, limits)


class Request(Struct, rename=lambda name: name.replace("_", " ")):
    """All that was asked for, in the unit of the record.

    Attributes
    ----------
    constraints : tuple of str
        Custom constraints, which can't be checked.
    powder : Powder, optional
        The powder of the bed.
    even : bool
        Whether layers were evened.
    """

    parts: tuple[RequestedPart, ...]
    boxes: tuple[RequestedBox, ...]
    keep_out: tuple[RequestedPart, ...]
    fixed: tuple[RequestedPart, ...]
    unit: Unit
    objective: Goal
    clearance: float
    wall_clearance: float | WallClearance
    accuracy: float | None
    removable: bool
    insertable: bool
    stable: float | None
    constraints: tuple[str, ...]
    separable: bool = False  # earlier versions did not record it
    clearance_z: float | None = None  # nor this
    groups: tuple[GroupRule, ...] = ()  # nor this
    powder: Powder | None = None  # nor this
    even: bool = False  # nor this
    door: Door = "z+"  # nor this
    order: LoadingOrder | None = None  # nor this

    def task(self, folder: Path) -> PackTask:
        """Prepare the task again, from the meshes in a folder; parts without a mesh are left out.

        Returns
        -------
        PackTask
            The task; its objective is "volume" and it has no rules of groups, since the parts that
            decide may be left out.

        Raises
        ------
        MeshError
            If a mesh can't be read, or is another one.
        ArgumentError
            If no such task is possible.
        """
        copies = FileCopies()
        settings = PackSettings(
            self.clearance,
            self.wall_clearance,
            self.accuracy,
            unit=self.unit,
            reading=ReadSettings(self.unit),
            removable=self.removable,
            insertable=self.insertable,
            separable=self.separable,
            stable=self.stable,
            keep_out=[each.part(folder, self.unit, copies) for each in self.keep_out],
            fixed=[each.part(folder, self.unit, copies) for each in self.fixed],
            workers=1,
            clearance_z=self.clearance_z,
            powder=self.powder,
            door=self.door,
            order=self.order,
        )
        boxes = [each.box(folder, self.unit, copies) for each in self.boxes]
        packed = [each for each in self.parts if each.mesh is not None]
        parts = [each.part(folder, self.unit, copies) for each in packed]
        return prepared_task(parts, boxes, "volume", settings)


def request(
    task: PackTask, record: Mapping[str, Any], outlines: Mapping[str, str]
) -> dict[str, Any]:
    """Return what was asked for, as the record of a packing contains it.

    Parameters
    ----------
    record : mapping of str to object
        The record, whose items and obstacles name their meshes, and which has their digests.
    outlines : mapping of str to str
        The meshes of containers, by the names of these.

    Returns
    -------
    dict of str to object
        The request.
    """
    meshes = {each["name"]: each["mesh"] for each in record["items"]}
    around = [each["mesh"] for each in record["obstacles"]]
    first, files = len(task.keep_out), record["files"]
    settings = task.settings
    found = Request(
        tuple(_requested(each, meshes.get(each.part.name), files) for each in task.parts),
        tuple(_requested_box(task, box, outlines.get(box.name), files) for box in task.boxes),
        tuple(map(_requested, task.keep_out, around[:first], [files] * first)),
        tuple(map(_requested, task.fixed, around[first:], [files] * len(task.fixed))),
        task.unit,
        task.objective,
        settings.clearance,
        settings.wall_clearance,
        settings.accuracy,
        settings.removable,
        settings.insertable,
        settings.stable,
        tuple(repr(each) for each in settings.constraints),
        settings.separable,
        settings.clearance_z,
        tuple(settings.groups),  # type: ignore[arg-type]
        settings.powder,
        settings.even,
        settings.door,
        settings.order,
    )
    built: dict[str, Any] = to_builtins(found)
    return built


def _requested_box(
    task: PackTask, box: BoxType, mesh: str | None, files: Mapping[str, str]
) -> RequestedBox:
    outline = None if mesh is None else _requested(task.outlines[box.name], mesh, files)
    limits = astuple(box.limits)
    return RequestedBox(box.name, box.size, box.count, form_of(box.container), outline, *limits)


def _requested(prepared: PreparedPart, mesh: str | None, files: Mapping[str, str]) -> RequestedPart:
    part = prepared.part
    digest = None if mesh is None else files[mesh]
    return RequestedPart(
        part.name,
        mesh,
        digest,
        part.count,
        prepared.scale,
        part.up,
        part.rotations,
        part.value,
        part.priority,
        part.mass,
        part.density,
        part.no_stack,
        part.max_load,
        part.deviation,
        part.as_many_as_fit,
        part.clearance,
        part.group,
        part.turning.max_tilt,
        part.turning.down,
        part.stop,
    )
