"""The parts of 3MF files: plates, on which each item of the build is a rigid part."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.libraries import mesh_limits
from packit_sim.libraries.model_3mf import Item3MF, Object3MF, read_model
from packit_sim.libraries.outline_3mf import read_outline
from packit_sim.libraries.raw_meshes import RawMesh, RawPart
from packit_sim.libraries.slicer_settings import ObjectSettings, read_settings

_MOST_NAMES = 3
"""Most names in a note."""


@dataclass(frozen=True, eq=False)
class PlatePart:
    """Items of a build that differ at most by a translation.

    Attributes
    ----------
    name : str
        The name of the first item's object, or "".
    item : int
        The number of the first item in the build, from 1.
    vertices, triangles : numpy.ndarray
        The mesh where the first item is, (n, 3) each.
    shifts : list of numpy.ndarray
        The translation (3,) from there to each item.
    """

    name: str
    item: int
    vertices: Floats
    triangles: Ints
    shifts: list[Floats] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Plate:
    """The solid parts to be printed of a 3MF file, its unit in cm, and notes for the user."""

    parts: tuple[PlatePart, ...]
    unit_cm: float
    notes: tuple[str, ...]

    def joined(self) -> RawMesh:
        """Join all items."""
        items = [(part, shift) for part in self.parts for shift in part.shifts]
        meshes = [
            trimesh.Trimesh(each.vertices + shift, each.triangles, process=False)
            for each, shift in items
        ]
        joined: Any = trimesh.util.concatenate(meshes)
        return self._raw(joined, len(meshes))

    def separate(self) -> list[RawPart]:
        """Return each part; several without a name are numbered as in the file."""
        is_only = len(self.parts) == 1
        return [
            RawPart(
                part.name or ("" if is_only else str(part.item)),
                self._raw(trimesh.Trimesh(part.vertices, part.triangles, process=False)),
                len(part.shifts),
                str(part.item),
            )
            for part in self.parts
        ]

    def _raw(self, mesh: trimesh.Trimesh, parts: int = 1) -> RawMesh:
        return RawMesh(mesh, "z", self.unit_cm, parts, self.notes)


def read_plate(content: bytes) -> Plate:
    """Read a 3MF file.

    Returns
    -------
    Plate
        Its parts, with the transforms of items and components. Left out, with a note, are items
        that are marked as not printable, supports and surfaces, and what slicers keep next to
        solids: modifiers, support blockers and the like.

    Raises
    ------
    MeshError
        If the file can't be read, has too many triangles, or no part.
    """
    outline = read_outline(content)
    model = read_model(outline, content)
    by_id = read_settings(outline.archive)
    if model.degenerate and any(each.triangles for each in by_id.values()):
        raise MeshError("triangles with fewer than three corners hide where its modifiers begin")
    settings = {
        key: by_id.get(each.id or 0, ObjectSettings()) for key, each in model.objects.items()
    }
    names = {key: settings[key].name or each.name for key, each in model.objects.items()}
    solids = {
        key: _solid(each, settings[key], model.objects) for key, each in model.objects.items()
    }
    totals = mesh_limits.check_expanded(
        {key: len(each.triangles) for key, each in solids.items()},
        {key: [part for part, _ in each.components] for key, each in solids.items()},
        [item.key for item in model.items],
    )
    shown: dict[int, Item3MF] = {}
    hidden: list[str] = []
    others: list[str] = []
    for number, item in enumerate(model.items, 1):
        name = names[item.key] or f"item {number}"
        if not item.is_printable:
            hidden.append(name)
        elif not totals[item.key]:
            others.append(name)
        else:
            shown[number] = item
    changed = [names[key] for key, own in solids.items() if _differs(own, key, model.objects)]
    negative = [names[key] for key, own in settings.items() if own.negative]
    notes = [
        *model.notes,
        *_note(hidden, "marked as not printable, left out"),
        *_note(others, "no solid (supports, surfaces or modifiers), left out"),
        *_note(changed, "without their modifiers and support volumes"),
        *_note(negative, "solid also where the slicer cuts volumes out"),
    ]
    if not shown:
        raise MeshError(f"it has no part to print{''.join(f': {each}' for each in notes)}")
    return Plate(_counted(shown, solids, names, totals), model.unit_cm, tuple(notes))


def _counted(
    items: Mapping[int, Item3MF],
    objects: Mapping[int, Object3MF],
    names: Mapping[int, str],
    totals: Mapping[int, int],
) -> tuple[PlatePart, ...]:
    """Join the meshes of each item, and count those that differ at most by a translation."""
    meshes: dict[int, tuple[Floats, Ints, bytes]] = {}
    found: dict[tuple[bytes, bytes], PlatePart] = {}
    for number, item in items.items():
        if item.key not in meshes:
            vertices, faces = _joined(objects, item.key, totals)
            digest = hashlib.sha256(vertices.tobytes() + faces.tobytes()).digest()
            meshes[item.key] = vertices, faces, digest
        vertices, faces, digest = meshes[item.key]
        key = digest, (item.matrix[:3, :3] + 0.0).tobytes()
        if key not in found:
            mesh = _moved(vertices, faces, item.matrix)
            found[key] = PlatePart(names[item.key], number, *mesh)
        first = items[found[key].item]
        found[key].shifts.append(item.matrix[:3, 3] - first.matrix[:3, 3])
    return tuple(found.values())


def _solid(own: Object3MF, settings: ObjectSettings, objects: Mapping[int, Object3MF]) -> Object3MF:
    """Return an object without what is not solid in it."""
    if own.kind != "model":
        return replace(own, triangles=own.triangles[:0], components=())
    size = len(own.triangles)
    changes = np.zeros(size + 1, dtype=np.int64)  # slices may be many, and overlap
    for each in settings.triangles:
        start, stop, _ = each.indices(size)
        if start < stop:
            changes[start] += 1
            changes[stop] -= 1
    kept = np.cumsum(changes[:size]) == 0
    components = tuple(
        (key, place)
        for key, place in own.components
        if objects[key].file_id not in settings.components
    )
    return replace(own, triangles=own.triangles[kept], components=components)


def _joined(
    objects: Mapping[int, Object3MF], key: int, totals: Mapping[int, int]
) -> tuple[Floats, Ints]:
    """Join the meshes of an object and of all its components."""
    meshes: list[tuple[Floats, Ints]] = []
    waiting = [(key, np.eye(4))]
    while waiting:
        key, matrix = waiting.pop()
        own = objects[key]
        if len(own.triangles):
            meshes.append(_moved(own.vertices, own.triangles, matrix))
        waiting += [
            (part, matrix @ place) for part, place in reversed(own.components) if totals[part]
        ]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [own + start for (_, own), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _moved(vertices: Floats, triangles: Ints, matrix: Floats) -> tuple[Floats, Ints]:
    """Return a mesh at a place; a mirrored one still has its outside outside."""
    linear = matrix[:3, :3]
    sign = np.linalg.det(linear)
    if not (np.isfinite(matrix).all() and sign):
        raise MeshError(f"the transform {matrix[:3].T.round(6).tolist()} flattens its object")
    return vertices @ linear.T + matrix[:3, 3], triangles if sign > 0 else triangles[:, ::-1]


def _differs(solid: Object3MF, key: int, objects: Mapping[int, Object3MF]) -> bool:
    """Return whether an object has volumes that are not solid."""
    own = objects[key]
    kinds = {objects[part].kind for part, _ in own.components}
    return own.kind == "model" and (
        len(own.triangles) != len(solid.triangles)
        or len(own.components) != len(solid.components)
        or bool(kinds - {"model"})
    )


def _note(names: Sequence[str], what: str) -> Iterator[str]:
    """Yield a sentence on some items or objects, if there are any."""
    if names:
        first = ", ".join(repr(name) for name in dict.fromkeys(names[:_MOST_NAMES]))
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        yield f"{what}: {first}{more}"
