"""Exports, read by other libraries: the same meshes, poses and names."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from lxml import etree

from packit_sim.box import Box
from packit_sim.core.errors import RenderError
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.render import export
from packit_sim.render.coloring import ByNumber, by_item
from tests.read_3mf import bodies
from tests.zoo import BALL, BOWL, CUBE, RING, cube_of

UNIT = 100.0


def packed() -> Box:
    """Two of a kind in two rotations, another scale of it, one open mesh, a box that is no cube."""
    box = Box((100, 120, 80))
    ring = Item(RING, 0.02)
    for item, location in (
        (ring, (0, 0, 0)),
        (ring.turned(9), (12, 0, 0)),
        (Item(RING, 0.05, 17), (0, 12, 0)),
        (Item(BOWL, 0.1, 5), (12, 14, 0)),
        (cube_of(20), (0, 24, 0)),
    ):
        box.place(item, location)
    return box


@pytest.fixture(name="written")
def _written(tmp_path: Path) -> Callable[[str], Path]:
    def write(suffix: str) -> Path:
        path = tmp_path / f"box{suffix}"
        export.export(packed(), path, unit_mm=UNIT)
        return path

    return write


def check_nodes(scene: trimesh.Scene, frame: str, unit: float) -> None:
    """That a scene's nodes are the box's items: names, poses, and meshes where they end up."""
    box = packed()
    names = export.names(box.placed)
    assert set(scene.graph.nodes_geometry) == set(names) and len(set(names)) == 5
    for name, placed in zip(names, box.placed, strict=True):
        pose, geometry = scene.graph.get(name, frame)
        assert np.allclose(pose, np.diag((unit, unit, unit, 1)) @ placed.matrix, atol=1e-6 * unit)
        mesh = scene.geometry[geometry]
        shape = placed.item.shape.mesh
        assert np.array_equal(mesh.faces, shape.faces)
        assert np.allclose(mesh.vertices, shape.vertices, atol=1e-6)


def test_glb_has_every_item_in_its_place(written: Callable[[str], Path]) -> None:
    scene = trimesh.load_scene(written(".glb"), process=False)
    check_nodes(scene, export.BOX, 1.0)
    assert len(scene.geometry) == 3  # one a shape, since a shape's own colour is one
    up, _ = scene.graph.get(export.BOX)
    assert np.allclose(up[:3, :3] @ (0, 0, 1), (0, 1, 0))  # glTF's y is up
    assert np.linalg.det(up) == pytest.approx(1.0)
    for mesh in scene.geometry.values():
        assert mesh.visual.material.doubleSided


def test_glb_has_the_colours_of_the_picture(tmp_path: Path) -> None:
    box, coloring = packed(), ByNumber("score", {0: 0.0, 1: 1.0})
    export.export(box, tmp_path / "box.glb", coloring=coloring)
    scene = trimesh.load_scene(tmp_path / "box.glb", process=False)
    colors = coloring([placed.item for placed in box.placed]).of
    for name, color in zip(export.names(box.placed), colors, strict=True):
        _, geometry = scene.graph.get(name)
        found = np.array(scene.geometry[geometry].visual.material.baseColorFactor[:3]) / 255
        assert np.allclose(found ** (1 / 2.2), color, atol=0.03)
    assert len(scene.geometry) == 5


def test_3mf_has_every_item_in_its_place(written: Callable[[str], Path]) -> None:
    scene, box = trimesh.load_scene(written(".3mf")), packed()
    assert scene.metadata["units"] == "millimeter"
    assert len(scene.geometry) == 3 and len(scene.graph.nodes_geometry) == 5
    corners = [UNIT * (one.item.mesh.bounds + one.center) for one in box.placed]
    assert np.allclose(scene.bounds[0], np.min(corners, axis=(0, 1)), atol=1e-4)
    assert np.allclose(scene.bounds[1], np.max(corners, axis=(0, 1)), atol=1e-4)


def test_3mf_is_as_its_specification_says(written: Callable[[str], Path]) -> None:
    """The package's parts, the order of elements, references, indices."""
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    with zipfile.ZipFile(written(".3mf")) as package:
        assert package.testzip() is None
        types = etree.fromstring(package.read("[Content_Types].xml"))
        relations = etree.fromstring(package.read("_rels/.rels"))
        model = etree.fromstring(package.read("3D/3dmodel.model"))
    known = {child.get("Extension"): child.get("ContentType") for child in types}
    assert known["model"] == "application/vnd.ms-package.3dmanufacturing-3dmodel+xml"
    assert [child.get("Target") for child in relations] == ["/3D/3dmodel.model"]
    assert model.tag == f"{core}model" and model.get("unit") == "millimeter"
    assert [child.tag for child in model] == [f"{core}resources", f"{core}build"]
    objects = {child.get("id"): child for child in model[0]}
    assert len(objects) == len(model[0]) == 3 + 5
    assert all(int(id) > 0 for id in objects)
    assert [item.get("objectid") in objects for item in model[1]] == [True] * 5
    for item in model[1]:
        matrix = np.array(item.get("transform").split(), dtype=float).reshape(4, 3)
        assert np.linalg.det(matrix[:3]) > 0
    known = []
    for id, (mesh,) in objects.items():
        known.append(id)
        if mesh.tag == f"{core}components":
            assert [one.get("objectid") in known for one in mesh] == [True]
            continue
        vertices, triangles = mesh
        corners = np.array([[int(t.get(v)) for v in ("v1", "v2", "v3")] for t in triangles])
        assert corners.min() >= 0 and corners.max() < len(vertices)
        assert (np.diff(np.sort(corners, axis=1), axis=1) > 0).all()


