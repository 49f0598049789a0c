"""Prepared parts: parts in the user's unit, with collision meshes of bounded deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import MeshError
from packit_sim.core.length_units import UNITS_CM, Unit
from packit_sim.core.plain_text import listed
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.deviation import Surface, deviation
from packit_sim.geometry.deviation_kernels import farthest
from packit_sim.geometry.parts import part_numbers
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import collapsed
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.reading.masses import centre_of_mass
from packit_sim.parts.reading.part import Part

TRIANGLES = 4000
"""Meshes with more triangles are simplified, to as many; to more where the deviation is too large.
Four times as many follow each time."""

MAX_TRIANGLES = 2_000_000
"""Most triangles of a part: repair and simplification take up to 1.6 kB of memory for each."""

ACCURACY = 0.002
"""Largest deviation by default, relative to the part's diagonal."""

TINY = 1 / 25
"""Longest side, relative to that of the largest part, below which a part is packed as a box: the
nester's grids around small parts have a width that depends on the largest."""

TINY_GAPS = 2.0
"""The same, relative to the distance that parts keep."""

SAMPLES = 5000
"""Vertices whose distances show cheaply that a simplified mesh deviates too much."""

_FLAT = 0.01
"""Distinct normals, relative to the triangles, below which a mesh has few flat faces that are cut
finely. It is not simplified: the bound of the deviation of flat faces takes minutes."""

_ROUNDING = 1e-7
"""Added to each deviation for rounding and merged vertices, relative to the diagonal."""


@dataclass(frozen=True, eq=False)
class PreparedPart:
    """A part as the search sees it, with lengths in the user's unit.

    Attributes
    ----------
    unit : str
        The user's unit.
    scale : float
        How many of that unit the file's unit has; then `part.user_from_file` turns z up.
    item_type : ItemType
        Its collision mesh, its number and its rotations.
    deviation : float
        No point of the file's surface is farther from the collision mesh; 0 if it is the same.
    is_closed : bool
        Whether the repaired surface is closed and does not cross itself; else it is solid by
        voxels.
    simplification : str, optional
        How the mesh was simplified, or a surface replaced by it.
    filled_holes : int
        How many holes of the file's surface were closed.
    is_shell : bool
        Whether the surface is open, so that its volume is that of a sheet and other parts may be
        placed inside.
    """

    part: Part
    unit: Unit
    scale: float
    item_type: ItemType
    deviation: float
    is_closed: bool
    simplification: str | None = None
    filled_holes: int = 0
    is_shell: bool = False

    @property
    def volume(self) -> float:
        """The volume of one of it."""
        return self.item_type.volume

    @cached_property
    def centre(self) -> Floats:
        """The centre of mass (3,), in the coordinates of the type."""
        return centre_of_mass(self.item_type)

    @cached_property
    def sides(self) -> Floats:
        """The sides (m, 3) of its bounding box in each of its rotations."""
        vertices = self.item_type.vertices
        turns = searched_rotations(self.item_type)
        return np.array([np.ptp(vertices @ turn.T, axis=0) for turn in turns])

    @cached_property
    def circles(self) -> Floats:
        """The diameters (m,) of the circles around it, seen from above, in each rotation."""
        vertices = self.item_type.vertices
        return np.array([_circle(vertices @ turn.T) for turn in searched_rotations(self.item_type)])

    @property
    def clearance(self) -> float | None:
        """The smallest distance to other parts, if it has one of its own."""
        return None if self.part.clearance is None else self.part.clearance * self.scale

    @property
    def mass(self) -> float | None:
        """The grams of one of it, if its mass or density is known."""
        if self.part.mass is not None or self.part.density is None:
            return self.part.mass
        return self.part.density * self.volume * UNITS_CM[self.unit] ** 3


def prepare(part: Part, unit: Unit, accuracy: float | None = None) -> PreparedPart:
    """Prepare a part: repair its mesh, measure it, and simplify it for the search.

    Parameters
    ----------
    unit : str
        The user's unit.
    accuracy : float, optional
        Largest deviation of the collision mesh, in that unit; by default `ACCURACY`.

    Returns
    -------
    PreparedPart
        The part with its collision mesh.

    Raises
    ------
    MeshError
        If the mesh is empty, not finite, flat, or of an impossible size, or has too many triangles.
    """
    if len(part.mesh.faces) > MAX_TRIANGLES:
        raise MeshError(
            f"{len(part.mesh.faces):,} triangles are too many to pack: at most {MAX_TRIANGLES:,}, "
            "for which 3 GB of memory are needed; reduce the mesh first"
        )
    scale = part.scale(unit)
    with np.errstate(invalid="ignore", over="ignore"):  # the shape below must be finite
        points = np.asarray(part.mesh.vertices, dtype=float) * scale
        vertices = part.user_from_file.direction(points)
    faces = np.asarray(part.mesh.faces, dtype=np.int64)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    shape, repairs = Shape.repaired(mesh, part.name)
    low, high = _bounds(vertices, faces)
    diagonal = float(np.linalg.norm(high - low))
    read = part.deviation * scale
    error, simplification = 0.0, None
    if read > 0:
        simplification = f"tessellated, at most {read:.3g} {unit} from the file's surface"
    if len(shape.mesh.faces) > TRIANGLES:
        limit = ACCURACY if accuracy is None else accuracy / diagonal
        mesh, error = _simplified(shape.mesh, max(limit - read / diagonal, 0.0))
        if error > 0:
            vertices = np.asarray(mesh.vertices) * diagonal + (low + high) / 2
            faces = np.asarray(mesh.faces, dtype=np.int64)
            error = (error + _ROUNDING) * diagonal
            simplification = (
                f"{len(shape.mesh.faces):,} triangles reduced to {len(faces):,} for the search, "
                f"at most {read + error:.3g} {unit} from the file's surface"
            )
    volume, is_closed = _volume(shape)
    item_type = ItemType(
        part.name,
        vertices,
        faces,
        part.count,
        part.rotations,
        known_volume=volume * diagonal**3,
        repaired=error == 0,
        turning=part.turning,
    )
    return PreparedPart(
        part,
        unit,
        scale,
        item_type,
        read + error,
        is_closed,
        simplification,
        repairs.filled_holes,
        shape.is_shell,
    )


