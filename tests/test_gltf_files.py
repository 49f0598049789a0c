"""glTF: copies, instances, and what is refused because it would change the geometry in silence."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh import creation, transformations

from packit_sim.core.errors import MeshError
from packit_sim.libraries.mesh_files import read, read_parts
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.reading.file_copies import FileCopies, FileCopy
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.results import exports
from packit_sim.parts.results.check import check
from packit_sim.parts.results.reread_scenes import read_scene

BLOCK = creation.box((0.03, 0.02, 0.01))
Header = dict[str, Any]


def copied(file: Path) -> FileCopy:
    return FileCopies().add({file.name: file.read_bytes()})


def glb(scene: trimesh.Scene) -> tuple[Header, bytearray]:
    content = scene.export(file_type="glb")
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), bytearray(content[28 + length :])


def write(file: Path, header: Header, binary: bytes) -> Path:
    header["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + bytes(binary)
    file.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    return file


def block() -> tuple[Header, bytearray]:
    scene = trimesh.Scene()
    scene.add_geometry(BLOCK, geom_name="block", node_name="b")
    return glb(scene)


def add(header: Header, binary: bytearray, values: np.ndarray, stride: int = 0) -> int:
    """Add an accessor for values (n, width)."""
    kinds = {"float32": 5126, "int8": 5120, "int16": 5122}
    rows = [row.tobytes().ljust(stride, b"\xee") for row in values]
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": sum(map(len, rows))}
    header["bufferViews"].append(view | ({"byteStride": stride} if stride else {}))
    binary += b"".join(rows)
    binary += b"\0" * (-len(binary) % 4)
    accessor = {
        "bufferView": len(header["bufferViews"]) - 1,
        "componentType": kinds[str(values.dtype)],
        "count": len(values),
        "type": f"VEC{values.shape[1]}",
        "normalized": values.dtype != np.float32,
    }
    header["accessors"].append(accessor)
    return len(header["accessors"]) - 1


def instanced(file: Path, count: int = 5, **attributes: np.ndarray) -> Path:
    header, binary = block()
    if not attributes:
        attributes["TRANSLATION"] = np.zeros((count, 3), np.float32)
        attributes["TRANSLATION"][:, 0] = 0.05 * np.arange(count)
    numbers = {name: add(header, binary, values) for name, values in attributes.items()}
    node = next(node for node in header["nodes"] if "mesh" in node)
    node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": numbers}}
    header["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    return write(file, header, binary)


def copies(file: Path, count: int) -> Path:
    header, binary = block()
    node = next(node for node in header["nodes"] if "mesh" in node)
    header["nodes"] = [
        {"mesh": node["mesh"], "name": f"b{n}", "translation": [0.05 * n, 0, 0]}
        for n in range(count)
    ]
    header["scenes"][0]["nodes"] = list(range(count))
    return write(file, header, binary)


@pytest.mark.parametrize("make", [copies, instanced])
@pytest.mark.parametrize("count", [10, 100, 1000])
def test_copies_are_counted(tmp_path: Path, make: Callable[..., Path], count: int) -> None:
    (part,) = read_parts(make(tmp_path / "blocks.glb", count))
    assert part.count == count and part.raw.mesh.extents == pytest.approx(BLOCK.extents)
    assert read(tmp_path / "blocks.glb").mesh.volume == pytest.approx(count * BLOCK.volume)


@pytest.mark.parametrize("make", [copies, instanced])
def test_too_many_copies_are_refused(tmp_path: Path, make: Callable[..., Path]) -> None:
    with pytest.raises(MeshError, match="30,000 instances of objects are too many: at most 2,000"):
        read(make(tmp_path / "blocks.glb", 30_000))


@pytest.mark.parametrize("make", [copies, instanced])
def test_copies_are_packed_and_verified(
    tmp_path: Path, make: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    settings = PackSettings(workers=1, iterations=20, reading=ReadSettings(split=True))
    out = tmp_path / "out"
    packed = pack([make(tmp_path / "b.glb", 10)], "100x100x20mm", out=out, settings=settings)
    assert packed.count == 10 and check(packed).problems == ()
    assert verify_packing(out / "packing.json").is_valid
    assert len(list((out / "meshes").iterdir())) == 1


def test_points_beside_a_mesh_are_no_part(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for name, geometry in (("a", BLOCK), ("b", BLOCK), ("c", trimesh.PointCloud(np.eye(3)))):
        scene.add_geometry(geometry, node_name=name, geom_name=name)
    file = tmp_path / "both.glb"
    file.write_bytes(scene.export(file_type="glb"))
    for part in read_parts(file):
        again = read_scene(part, copied(file), ".glb")  # type: ignore[arg-type]
        assert again.extents == pytest.approx(BLOCK.extents)


@pytest.mark.parametrize("missing", ["ROTATION", "TRANSLATION", "SCALE"])
def test_the_check_reads_instances_without_some_attributes(tmp_path: Path, missing: str) -> None:
    attributes = {
        "ROTATION": np.array([[0, 0, np.sqrt(0.5), np.sqrt(0.5)]], np.float32),
        "TRANSLATION": np.array([[1, 2, 3]], np.float32),
        "SCALE": np.array([[1, 2, 3]], np.float32),
    }
    del attributes[missing]
    file = instanced(tmp_path / "block.glb", **attributes)
    (part,) = read_parts(file)
    again = read_scene(part, copied(file), ".glb")  # type: ignore[arg-type]
    assert again.extents == pytest.approx(part.raw.mesh.extents, abs=1e-7)


def test_all_attributes_of_instances_are_read(tmp_path: Path) -> None:
    """Rotations may be floats, bytes or shorts; equal ones are counted, in one orientation."""
    half = np.sqrt(0.5)
    floats = np.array([[0, 0, 0, 1], [0, 0, half, half], [0, 0, 0, 1]], np.float32)
    shift = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32)
    scale = np.array([[1, 1, 1], [1, 1, 2], [1, 1, 1]], np.float32)
    expected = [BLOCK.copy() for _ in range(3)]
    for mesh, x, turn, size in zip(expected, shift, floats, scale, strict=True):
        mesh.apply_scale(size)
        mesh.apply_transform(transformations.quaternion_matrix(turn[[3, 0, 1, 2]]))
        mesh.apply_translation(x)
    bounds = trimesh.util.concatenate(expected).bounds
    for kind, one in (("float32", 1), ("int8", 127), ("int16", 32767)):
        turns = np.round(floats * one).astype(kind) if one > 1 else floats
        file = tmp_path / f"{kind}.glb"
        instanced(file, ROTATION=turns, TRANSLATION=shift, SCALE=scale)
        raw = read(file)
        assert raw.parts == 3 and raw.mesh.bounds == pytest.approx(bounds, abs=1e-4), kind
        found = read_parts(file)
        assert sorted(part.count for part in found) == [1, 2]
        for each in found:  # the check finds the same, by itself
            again = read_scene(each, copied(file), ".glb")  # type: ignore[arg-type]
            assert again.bounds == pytest.approx(each.raw.mesh.bounds, abs=1e-7)


def test_strided_attributes_and_files_with_buffers_inside_are_read(tmp_path: Path) -> None:
    header, binary = block()
    shift = np.array([[0, 0, 0], [1, 0, 0]], np.float32)
    number = add(header, binary, shift, stride=20)
    node = next(node for node in header["nodes"] if "mesh" in node)
    node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": number}}}
    assert read(write(tmp_path / "b.glb", header, binary)).mesh.extents[0] == pytest.approx(1.03)
    (tmp_path / "b.bin").write_bytes(binary)
    header["buffers"][0]["uri"] = "b.bin"
    (tmp_path / "b.gltf").write_text(json.dumps(header))
    assert read(tmp_path / "b.gltf").mesh.extents[0] == pytest.approx(1.03)


def test_a_node_of_several_materials_is_one_part_and_its_copies_are_counted(
    tmp_path: Path,
) -> None:
    header, binary = block()
    header["meshes"][0]["primitives"] *= 3
    node = next(node for node in header["nodes"] if "mesh" in node)
    one = write(tmp_path / "one.glb", header, binary)
    assert [(part.count, part.raw.parts) for part in read_parts(one)] == [(1, 3)]
    header["nodes"] = [{"mesh": node["mesh"]} for _ in range(4)]
    header["scenes"][0]["nodes"] = [0, 1, 2, 3]
    (part,) = read_parts(write(tmp_path / "four.glb", header, binary))
    assert (part.count, part.raw.parts) == (4, 3)
    assert read_scene(part, copied(tmp_path / "four.glb"), ".glb").bounds == pytest.approx(  # type: ignore[arg-type]
        part.raw.mesh.bounds
    )


def _set(place: str, **values: Any) -> Callable[[Header], object]:
    return lambda header: header[place][0].update(values)


def _primitive(**values: Any) -> Callable[[Header], object]:
    return lambda header: header["meshes"][0]["primitives"][0].update(values)


def _positions(**values: Any) -> Callable[[Header], object]:
    return lambda header: header["accessors"][
        header["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    ].update(values)


def _required(*names: str) -> Callable[[Header], object]:
    return lambda header: header.update(extensionsRequired=list(names))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (_required("KHR_draco_mesh_compression"), "requires the extension KHR_draco_mesh_compr"),
        (_required("EXT_meshopt_compression"), "requires the extension EXT_meshopt_compression"),
        (_required("KHR_materials_ior", "ACME_bend"), "requires the extension ACME_bend"),
        (_primitive(mode=6), "'block' has triangle fans"),
        (_set("meshes", weights=[0.0, 0.5]), "'block' is morphed"),
        (_positions(sparse={}), "its vertices are sparse"),
        (_positions(normalized=True), "its vertices are normalized integers"),
        (lambda h: [n.update(camera=0) for n in h["nodes"]], "is a camera with meshes"),
        (lambda h: h["scenes"][0]["nodes"].append(0), "its node 0 is in two places"),
        (lambda h: h["nodes"][0].update(children=[0]), "a part of itself"),
    ],
)
def test_what_would_be_read_wrongly_is_refused(
    tmp_path: Path, change: Callable[[Header], object], problem: str
) -> None:
    header, binary = block()
    change(header)
    with pytest.raises(MeshError, match=problem):
        read(write(tmp_path / "b.glb", header, binary))


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (_required("KHR_materials_unlit", "KHR_texture_transform"), None),
        (_set("nodes", skin=0), "is read without its skin"),
        (lambda h: h["scenes"].append({"name": "spare"}), "its scene 0 is read, one of 2"),
        (
            lambda h: h["meshes"][0]["primitives"].append(
                {"mode": 1, "attributes": {"POSITION": 1}}
            ),
            "1 sets of points or lines in it are left out",
        ),
    ],
)
def test_what_is_left_out_is_noted(
    tmp_path: Path, change: Callable[[Header], object], note: str | None
) -> None:
    header, binary = block()
    change(header)
    raw = read(write(tmp_path / "b.glb", header, binary))
    assert len(raw.mesh.faces) == 12
    assert [note in each for each in raw.notes] == ([] if note is None else [True])


@pytest.mark.parametrize(
    ("attributes", "problem"),
    [
        ({"TRANSLATION": np.zeros((2, 4), np.float32)}, "has another type"),
        ({"TRANSLATION": np.zeros((2, 3), np.int8)}, "has another type"),
        ({"TRANSLATION": np.full((2, 3), np.nan, np.float32)}, "is not finite"),
        (
            {
                "TRANSLATION": np.zeros((2, 3), np.float32),
                "SCALE": np.ones((3, 3), np.float32),
            },
            "have different counts",
        ),
    ],
)
def test_broken_instances_are_refused(
    tmp_path: Path, attributes: dict[str, np.ndarray], problem: str
) -> None:
    with pytest.raises(MeshError, match=problem):
        read(instanced(tmp_path / "b.glb", **attributes))
