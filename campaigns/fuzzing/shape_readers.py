"""Readers of shapes: stored libraries, ShapeNet's taxonomy, and mesh files."""

from __future__ import annotations

import base64
import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh import creation

from campaigns.fuzzing import file_changes, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from packit_sim.core import typed_json
from packit_sim.core.errors import MeshError, PackItError
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries import mesh_files, stored
from packit_sim.libraries import step_files as step_reader
from packit_sim.libraries.gltf_files import INSTANCING
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.shapenet import TAXONOMY
from packit_sim.parts.reading.file_copies import FileCopies
from packit_sim.parts.results import reread_3mf
from tests import bad_meshes, slicer_projects, step_files

SEPARATOR = b"\n\x1e\n"
"""Between a catalogue and the splits."""

_SHAPE = "box/model0"


def _libraries() -> list[bytes]:
    path = world.library().path
    catalogue, splits = ((path / name).read_bytes() for name in (stored.CATALOGUE, "splits.json"))
    forged = catalogue.replace(world.library().digest.encode(), world.COMPUTED)
    return [SEPARATOR.join((one, splits)) for one in (catalogue, forged)]


def _read_library(data: bytes) -> None:
    catalogue, _, splits = data.partition(SEPARATOR)
    folder = world.written("forged/splits.json", splits).parent
    file = world.written("forged/library.json", catalogue)
    _link_meshes(folder)
    if world.COMPUTED in catalogue:
        with suppress(PackItError):
            file.write_bytes(catalogue.replace(world.COMPUTED, _digest(folder).encode()))
    library = ShapeLibrary.open(folder)
    for split in ("train", "test", "validation"):
        library.split(split)
    for id in library:
        with suppress(PackItError):
            _use(library[id])
        with suppress(PackItError):
            library.info(id)
    with suppress(PackItError):
        library["nothing"]


def _digest(folder: Path) -> str:
    """Return the digest that a catalogue and its splits should have."""
    content = stored._read(folder / stored.CATALOGUE, stored._Catalogue)
    infos = {info.id: info for info in content.shapes}
    return stored._digest(infos, stored._read_splits(folder / "splits.json", infos))


def _link_meshes(folder: Path) -> None:
    link = folder / "meshes"
    if not link.exists():
        link.symlink_to(world.library().path / "meshes")


def _stored_meshes() -> list[bytes]:
    path = world.library().path / "meshes"
    return [(path / f"{id}.npz").read_bytes() for id in world.library()]


def _read_stored_mesh(data: bytes) -> None:
    file = world.written(f"swapped/meshes/{_SHAPE}.npz", data)
    mesh = QuantizedMesh.load(file)
    digest = Shape(mesh.mesh(), _SHAPE, "box").digest
    info = world.library().info(_SHAPE)
    forged = typed_json.convert(
        typed_json.builtins(info) | {"digest": digest}, type(info), MeshError
    )
    divided = {"train": (_SHAPE,), "test": (), "validation": ()}
    infos = {_SHAPE: forged}
    world.written("swapped/library.json", stored._catalogue("x", "1", infos, divided).encode())
    folder = world.written(
        "swapped/splits.json", json.dumps({"format": stored.FORMAT, **divided}).encode()
    ).parent
    _use(ShapeLibrary.open(folder).source.load(_SHAPE))


def _use(shape: Shape) -> None:
    """Use a shape as every box does, as far as it is cheap."""
    shape.is_solid  # noqa: B018
    Item(shape, 0.001).cells  # noqa: B018


def _read_taxonomy(data: bytes) -> None:
    folder = world.written(f"shapenet/{TAXONOMY}", data).parent
    world.written("shapenet/02691156/a/model.obj", bad_meshes.OBJ.encode())
    world.written("shapenet/99999999/b/model.obj", bad_meshes.OBJ.encode())
    library = ShapeLibrary.open(f"shapenet:{folder}")
    for id in library:
        library[id]
    library.split("train")


def _taxonomies() -> list[bytes]:
    synset = {
        "synsetId": "99999999",
        "name": "thing,other thing",
        "children": [],
        "numInstances": 3,
    }
    return [json.dumps([synset, {**synset, "synsetId": "02691156"}]).encode()]


def _meshes(suffix: str) -> Callable[[], list[bytes]]:
    def seeds() -> list[bytes]:
        writers = {name: write for name, (write, _) in bad_meshes.BAD.items()} | bad_meshes.GOOD
        del writers["bomb.3mf"]  # far too large
        files = []
        with tempfile.TemporaryDirectory() as folder:
            for name, write in writers.items():
                if name.endswith(suffix):
                    write(Path(folder) / name)
                    files.append((Path(folder) / name).read_bytes())
            for name, (write, *_) in slicer_projects.PROJECTS.items() if suffix == ".3mf" else ():
                write(Path(folder) / name)
                files.append((Path(folder) / name).read_bytes())
        return [data for data in [*files, *_exported(suffix)] if len(data) < world.MAX_SEED]

    return seeds


