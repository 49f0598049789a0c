"""Export of packed boxes to other tools: GLB, 3MF, STL, and JSON with meshes and poses."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh
from trimesh.exchange.ply import export_ply
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from packit_sim.core.errors import ArgumentError, RenderError
from packit_sim.core.files import require_same
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.items import Contents, ItemInBox
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.shapes import Shape
from packit_sim.render.coloring import Color, Coloring, by_item, hexadecimal
from packit_sim.render.defaults import UNIT_MM
from packit_sim.render.export_3mf import PlacedMesh, encode_3mf
from packit_sim.render.image_files import output_file
from packit_sim.render.lettering import plain

BOX = "box"
"""The name of the node above the items in a GLB: its frame is the box's."""

Y_UP = np.array(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)), dtype=float)
"""Maps the box's axes to glTF's, whose y is up."""

_GAMMA = 2.2
"""The gamma of screens: glTF's colours are linear."""


def export(
    box: Contents[ItemInBox],
    path: str | os.PathLike[str],
    *,
    coloring: Coloring = by_item,
    unit_mm: float = UNIT_MM,
) -> None:
    """Write a box, completely or not at all, in the format of the path's suffix.

    Parameters
    ----------
    coloring : Coloring
        The rule that gives items their colours in a GLB.
    unit_mm : float
        Millimetres per box unit in 3MF and STL.

    Raises
    ------
    RenderError
        If the suffix is unknown, the box is empty or the file cannot be written.
    ArgumentError
        If the unit is not above 0, or a mesh would replace a file with another content.

    Notes
    -----
    .glb: a node for each item, below one named "box", with its pose as matrix and its colour; a box
    unit is a metre. .3mf: an object for each shape and an item for each placed one. .stl: all items
    as one mesh, binary. .json: a packing as `packit verify` reads it, with poses as (4, 4) matrices
    and a PLY file of each canonical mesh in the folder NAME-meshes next to it; lengths are in box
    units. Items are named by their number in the order of placing and their shape, "03 mug-2".
    """
    path = Path(path)
    require(path)
    if not box.placed:
        raise RenderError(f"an empty box can't be exported to {path}: it has no items")
    if not 0 < unit_mm < np.inf:
        raise ArgumentError(f"a unit of {unit_mm!r} mm is not possible: it must be above 0")
    suffix = path.suffix.lower()
    if suffix == ".json":
        _write_packing(box, path)
        return
    data = _glb(box, coloring) if suffix == ".glb" else _PRINTED[suffix](box.placed, unit_mm)
    with output_file(path) as file:
        file.write(data)


def require(path: Path | str) -> None:
    """Raise RenderError if the path's suffix names no format; call it before long work."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise RenderError(
            f"{path} is no export: choose a name that ends in {', '.join(SUFFIXES[:-1])} "
            f"or {SUFFIXES[-1]}"
        )


def names(placed: Sequence[ItemInBox]) -> list[str]:
    """Return a unique ASCII name for each item."""
    digits = max(2, len(str(len(placed) - 1)))
    return [f"{n:0{digits}d} {plain(p.item.shape.id)}" for n, p in enumerate(placed)]


def _glb(box: Contents[ItemInBox], coloring: Coloring) -> bytes:
    scene = trimesh.Scene()
    scene.graph.update(frame_from=scene.graph.base_frame, frame_to=BOX, matrix=Y_UP)
    colors = coloring([placed.item for placed in box.placed]).of
    for name, placed, color in zip(names(box.placed), box.placed, colors, strict=True):
        shape = placed.item.shape
        mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
        mesh.visual = TextureVisuals(material=material(color))
        own = f"{_mesh_name(shape)} {hexadecimal(color)}"
        if own in scene.geometry:
            scene.graph.update(frame_from=BOX, frame_to=name, matrix=placed.matrix, geometry=own)
        else:
            scene.add_geometry(mesh, name, own, parent_node_name=BOX, transform=placed.matrix)
    scene.metadata["cells"] = list(box.cells)
    return bytes(scene.export(file_type="glb"))


def _3mf(placed: Sequence[ItemInBox], unit_mm: float) -> bytes:
    poses = _poses_mm(placed, unit_mm)
    return encode_3mf(
        PlacedMesh(name, _mesh_name(one.item.shape), *_arrays(one.item.shape), pose)
        for name, one, pose in zip(names(placed), placed, poses, strict=True)
    )


def _arrays(shape: Shape) -> tuple[Floats, Ints]:
    return np.asarray(shape.mesh.vertices), np.asarray(shape.mesh.faces, dtype=np.int64)


def _stl(placed: Sequence[ItemInBox], unit_mm: float) -> bytes:
    scene = trimesh.Scene()
    for one, pose in zip(placed, _poses_mm(placed, unit_mm), strict=True):
        scene.add_geometry(one.item.shape.mesh, transform=pose)
    return bytes(scene.to_mesh().export(file_type="stl"))


def _write_packing(box: Contents[ItemInBox], path: Path) -> None:
    folder = path.with_name(f"{path.stem}-meshes")
    files = {}
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise RenderError(f"meshes can't be written to {folder}: {error.strerror}") from error
    for placed in box.placed:
        shape = placed.item.shape
        file = folder / f"{shape.digest[:16]}.ply"
        if shape.digest not in files:
            content = export_ply(shape.mesh, vertex_normal=False)
            require_same(file, content)
            with output_file(file) as out:
                out.write(content)
        files[shape.digest] = f"{folder.name}/{file.name}"
    items = [
        {
            "name": name,
            "shape": placed.item.shape.id,
            "mesh": files[placed.item.shape.digest],
            "pose": placed.matrix.tolist(),
        }
        for name, placed in zip(names(box.placed), box.placed, strict=True)
    ]
    extents = (np.array(box.cells) * CELL).tolist()
    packing = {"box": extents, "unit": "box", "items": items}
    with output_file(path) as out:
        out.write((json.dumps(packing, indent=1, ensure_ascii=False) + "\n").encode())


def _poses_mm(placed: Sequence[ItemInBox], unit_mm: float) -> Iterator[npt.NDArray[np.float64]]:
    for one in placed:
        yield np.diag((unit_mm, unit_mm, unit_mm, 1.0)) @ one.matrix


def _mesh_name(shape: Shape) -> str:
    """Return a unique name for any id of a shape."""
    return f"{plain(shape.id)} {shape.digest[:8]}"


def material(color: Color) -> PBRMaterial:
    """Return a dull material of a colour, whose numbers are as on a screen."""
    light = [channel**_GAMMA for channel in color]
    return PBRMaterial(
        baseColorFactor=[*light, 1.0], metallicFactor=0.0, roughnessFactor=0.7, doubleSided=True
    )


_PRINTED: dict[str, Callable[[Sequence[ItemInBox], float], bytes]] = {".3mf": _3mf, ".stl": _stl}

SUFFIXES = (".glb", *_PRINTED, ".json")
"""Suffixes of the formats."""
