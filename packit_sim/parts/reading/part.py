"""Parts: meshes of users, each with its unit, its count, and rules."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from packit_sim.core.caches import cached_property
from packit_sim.core.checks import as_integer, check_range
from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.length_units import UNITS_CM, Unit, check_unit
from packit_sim.core.plain_text import plain_line
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import UP_AXES
from packit_sim.parts.packings import rotation_sets
from packit_sim.parts.packings.bounds import (
    COUNTS,
    DENSITIES,
    DISTANCES,
    LENGTHS,
    LOADS,
    MASSES,
    PRIORITIES,
    VALUES,
)
from packit_sim.parts.packings.turning import ANY_TURN, Turning
from packit_sim.parts.reading.file_copies import FileCopy
from packit_sim.parts.reading.units import factor

UPRIGHT = "upright"
"""Another name of `yaw-4`: quarter turns about the vertical axis."""

_BOUNDS = {
    "value": VALUES,
    "mass": MASSES,
    "density": DENSITIES,
    "unit_cm": LENGTHS,
    "max_load": LOADS,
}
"""The valid values of fields that may be None."""

_MAX_NAME = 100
"""Most bytes of a name that becomes part of a file's name, which has at most 255."""

_UP = {
    "x": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""The rotation by which each up axis becomes z."""


def rotation_set(name: str) -> str:
    """Return the name of a set of rotations; raise ArgumentError if there is none."""
    name = "yaw-4" if name == UPRIGHT else name
    try:
        rotation_sets.check(name)
    except ArgumentError as error:
        raise ArgumentError(f"{error}, or {UPRIGHT} (yaw-4)") from None
    return name


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh to pack.

    Parameters
    ----------
    name : str
        Its name, in tables and files; control characters are replaced.
    mesh : trimesh.Trimesh
        The mesh, in the coordinates of its file.
    count : int
        How many of it to pack, 1 to 10,000.
    as_many_as_fit : bool
        Whether the count is only the most of it: copies without a place are not missed.
    value : float, optional
        Its value, 0 to 1e12, for the objective "value"; without one it counts as 1 there.
    rotations : str
        How it may turn, from its orientation in the file: fixed, yaw-N, flip-N, axis-N, cube, free,
        or upright.
    priority : int
        Parts of a higher priority are packed first.
    mass : float, optional
        Grams of one of it.
    density : float, optional
        Grams per cubic centimetre, for its mass.
    no_stack : bool
        Whether nothing may rest on it.
    max_load : float, optional
        The grams that may rest on one of it, directly or through others.
    unit : str
        The mesh's unit of length.
    unit_cm : float, optional
        Centimetres in that unit, where a file defines another one than those with a name.
    up : str
        The axis of the mesh that points up, "x", "y" or "z".
    file : Path, optional
        The file that has this mesh.
    copy : FileCopy, optional
        Its content as it was read, for the check and for results. The file may be gone since.
    node : str, optional
        The node of the file's scene, if the mesh is only a part of it.
    deviation : float
        No point of the file's surface is farther from the mesh, in the mesh's unit: 0 but for
        tessellations of CAD files.
    clearance : float, optional
        The smallest distance to other parts, if it is larger than that of all, in the mesh's unit.
    group : str, optional
        The group of parts that it belongs to, such as an order or a material.
    turning : Turning
        Limits on how it may turn, after its up axis has become z.
    stop : int, optional
        The stop at which it is delivered, from 1 on, for the order "delivery".

    Raises
    ------
    ArgumentError
        If a value is not possible.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import Part
    >>> bracket = Part("bracket", trimesh.creation.box((40, 20, 5)), count=4, rotations="upright")
    >>> bracket.count, bracket.unit, bracket.rotations
    (4, 'mm', 'yaw-4')
    >>> Part("bracket", trimesh.creation.box((40, 20, 5)), count=0)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: part 'bracket': count 0 is not possible: 1 to 10000
    """

    name: str
    mesh: trimesh.Trimesh
    count: int = 1
    value: float | None = None
    rotations: str = "cube"
    priority: int = 0
    mass: float | None = None
    density: float | None = None
    no_stack: bool = False
    max_load: float | None = None
    unit: Unit = "mm"
    unit_cm: float | None = None
    up: str = "z"
    file: Path | None = None
    copy: FileCopy | None = field(default=None, repr=False)
    node: str | None = None
    deviation: float = 0.0
    as_many_as_fit: bool = False
    clearance: float | None = None
    group: str | None = None
    turning: Turning = ANY_TURN
    stop: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", plain_line(self.name))
        if self.group is not None:
            object.__setattr__(self, "group", plain_line(self.group) or None)
        where = f"part {self.name!r}:"
        count = as_integer(f"{where} count", self.count)
        check_range(f"{where} count", count, COUNTS)
        priority = as_integer(f"{where} priority", self.priority)
        check_range(f"{where} priority", priority, PRIORITIES)
        if self.stop is not None:
            check_range(f"{where} stop", as_integer(f"{where} stop", self.stop), COUNTS)
        for name, valid in _BOUNDS.items():
            if getattr(self, name) is not None:
                check_range(f"{where} {name}", getattr(self, name), valid)
        check_range(f"{where} deviation", self.deviation, DISTANCES)
        if self.clearance is not None:
            check_range(f"{where} clearance", self.clearance, DISTANCES)
        if self.up not in UP_AXES:
            raise ArgumentError(f"{where} up axis {self.up!r}: choose from {', '.join(UP_AXES)}")
        check_unit(self.unit)
        with located(f"part {self.name!r}", ArgumentError):
            object.__setattr__(self, "rotations", rotation_set(self.rotations))
            self.turning.check(self.rotations)

    def scale(self, unit: Unit) -> float:
        """Return how many of a unit of length the mesh's own unit has."""
        if self.unit_cm is not None:
            return self.unit_cm / UNITS_CM[unit]
        return factor(self.unit, unit)

    @property
    def user_from_file(self) -> Motion:
        """The rotation of the file's up axis to z, after the scale to the user's unit."""
        return Motion(np.array(_UP[self.up]))

    def matrix(self, unit: Unit) -> Floats:
        """Return the matrix (4, 4) from the file's coordinates to a unit of length with z up."""
        return self.user_from_file.scaled(self.scale(unit))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the mesh and of what else the packing depends on, in hex."""
        sha = hashlib.sha256(np.ascontiguousarray(self.mesh.vertices, "<f8").tobytes())
        sha.update(np.ascontiguousarray(self.mesh.faces, "<i8").tobytes())
        settings = (
            self.count,
            self.value,
            self.rotations,
            self.priority,
            self.matrix("mm").tolist(),
        )
        loads = (self.mass, self.density, self.no_stack, self.max_load)
        sha.update(repr((self.name, settings, loads)).encode())
        if self.as_many_as_fit:
            sha.update(b"as many as fit")
        if self.clearance is not None:
            sha.update(repr(("clearance", self.clearance)).encode())
        if self.group is not None:
            sha.update(repr(("group", self.group)).encode())
        if self.turning != ANY_TURN:
            sha.update(repr(self.turning).encode())
        if self.stop is not None:
            sha.update(repr(("stop", self.stop)).encode())
        return sha.hexdigest()

    @property
    def file_name(self) -> str:
        """Its name without what files can't have in theirs."""
        name = re.sub(r"[^\w.+-]+", "-", self.name).encode()[:_MAX_NAME].decode(errors="ignore")
        return name.strip(".-") or "part"

    def __repr__(self) -> str:
        return f"Part({self.name!r}, {len(self.mesh.faces)} triangles, count={self.count})"