def _exported(suffix: str) -> Iterator[bytes]:
    """Yield small meshes as trimesh writes them."""
    box, cone = creation.box((1, 2, 3)), creation.cone(1.0, 2.0, sections=5)
    scene = trimesh.Scene([box, cone])
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix((5, 0, 0)))
    if suffix == ".glb":
        yield _instanced(world.exported(box, "glb"))
    if suffix in step_reader.SUFFIXES:
        yield step_files.box((3, 2, 1)).encode()
        yield step_files.assembly().encode()
        return
    if suffix == ".gltf":
        yield from (_one_gltf(one) for one in (box, scene))
        return
    kind = suffix[1:]
    for one in (box, scene) if kind in ("glb", "3mf", "obj") else (box, cone):
        yield world.exported(one, kind)
    if kind == "stl":
        yield world.exported(cone, "stl_ascii")
    if kind == "ply":
        yield world.exported(cone, "ply", encoding="ascii")
        colored = trimesh.Trimesh(cone.vertices, cone.faces, vertex_colors=[9, 8, 7, 255])
        yield world.exported(colored, "ply")
    if kind == "obj":
        yield bad_meshes.OBJ.replace(
            "f 1 2 3", "vt 0 1\nvn 0 0 1\no a\nf 1/1/1 2/1/1 -1//1"
        ).encode()
    if kind == "off":
        faces = b"3 0 1 2\n3 0 1 3\n4 0 2 3 1\n3 1 2 3\n"
        yield b"OFF\n# words\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n" + faces


def _instanced(glb: bytes) -> bytes:
    """Return a GLB file of one mesh with two instances of it, at the places of its vertices."""
    length = int.from_bytes(glb[12:16], "little")
    header = json.loads(glb[20 : 20 + length])
    position = header["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    header["accessors"].append(header["accessors"][position] | {"count": 2})
    attributes = {"TRANSLATION": len(header["accessors"]) - 1}
    for node in header["nodes"]:
        if "mesh" in node:
            node["extensions"] = {INSTANCING: {"attributes": attributes}}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = glb[20 + length :]
    sizes = (20 + len(text) + len(rest)).to_bytes(4, "little"), len(text).to_bytes(4, "little")
    return glb[:8] + sizes[0] + sizes[1] + b"JSON" + text + rest


def _one_gltf(mesh: Any) -> bytes:
    """Write a glTF file with its buffers inside."""
    files = mesh.export(file_type="gltf")
    content = json.loads(files["model.gltf"])
    for buffer in content["buffers"]:
        data = base64.b64encode(files[buffer["uri"]]).decode()
        buffer["uri"] = f"data:application/octet-stream;base64,{data}"
    return json.dumps(content).encode()


def _read_plate(data: bytes) -> None:
    """Read each part of a 3MF file; the check's reader must find the same."""
    file = world.written("mesh/mesh.3mf", data)
    copy = FileCopies().add({file.name: data})
    for part in mesh_files.read_parts(file):
        triangles = reread_3mf.read_3mf(copy, part.node).triangles
        assert np.allclose(triangles, part.raw.mesh.triangles, rtol=1e-6, equal_nan=True)
    _read_mesh(".3mf")(data)


def _read_mesh(suffix: str) -> Callable[[bytes], None]:
    def read(data: bytes) -> None:
        file = world.written(f"mesh/mesh{suffix}", data)
        raw = mesh_files.read(file)
        if suffix in (".glb", ".gltf"):
            mesh_files.read_parts(file)
        _use(Shape.from_mesh(raw.mesh, "mesh", up=raw.up))

    return read


READERS = (
    Reader(
        "libraries",
        "libraries: catalogue and splits",
        _libraries,
        _read_library,
        file_changes.parts(SEPARATOR, json_tree),
    ),
    Reader(
        "library-meshes",
        "libraries: stored meshes",
        _stored_meshes,
        _read_stored_mesh,
        file_changes.archive(file_changes.npy),
    ),
    Reader("taxonomies", "ShapeNet's taxonomy", _taxonomies, _read_taxonomy, json_tree),
    *(
        Reader(
            suffix[1:],
            f"meshes: {suffix[1:].upper()}",
            _meshes(suffix),
            _read_plate if suffix == ".3mf" else _read_mesh(suffix),
            mutator,
            20.0 if suffix == ".step" else 2.0,
        )
        for suffix, mutator in {
            ".3mf": file_changes.archive(file_changes.tokens),
            ".dae": file_changes.tokens,
            ".glb": file_changes.glb,
            ".gltf": json_tree,
            ".obj": file_changes.tokens,
            ".off": file_changes.tokens,
            ".ply": file_changes.tokens,
            ".step": file_changes.tokens,
            ".stl": file_changes.tokens,
        }.items()
    ),
)
"""The readers of this module."""