def surface_notes(parts: Sequence[PreparedPart]) -> list[str]:
    """Return what was closed, and how parts count whose surface is not closed."""
    filled = [f"{each.part.name} ({each.filled_holes})" for each in parts if each.filled_holes]
    shells = [each.part.name for each in parts if each.is_shell]
    others = [each.part.name for each in parts if not (each.is_closed or each.is_shell)]
    notes = []
    if filled:
        notes.append(f"holes in the surface that were closed: {listed(filled)}")
    if shells:
        notes.append(
            "open, so that other parts may be placed inside, and the volume (and with it mass and "
            f"density) is only that of a thin sheet: {listed(shells)}"
        )
    if others:
        notes.append(f"solid by voxels, since open or self-intersecting: {listed(others)}")
    return notes


def least_side(parts: Sequence[PreparedPart], gap: float) -> float:
    """Return the smallest longest side of a collision mesh: the nester's grids grow below it."""
    longest = max(float(each.item_type.extents.max()) for each in parts)
    return max(TINY * longest, TINY_GAPS * gap)


def boxed(part: PreparedPart, least: float) -> PreparedPart:
    """Replace a tiny collision mesh by its bounding box, whose longest side becomes longer.

    Parameters
    ----------
    least : float
        The length of that side.

    Returns
    -------
    PreparedPart
        The part; the original surface is inside the box, so that distances to it are no shorter.
    """
    own, unit = part.item_type, part.unit
    extents = own.extents + 2 * part.deviation
    extents[int(np.argmax(extents))] = least
    mesh = trimesh.creation.box(extents).apply_translation((own.low + own.high) / 2)
    box = ItemType(
        own.name,
        mesh.vertices,
        mesh.faces,
        own.demand,
        own.rotations,
        known_volume=own.volume,
        turning=own.turning,
        turns=own.turns,
    )
    sides = " x ".join(f"{side:.3g}" for side in extents)
    note = f"tiny among these parts: packed as a box of {sides} {unit}"
    return replace(part, item_type=box, deviation=0.0, simplification=note)


def largest_sum(parts: Sequence[PreparedPart]) -> float:
    """Return the largest sum of the deviations of two parts that may be neighbours."""
    found = [part.deviation for part in parts for _ in range(min(part.part.count, 2))]
    return sum(sorted(found)[-2:])


def _circle(vertices: Floats) -> float:
    """Return the diameter of the smallest circle around vertices (n, 3), seen from above."""
    unit = float(np.ptp(vertices[:, :2], axis=0).max())  # trimesh has absolute tolerances
    _, radius = trimesh.nsphere.minimum_nsphere(vertices[:, :2] / unit)
    return 2 * unit * float(radius)


def _bounds(vertices: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Return the corners of the bounding box of the triangles with an area."""
    a, b, c = (vertices[corner] for corner in faces.T)
    crossed = np.cross(b - a, c - a)
    used = np.flatnonzero(np.bincount(faces[(crossed != 0).any(axis=1)].ravel()))
    return vertices[used].min(axis=0), vertices[used].max(axis=0)


def _simplified(mesh: trimesh.Trimesh, limit: float) -> tuple[trimesh.Trimesh, float]:
    """Simplify a mesh within a deviation; return it unchanged, and 0, if that is not possible."""
    triangles = TRIANGLES
    normals = np.unique(np.round(np.asarray(mesh.face_normals), 6) + 0.0, axis=0)
    if len(normals) < _FLAT * len(mesh.faces):
        return mesh, 0.0
    while 2 * triangles < len(mesh.faces):
        fewer = collapsed(mesh, triangles)
        if len(fewer.faces) == 0 or min(fewer.extents) <= 0:
            break
        some = np.ascontiguousarray(mesh.vertices[:: max(1, len(mesh.vertices) // SAMPLES)])
        if farthest(some, Surface.of(fewer), 0.0) <= limit:  # else the deviation is larger, too
            error = deviation(mesh, fewer)
            if error <= limit:
                return fewer, error
        triangles *= 4
    return mesh, 0.0


def _volume(shape: Shape) -> tuple[float, bool]:
    """Return the volume of a canonical mesh, and whether its surface is closed.

    Parts of the surface that face inwards are cavities, or bodies of their own; or one body holds
    the others. The signed volume of a surface that crosses itself is none that voxels can have,
    which fill cavities.
    """
    mesh = shape.mesh
    low, high = shape.volume_bounds
    if mesh.is_watertight and mesh.is_winding_consistent:
        total = float(mesh.volume)
        if low <= total <= high:
            return total, True
        a, b, c = np.asarray(mesh.triangles).transpose(1, 0, 2)
        numbers = part_numbers(np.asarray(mesh.faces), len(mesh.vertices))
        each = np.bincount(numbers, np.einsum("nd,nd->n", a, np.cross(b, c)) / 6)
        if low <= each[each > 0].sum() <= high:
            return total, True
        for volume in (np.abs(each).sum(), np.abs(each).max()):
            if low <= volume <= high:
                return float(volume), True
    return (low + high) / 2, False
