"""Mesh files of every format, and a corpus of bad ones."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh import creation, transformations

from packit_sim.core.errors import MeshError
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.mesh_files import SUFFIXES, read
from tests import bad_meshes
from tests.bad_meshes import BAD, GOOD

BLOCK = creation.box((1, 2, 3))

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>{up}_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="{count}">{positions}</float_array>
<technique_common><accessor source="#pa" count="{vertices}" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{triangles}"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{faces}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node><instance_geometry url="#g"/></node>
<node><translate>9 0 0</translate><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def pair() -> trimesh.Scene:
    """Two blocks, the second 9 along x."""
    scene = trimesh.Scene()
    for x in (0, 9):
        scene.add_geometry(BLOCK.copy(), transform=transformations.translation_matrix((x, 0, 0)))
    return scene


def dae(up: str) -> str:
    return DAE.format(
        up=up,
        count=BLOCK.vertices.size,
        positions=" ".join(map(str, BLOCK.vertices.ravel())),
        vertices=len(BLOCK.vertices),
        triangles=len(BLOCK.faces),
        faces=" ".join(map(str, BLOCK.faces.ravel())),
    )


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off", ".STL"])
def test_formats_without_scenes(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"block{suffix}"
    BLOCK.export(file, file_type=suffix[1:].lower())
    raw = read(file)
    assert raw.mesh.extents == pytest.approx(BLOCK.extents)
    assert (len(raw.mesh.faces), raw.up, raw.unit_cm) == (12, "z", None)


def test_scenes_are_flattened_with_their_transforms(tmp_path: Path) -> None:
    pair().export(tmp_path / "pair.glb")
    pair().export(tmp_path / "pair.3mf")
    for name, content in trimesh.exchange.gltf.export_gltf(pair()).items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "model.gltf").rename(tmp_path / "pair.gltf")
    (tmp_path / "pair.dae").write_text(dae("Z"))
    (tmp_path / "up.dae").write_text(dae("Y"))
    known = {}
    for name in ("pair.glb", "pair.gltf", "pair.3mf", "pair.dae", "up.dae"):
        raw = read(tmp_path / name)
        assert raw.mesh.extents == pytest.approx((10, 2, 3)), name
        assert len(raw.mesh.faces) == 24
        known[name] = raw.up, raw.unit_cm
    assert known == {
        "pair.glb": ("y", 100),
        "pair.gltf": ("y", 100),
        "pair.3mf": ("z", 0.1),
        "pair.dae": ("z", 1),
        "up.dae": ("y", 1),
    }
    others = {".stl", ".obj", ".ply", ".off", ".step", ".stp"}
    assert others | {f".{name.split('.')[1]}" for name in known} == set(SUFFIXES)


def test_polygons_become_triangles(tmp_path: Path) -> None:
    quads = "3 2 1 0\n4 5 6 7\n0 1 5 4\n1 2 6 5\n2 3 7 6\n3 0 4 7"
    rows = [[int(i) for i in line.split()] for line in quads.splitlines()]
    corners = [(x, y, z) for z in (0, 3) for x, y in ((0, 0), (1, 0), (1, 2), (0, 2))]
    obj = [f"v {x} {y} {z}" for x, y, z in corners]
    obj += ["f " + " ".join(str(i - 8) for i in row) for row in rows]  # counted from the end
    (tmp_path / "block.obj").write_text("\n".join(obj))
    off = ["OFF # a block", "8 6 12"] + [f"{x} {y} {z}" for x, y, z in corners]
    off += ["4 " + " ".join(map(str, row)) for row in rows]
    (tmp_path / "block.off").write_text("\n".join(off))
    ply = bad_meshes.PLY.format("ascii", 8, 6).splitlines() + off[2:]
    (tmp_path / "block.ply").write_text("\n".join(ply))
    for name in ("block.obj", "block.off", "block.ply"):
        mesh = read(tmp_path / name).mesh
        assert len(mesh.faces) == 12 and abs(mesh.volume) == pytest.approx(6), name


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if "bomb" in name else []) for name in BAD],
)
def test_bad_files_are_named_with_what_is_wrong(tmp_path: Path, name: str) -> None:
    bad_meshes.write(tmp_path, [name])
    with pytest.raises(MeshError, match=BAD[name][1]) as caught:
        Shape.from_mesh(read(tmp_path / name).mesh, name)
    assert name in str(caught.value) and len(str(caught.value)) < 500


@pytest.mark.parametrize("name", GOOD)
def test_files_that_look_bad_are_read(tmp_path: Path, name: str) -> None:
    bad_meshes.write(tmp_path, [name])
    assert len(read(tmp_path / name).mesh.faces) in (4, 12, 40, 400)


@pytest.mark.slow
def test_bad_files_take_little_time_and_memory(tmp_path: Path) -> None:
    bad_meshes.write(tmp_path, list(BAD))
    script = """
