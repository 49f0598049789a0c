"""Files of strip-packing instances and their solutions, in the format of ESICUP's data.

Both are JSON. An instance has a base and mesh files with demands; no rotations, which each paper
chooses. A solution is what sparrow-3d writes.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, MeshError, PackFormatError, located
from packit_sim.core.files import replace_text, require_same
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import split
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.packings.bounds import Extent, PoseRows
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.mesh_paths import file_inside, is_inside, root_of
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.packing_files import obj_text
from packit_sim.parts.packings.placements import Placement

__all__ = [
    "instances_in",
    "read_instance",
    "read_solution",
    "require_free_instance",
    "write_instance",
    "write_solution",
]

MAX_ITEMS = 100_000
"""Most items of an instance."""

MAX_FILES = 10_000
"""Most files of a folder that are searched for instances."""

ItemOrigin = Literal["Original", "AlignToMinimum", "AlignToCenter"]

ITEM_ORIGINS: tuple[ItemOrigin, ...] = get_args(ItemOrigin)
"""The points of a mesh that may be the origin for its poses in a solution."""


def instances_in(folder: Path | str) -> list[Path]:
    """Find the instances in a folder and the folders in it.

    Returns
    -------
    list of Path
        The files, sorted; JSON files of anything else are left out.
    """
    found = []
    for file in sorted(islice(Path(folder).rglob("*.json"), MAX_FILES)):
        with suppress(PackFormatError):
            typed_json.decode(read_bytes(file), _Instance, PackFormatError, "an instance")
            found.append(file)
    return found


def read_instance(
    path: Path | str, rotations: str = "cube"
) -> tuple[tuple[ItemType, ...], BoxContainer]:
    """Read a strip-packing instance.

    Parameters
    ----------
    path : Path or str
        The JSON file. The paths of its meshes start in its folder or in one above it.
    rotations : str
        The rotations that each item may take.

    Returns
    -------
    types : tuple of ItemType
        The types of items, named after their mesh files.
    container : BoxContainer
        The strip.

    Raises
    ------
    PackFormatError
        If the file is not of this form; the message names the file and the field.
    MeshError
        If a mesh can't be used.
    """
    path = Path(path)
    data = read_bytes(path)
    with located(path, PackFormatError):
        instance = typed_json.decode(data, _Instance, PackFormatError, "an instance")
        count = sum(item_type.demand for item_type in instance.item_types)
        if count > MAX_ITEMS:
            raise PackFormatError(f"{count:,} items are too many: at most {MAX_ITEMS:,}")
        root = _root(path, "item-types[0].path", instance.item_types[0].path)
        for n, item_type in enumerate(instance.item_types):
            _check_inside(f"item-types[{n}].path", item_type.path)
    load = cache(lambda mesh: ItemType.from_file(file_inside(root, mesh), rotations=rotations))
    types = []
    for n, item_type in enumerate(instance.item_types):
        with located(f"{path}: field 'item-types[{n}].path'", MeshError):
            types.append(load(item_type.path).changed(item_type.demand))
    size = instance.container
    return tuple(types), BoxContainer((size.size_x, size.size_y, math.inf))


def read_solution(path: Path | str, rotations: str = "cube") -> Packing:
    """Read a solution of an instance.

    Parameters
    ----------
    path : Path or str
        The JSON file. The path of its instance starts in its folder or in one above it.
    rotations : str
        The rotations that each item may take.

    Returns
    -------
    Packing
        The packing, as its matrices describe it; it may have problems.

    Raises
    ------
    PackFormatError
        If the file is not of this form, or a pose or name is not possible.
    MeshError
        If a mesh can't be used.
    """
    path = Path(path)
    data = read_bytes(path)
    with located(path, PackFormatError):
        solution = typed_json.decode(data, _Solution, PackFormatError, "a solution")
        root = _root(path, "instancePath", solution.instance_path)
    types, container = read_instance(file_inside(root, solution.instance_path), rotations)
    by_name: defaultdict[str, list[int]] = defaultdict(list)
    for number, item_type in enumerate(types):
        by_name[item_type.name] += [number] * item_type.demand
    placements = []
    for n, item in enumerate(solution.items):
        if not by_name[item.name]:
            raise PackFormatError(
                f"{path}: field 'items[{n}].name' is {item.name!r}: "
                "the instance has no such item, or not as many"
            )
        number = by_name[item.name].pop(0)
        try:
            pose = np.array(item.transformation.matrix).T  # column by column, as glm stores it
            linear, place = split(pose)
            place -= linear @ _origin(types[number], solution.item_origin)
            placements.append(Placement.from_matrix(number, pose))
        except ArgumentError as error:
            raise PackFormatError(f"{path}: field 'items[{n}].transformation': {error}") from None
    return Packing(types, container, tuple(placements))


def write_instance(types: Sequence[ItemType], container: BoxContainer, path: Path | str) -> None:
    """Write an instance, and its meshes in a folder of the same name next to it.

    Parameters
    ----------
    types : sequence of ItemType
        The types of items. Their meshes are written as OBJ, without rounding, each in a file of
        the type's name.
    container : BoxContainer
        The strip.
    path : Path or str
        The JSON file, NAME.json; it is written last.

    Raises
    ------
    ArgumentError
        If the file's name does not end in .json, two types have the same name, apart from its
        suffix, or a mesh would replace a file with another content.
    OSError
        If a file can't be written.
    """
    path = Path(path)
    if path.suffix != ".json":
        raise ArgumentError(f"{path} is not possible for an instance: choose a .json file")
    names = require_free_instance(types, path)
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    for name, item_type in zip(names, types, strict=True):
        replace_text(folder / name, obj_text(item_type.vertices, item_type.faces))
    x, y, _ = container.size
    instance = {
        "name": path.stem,
        "container": {"size-x": x, "size-y": y},
        "item-types": [
            {"path": f"{folder.name}/{name}", "demand": item_type.demand}
            for name, item_type in zip(names, types, strict=True)
        ],
    }
    replace_text(path, json.dumps(instance, indent=1, ensure_ascii=False) + "\n")


def require_free_instance(types: Sequence[ItemType], path: Path) -> list[str]:
    """Return the names of an instance's meshes.

    Returns
    -------
    list of str
        That of each type, in the folder next to the instance.

    Raises
    ------
    ArgumentError
        If two are the same, or one is that of a file with another content.
    """
    names = [re.sub(r"[^\w.-]", "-", Path(each.name).stem) + ".obj" for each in types]
    if len({name.casefold() for name in names}) < len(names):
        raise ArgumentError(f"the names of item types are not different: {', '.join(names)}")
    for name, each in zip(names, types, strict=True):
        file = path.with_suffix("") / name
        if os.path.lexists(file):
            require_same(file, obj_text(each.vertices, each.faces).encode())
    return names


def write_solution(packing: Packing, path: Path | str, instance: str = "") -> None:
    """Write a packing of a strip as a solution, whole or not at all.

    Parameters
    ----------
    path : Path or str
        The JSON file.
    instance : str
        The path of the instance's file, from the folder that the paths of its meshes start in.

    Raises
    ------
    OSError
        If the file can't be written.
    """
    items = []
    for placement in packing.placements:
        item_type, pose = packing.types[placement.type], placement.pose
        yaw, pitch, roll = _angles(pose.rotation)
        transformation = {
            "position": pose.translation.tolist(),
            "yaw": yaw,
            "pitch": pitch,
            "roll": roll,
            "matrix": placement.matrix.T.tolist(),
        }
        name = item_type.name if item_type.file is None else item_type.file.name
        items.append({"name": name, "transformation": transformation})
    solution = {
        "instancePath": instance,
        "totalHeight": packing.height,
        "itemOrigin": "Original",
        "items": items,
    }
    replace_text(Path(path), json.dumps(solution, indent=1, ensure_ascii=False) + "\n")


def _origin(item_type: ItemType, name: ItemOrigin) -> Floats:
    """Return the point (3,) of a mesh that is the origin for the poses of a solution."""
    if name == "AlignToMinimum":
        return item_type.low
    if name == "AlignToCenter":
        return (item_type.low + item_type.high) / 2
    return np.zeros(3)


def _angles(turn: Floats) -> tuple[float, float, float]:
    """Return yaw, pitch and roll, in radians: of turns about z, then y, then x."""
    across = math.hypot(turn[0, 0], turn[0, 1])
    pitch = math.atan2(turn[0, 2], across)
    if across < 1e-9:  # yaw and roll turn about the same axis
        return math.atan2(turn[1, 0], turn[1, 1]), pitch, 0.0
    yaw, roll = math.atan2(-turn[0, 1], turn[0, 0]), math.atan2(-turn[1, 2], turn[2, 2])
    return yaw, pitch, roll


def _root(file: Path, field: str, path: str) -> Path:
    _check_inside(field, path)
    root = root_of(file, path)
    if root is None:
        raise PackFormatError(
            f"field {field!r} is {path!r}: no such file, from the folder of this one or one above"
        )
    return root


def _check_inside(field: str, path: str) -> None:
    if not is_inside(path):
        raise PackFormatError(f"field {field!r} is {path!r}: it must be a relative path without ..")


class _Base(Struct, rename="kebab"):
    size_x: Extent
    size_y: Extent


class _InstanceItem(Struct):
    path: str
    demand: Annotated[int, Meta(ge=1, le=MAX_ITEMS)]


class _Instance(Struct, rename="kebab"):
    """The content of an instance's file; other fields are ignored."""

    container: _Base
    item_types: Annotated[tuple[_InstanceItem, ...], Meta(min_length=1, max_length=MAX_ITEMS)]
    name: str = ""
    comment: str = ""


class _Transformation(Struct):
    matrix: PoseRows


class _SolutionItem(Struct):
    name: str
    transformation: _Transformation


class _Solution(Struct, rename="camel"):
    """The content of a solution's file; other fields are ignored."""

    instance_path: str
    items: Annotated[tuple[_SolutionItem, ...], Meta(min_length=1, max_length=MAX_ITEMS)]
    item_origin: ItemOrigin = "Original"
