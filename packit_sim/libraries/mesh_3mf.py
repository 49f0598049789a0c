"""The parts of 3MF files: plates, on which each item of the build is a rigid part."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from packit_sim.core.errors import MeshError
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.libraries import mesh_limits
from packit_sim.libraries.model_3mf import Object3MF, read_model
from packit_sim.libraries.outline_3mf import read_outline
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
    settings = read_settings(outline.archive)
    if model.degenerate and any(each.triangles for each in settings.values()):
        raise MeshError("triangles with fewer than three corners hide where its modifiers begin")
    names = _names(model.objects, settings)
    objects = {
        key: _solid(each, settings.get(each.id or 0, ObjectSettings()), model.objects)
        for key, each in model.objects.items()
    }
    triangles = mesh_limits.check_expanded(
        {key: len(each.triangles) for key, each in objects.items()},
        {key: [part for part, _ in each.components] for key, each in objects.items()},
        [item.key for item in model.items],
    )
    found: dict[object, PlatePart] = {}
    meshes: dict[int, tuple[Floats, Ints, bytes]] = {}
    hidden, others = [], []
    for number, item in enumerate(model.items, 1):
        name = names[item.key]
        if not (item.is_printable and triangles[item.key]):
            left_out = others if item.is_printable else hidden
            left_out.append(name or f"item {number}")
            continue
        if item.key not in meshes:
            mesh = _joined(objects, item.key, triangles)
            digest = hashlib.sha256(mesh[0].tobytes() + mesh[1].tobytes()).digest()
            meshes[item.key] = *mesh, digest
        vertices, faces, digest = meshes[item.key]
        key = digest, (item.matrix[:3, :3] + 0.0).tobytes()
        if key not in found:
            found[key] = PlatePart(name, number, *_moved(vertices, faces, item.matrix))
            found[key].shifts.append(np.zeros(3))
        else:
            first = model.items[found[key].item - 1]
            found[key].shifts.append(item.matrix[:3, 3] - first.matrix[:3, 3])
    notes = [
        *model.notes,
        *_note(hidden, "marked as not printable, left out"),
        *_note(others, "no solid (supports, surfaces or modifiers), left out"),
        *_volumes(model.objects, objects, settings, names),
    ]
    if not found:
        raise MeshError(f"it has no part to print{''.join(f': {each}' for each in notes)}")
    return Plate(tuple(found.values()), model.unit_cm, tuple(notes))


def _names(
    objects: Mapping[int, Object3MF], settings: Mapping[int, ObjectSettings]
) -> dict[int, str]:
    """Return the name of each object, the slicer's if it wrote one."""
    return {
        key: settings.get(each.id or 0, ObjectSettings()).name or each.name
        for key, each in objects.items()
    }


def _solid(own: Object3MF, settings: ObjectSettings, objects: Mapping[int, Object3MF]) -> Object3MF:
    """Return an object without what is not solid in it."""
    if own.kind != "model":
        return replace(own, triangles=own.triangles[:0], components=())
    kept = np.ones(len(own.triangles), dtype=bool)
    for each in settings.triangles:
        kept[each] = False
    components = tuple(
        (key, place)
        for key, place in own.components
        if objects[key].file_id not in settings.components
    )
    return replace(own, triangles=own.triangles[kept], components=components)


def _joined(
    objects: Mapping[int, Object3MF], key: int, triangles: Mapping[int, int]
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
            (part, matrix @ place) for part, place in reversed(own.components) if triangles[part]
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


def _volumes(
    objects: Mapping[int, Object3MF],
    solid: Mapping[int, Object3MF],
    settings: Mapping[int, ObjectSettings],
    names: Mapping[int, str],
) -> Iterator[str]:
    """Yield notes on the volumes of objects that are no solids."""
    changed = [
        names[key]
        for key, own in objects.items()
        if own.kind == "model"
        and (
            len(own.triangles) != len(solid[key].triangles)
            or any(objects[part].kind != "model" for part, _ in own.components)
            or len(own.components) != len(solid[key].components)
        )
    ]
    yield from _note(changed, "without their modifiers and support volumes")
    negative = [
        names[key]
        for key, own in objects.items()
        if settings.get(own.id or 0, ObjectSettings()).negative
    ]
    yield from _note(negative, "solid also where the slicer cuts volumes out")


def _note(names: Sequence[str], what: str) -> Iterator[str]:
    """Yield a sentence on some items or objects, if there are any."""
    if names:
        first = ", ".join(repr(name) for name in dict.fromkeys(names[:_MOST_NAMES]))
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        yield f"{what}: {first}{more}"