def test_3mf_is_read_as_slicers_do(written: Callable[[str], Path]) -> None:
    found, box = bodies(written(".3mf")), packed()
    assert list(found) == export.names(box.placed)
    for triangles, placed in zip(found.values(), box.placed, strict=True):
        expected = UNIT * (placed.item.mesh.triangles + placed.center)
        assert triangles.shape == expected.shape
        for extreme in (np.min, np.max, np.mean):
            assert np.allclose(extreme(triangles, (0, 1)), extreme(expected, (0, 1)), atol=1e-3)


def test_stl_is_one_mesh_in_millimetres(written: Callable[[str], Path]) -> None:
    path = written(".stl")
    mesh, box = trimesh.load_mesh(path), packed()
    triangles = sum(len(placed.item.shape.mesh.faces) for placed in box.placed)
    assert path.stat().st_size == 84 + 50 * triangles  # binary
    corners = [placed.item.mesh.triangles + placed.center for placed in box.placed]
    assert np.allclose(mesh.triangles, UNIT * np.concatenate(corners), atol=1e-4)


def test_json_is_a_valid_packing(written: Callable[[str], Path]) -> None:
    path, box = written(".json"), packed()
    packing = json.loads(path.read_text())
    assert packing["box"] == box.size.tolist()
    assert [item["name"] for item in packing["items"]] == export.names(box.placed)
    for item, placed in zip(packing["items"], box.placed, strict=True):
        assert np.array_equal(item["pose"], placed.matrix)
        mesh = trimesh.load_mesh(path.parent / item["mesh"], process=False)
        assert np.allclose(mesh.vertices, placed.item.shape.mesh.vertices, atol=1e-7)
        assert np.array_equal(mesh.faces, placed.item.shape.mesh.faces)
    assert len(list((path.parent / "box-meshes").iterdir())) == 3
    report = verify_packing(path)
    assert report.is_valid, report.problems
    assert report.density == pytest.approx(box.density, rel=1e-4)


@pytest.mark.parametrize("id", ["a/b", "Ü<&>\"'", "\x01\n", "box", "world", "", "x" * 300])
def test_any_name_of_a_shape_will_do(id: str, tmp_path: Path) -> None:
    box = Box()
    for n, shape in enumerate((CUBE, BALL)):
        box.place(Item(Shape(shape.mesh, id, ""), 0.01), (10 * n, 0, 0))
    names = set(export.names(box.placed))
    assert len(names) == 2 and all(name.isascii() for name in names)
    for suffix in export.SUFFIXES:
        path = tmp_path / f"box{suffix}"
        export.export(box, path)
        if suffix == ".glb":
            assert set(trimesh.load_scene(path).graph.nodes_geometry) == names
        elif suffix == ".3mf":
            assert set(bodies(path)) == names
    assert [item["shape"] for item in json.loads(path.read_text())["items"]] == [id, id]


def test_what_cannot_be_exported_leaves_nothing(tmp_path: Path) -> None:
    box = packed()
    with pytest.raises(RenderError, match=r"box\.obj is no export: .*, \.3mf, \.stl or \.json"):
        export.export(box, tmp_path / "box.obj")
    for suffix in export.SUFFIXES:
        with pytest.raises(RenderError, match="an empty box"):
            export.export(Box(), tmp_path / f"box{suffix}")
        with pytest.raises(RenderError, match="can't be written to"):
            export.export(box, tmp_path / "nowhere" / f"box{suffix}")
    for unit in (0, -1, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="mm is not possible"):
            export.export(box, tmp_path / "box.stl", unit_mm=unit)
    assert list(tmp_path.iterdir()) == []


def test_the_same_box_is_the_same_file(tmp_path: Path) -> None:
    for suffix in (".glb", ".stl", ".json"):
        export.export(packed(), tmp_path / f"one{suffix}", coloring=by_item)
        first = (tmp_path / f"one{suffix}").read_bytes()
        export.export(packed(), tmp_path / f"one{suffix}")
        assert (tmp_path / f"one{suffix}").read_bytes() == first