import resource, sys
from pathlib import Path
from packit_sim.core.errors import MeshError
from packit_sim.libraries.mesh_files import read
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for file in sorted(Path(sys.argv[1]).iterdir()):
    try:
        read(file)
    except MeshError:
        pass
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 200_000  # kB
    assert time.perf_counter() - started < 60


def test_material_libraries_and_textures_are_never_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.mtl").write_text("newmtl secret\nmap_Kd secret.png\n")
    (tmp_path / "in" / "near.mtl").write_text("newmtl near\nmap_Kd ../secret.png\n")
    file = tmp_path / "in" / "it.obj"
    file.write_text("mtllib ../secret.mtl\nmtllib near.mtl\nusemtl secret\n" + bad_meshes.OBJ)
    opened = []
    sys.addaudithook(lambda event, args: opened.append(args[0]) if event == "open" else None)
    read(file)
    assert str(file) in map(str, opened)
    assert not [name for name in opened if "mtl" in str(name) or "png" in str(name)]


@pytest.mark.parametrize("uri", ["../{}", "{folder}/{}", "link.bin", " ../{}"])
def test_a_gltf_reads_no_file_outside_its_folder(tmp_path: Path, uri: str) -> None:
    """Neither by its path nor by a symbolic link, whatever the version of trimesh allows."""
    (tmp_path / "in").mkdir()
    files = BLOCK.scene().export(file_type="gltf")
    model = json.loads(files.pop("model.gltf"))
    (tmp_path / "secret.bin").write_bytes(b"".join(files.values()))
    (tmp_path / "in" / "link.bin").symlink_to(tmp_path / "secret.bin")
    for buffer in model["buffers"]:
        buffer["uri"] = uri.format("secret.bin", folder=tmp_path)
    file = tmp_path / "in" / "block.gltf"
    file.write_text(json.dumps(model))
    with pytest.raises(MeshError, match=r"it refers to '.*', which is not in its folder"):
        read(file)


@pytest.mark.parametrize("suffix", [".dae", ".3mf"])
def test_no_external_entity_is_read(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "secret.txt").write_text("0 0 0")
    entity = f'<!DOCTYPE x [<!ENTITY secret SYSTEM "file://{tmp_path}/secret.txt">]>'
    file = tmp_path / f"block{suffix}"
    if suffix == ".dae":
        text = DAE.format(
            up="Z", count=24, positions="&secret;", vertices=8, triangles=12, faces="0 1 2"
        )
        file.write_text(text.replace("<COLLADA", f"{entity}<COLLADA", 1))
    else:
        text = bad_meshes.MODEL.format("&secret;", '<item objectid="0"/>')
        text = text.replace("<model", f"{entity}<model", 1)
        bad_meshes.package({"3D/3dmodel.model": text})(file)
    with pytest.raises(MeshError, match="Entity 'secret' not defined"):
        read(file)


def test_files_that_are_too_large_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "block.stl"
    BLOCK.export(file)
    monkeypatch.setattr("packit_sim.libraries.mesh_limits.MAX_BYTES", 600)
    with pytest.raises(MeshError, match=r"block\.stl: 684 bytes are too many: at most 600"):
        read(file)
    monkeypatch.setattr("packit_sim.libraries.mesh_limits.MAX_BYTES", 10_000)
    monkeypatch.setattr("packit_sim.libraries.mesh_limits.MAX_TRIANGLES", 11)
    with pytest.raises(MeshError, match="12 triangles are too many: at most 11"):
        read(file)
    with pytest.raises(MeshError, match=r"block\.fbx: not a mesh file: its name must end in \.3mf"):
        read(tmp_path / "block.fbx")
    with pytest.raises(MeshError, match=r"absent\.stl"):
        read(tmp_path / "absent.stl")


def test_polygons_of_many_kinds_in_a_binary_ply_are_not_lost(tmp_path: Path) -> None:
    header = bad_meshes.PLY.format("binary_little_endian", 5, 3).encode()
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)], dtype="<f4")
    rows = [[0, 1, 4], [0, 3, 2, 1], [0, 4, 3]]
    faces = b"".join(bytes([len(row)]) + np.array(row, dtype="<i4").tobytes() for row in rows)
    (tmp_path / "mixed.ply").write_bytes(header + corners.tobytes() + faces)
    with pytest.raises(MeshError, match=r"mixed\.ply: can't be read as PLY"):
        read(tmp_path / "mixed.ply")


def test_numbers_survive(tmp_path: Path) -> None:
    cloud = np.random.default_rng(0).random((40, 3)) * 1e-6 + 1000
    mesh = trimesh.Trimesh(cloud, np.arange(39).reshape(13, 3), process=False)
    mesh.export(tmp_path / "soup.ply")
    assert read(tmp_path / "soup.ply").mesh.triangles.shape == (13, 3, 3)
