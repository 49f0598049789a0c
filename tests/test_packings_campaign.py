"""The campaign of packings finds what is wrong, and its page has its results."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("lib3mf", reason="lib3mf is not installed")
pytest.importorskip("manifold3d", reason="manifold3d is not installed")

from campaigns.common import read_results, table_in_page
from campaigns.packings import cases, mesh_writers, plate_writers, shapes, triangles
from campaigns.packings.checker import check
from campaigns.packings.scenes import Node, Scene
from campaigns.packings.shapes import Shape
from campaigns.packings.solids import Rules, Solid
from campaigns.packings.table import table, totals
from campaigns.packings.trials import tried
from campaigns.packings.truth import TrueBox, TruePart, Truth
from packit_sim.libraries import mesh_files

Record = dict[str, Any]

BLOCK = shapes.box((20, 10, 5))
CUP = shapes.cup(15, 12, 20, 3, 8)
HOOK = shapes.extruded(
    [(0, 0), (9, 0), (9, 2), (2, 2), (2, 7), (0, 7)], 4
)  # none is its mirror image

PLACES = (("block", BLOCK, (1.0, 1.0, 1.0)), ("block", BLOCK, (22.0, 1.0, 1.0)))
PLACES += (("cup", CUP, (20.0, 30.0, 1.0)), ("hook", HOOK, (45.0, 1.0, 1.0)))


def at(place: tuple[float, ...]) -> np.ndarray:
    motion = np.eye(4)
    motion[:3, 3] = place
    return motion


def truth(clearance: float = 1.0) -> Truth:
    """Two blocks, one of which is left out, a cup and a hook in a box of 60 x 60 x 40 mm."""
    common = {"user_from_shape": (np.eye(4),), "up": np.eye(3), "rotations": "fixed"}
    parts = [
        TruePart(f"{name}.", "", "OFF", shape, count=count, density=2.0, rounding=0.0, **common)
        for name, shape, count in (("block", BLOCK, 3), ("cup", CUP, 1), ("hook", HOOK, 1))
    ]
    box = TrueBox("box", np.array([60.0, 60, 40]), 1)
    return Truth(tuple(parts), (box,), "mm", clearance, 1.0, False, ("broken",), "")


def write(folder: Path, record: Record, places: Any = PLACES) -> None:
    """Write a result as the product does."""
    nodes = tuple(Node(n, at(place)) for n, (_, _, place) in enumerate(places))
    names = tuple(f"{n:02d} {name}" for n, (name, _, _) in enumerate(places))
    own = tuple(shape for _, shape, _ in places)
    scene = Scene(names, own, nodes, 1.0, np.eye(3), 1.0)
    moved = shapes.united([shape.moved(at(place)) for _, shape, place in places])
    for stem in ("packing", "packing-1", "packing-2"):
        plate_writers.core_3mf(folder / f"{stem}.3mf", scene, "millimeter", {})
        mesh_writers.binary_stl(folder / f"{stem}.stl", moved)
    (folder / "packing.json").write_text(json.dumps(record))


def right() -> Record:
    """The record of a result that is right."""
    files = {"block": BLOCK, "cup": CUP, "hook": HOOK}
    items = [
        {"name": name, "box": 0, "pose": at(place).tolist(), "mesh": f"meshes/{name}.off"}
        for name, _, place in PLACES
    ]
    parts = [
        {
            "name": name,
            "file": f"inputs/{name}.off",
            "count": 3 if name == "block" else 1,
            "volume": shape.volume,
            "mass": shape.volume * 2 / 1000,
        }
        for name, shape in files.items()
    ]
    volume = sum(shape.volume for _, shape, _ in PLACES)
    return {
        "unit": "mm",
        "boxes": [[60, 60, 40]],
        "box names": ["box"],
        "clearance": 1.0,
        "wall clearance": 1.0,
        "items": items,
        "parts": parts,
        "left out": [{"name": "block", "count": 1, "reason": "no space was found"}],
        "files not read": [{"source": "broken.stl", "reason": "it is empty"}],
        "summary": {"volume": f"{volume} mm³", "height": "21 mm", "check": "no problems"},
    }


def test_a_result_that_is_right_has_no_problem(tmp_path: Path) -> None:
    write(tmp_path, right())
    assert check(truth(), tmp_path) == []


def move(number: int, *shift: float) -> Callable[[Record], Any]:
    """Move an item in the record and in the exports."""

    def moved(record: Record) -> Any:
        pose = np.array(record["items"][number]["pose"])
        pose[:3, 3] += shift
        record["items"][number]["pose"] = pose.tolist()
        places = list(PLACES)
        places[number] = (*PLACES[number][:2], tuple(pose[:3, 3]))
        return places

    return moved


def drop(record: Record) -> Any:
    del record["items"][1]
    return [PLACES[0], *PLACES[2:]]


def mirror(record: Record) -> None:
    record["items"][3]["pose"] = (at((45.0, 1, 5)) @ np.diag([1.0, 1, -1, 1])).tolist()


def mirrored_mesh(record: Record) -> Any:
    flipped = replace(HOOK, vertices=HOOK.vertices * (1, -1, 1), triangles=HOOK.triangles[:, ::-1])
    return [*PLACES[:3], ("hook", flipped, (45.0, 8.0, 1.0))]


def turned(record: Record) -> Any:
    pose = np.array([[-1.0, 0, 0, 54], [0, -1, 0, 8], [0, 0, 1, 1], [0, 0, 0, 1]])
    record["items"][3]["pose"] = pose.tolist()
    return [*PLACES[:3], ("hook", HOOK.moved(at((-45.0, -1, -1)) @ pose), (45.0, 1.0, 1.0))]


def inches(record: Record) -> Any:
    """The blocks are read as inches."""
    big = replace(BLOCK, vertices=BLOCK.vertices * 1.2)
    record["items"][0]["pose"] = (at((1.0, 1, 1)) @ np.diag([1.2, 1.2, 1.2, 1])).tolist()
    return [("block", big, (1.0, 1.0, 1.0)), *PLACES[1:]]


def changed(*path: Any, to: Any) -> Callable[[Record], None]:
    """Change a value of the record alone."""

    def change(record: Record) -> None:
        for name in path[:-1]:
            record = record[name]
        record[path[-1]] = to

    return change


WRONG = {
    "0.05 mm too close": (move(0, 0.05, 0, 0), "apart"),
    "inside another": (move(1, -2.0, 30.0, 6.0), "share"),
    "in a wall": (move(0, 0, 0, -0.05), "in the walls"),
    "dropped": (drop, "packed or left out"),
    "mirrored by its pose": (mirror, "no rotation"),
    "mirrored in the exports": (mirrored_mesh, "no body"),
    "turned": (turned, "rotated against fixed"),
    "of another size": (inches, "no body"),
    "another unit": (changed("unit", to="in"), "the unit is in"),
    "another box": (changed("boxes", 0, to=[61, 60, 40]), "nobody asked for a box"),
    "too many boxes": (changed("box names", to=["box", "box"]), "2 boxes"),
    "another clearance": (changed("clearance", to=0.9), "clearance"),
    "the record's pose alone": (changed("items", 0, "pose", 0, 3, to=1.01), "no body"),
    "a wrong volume": (changed("parts", 1, "volume", to=CUP.volume * 1.001), "volume is wrong"),
    "a wrong mass": (changed("parts", 1, "mass", to=1.0), "1.0 g"),
    "no mass": (changed("parts", 1, "mass", to=None), "None g"),
    "an unknown part": (changed("parts", 1, "file", to="mug.off"), "nobody asked for part"),
    "a broken file in silence": (changed("files not read", to=[]), "not among the files"),
    "not left out": (changed("left out", to=[]), "packed or left out"),
    "a wrong sum": (changed("summary", "volume", to="7 mm³"), "the volume is said"),
    "a wrong height": (changed("summary", "height", to="20 mm"), "the height is said"),
    "not verified": (changed("summary", "check", to="2 problems"), "own check"),
}


@pytest.mark.parametrize("name", WRONG)
def test_every_mutant_is_found(name: str, tmp_path: Path) -> None:
    change, text = WRONG[name]
    record = right()
    if name == "too many boxes":
        record["boxes"] *= 2
    places = change(record)
    write(tmp_path, record, places or PLACES)
    found = check(truth(), tmp_path)
    assert any(text in each.text for each in found), found


@pytest.mark.parametrize(("y", "is_free"), [(9.0, True), (8.9, False), (4.0, False)])
def test_a_part_in_a_keep_out_or_too_close_to_it_is_found(
    y: float, is_free: bool, tmp_path: Path
) -> None:
    """The hook ends at 8 mm."""
    write(tmp_path, right())
    post = shapes.box((3, 3, 60)).moved(at((47.0, y, -10.0)))
    found = check(replace(truth(), keep_out=post), tmp_path)
    assert all("keep-out" in each.text for each in found)
    assert bool(found) != is_free


def test_a_body_that_only_an_export_has_elsewhere_is_found(tmp_path: Path) -> None:
    write(tmp_path, right())
    shapes_apart = [shape.moved(at((*place[:2], place[2] + 0.01))) for _, shape, place in PLACES]
    mesh_writers.binary_stl(tmp_path / "packing.stl", shapes.united(shapes_apart))
    assert [each.text for each in check(truth(), tmp_path)] == [
        "packing.stl has other bodies: 0.01 mm away"
    ]


def test_parts_that_may_touch_may_not_overlap_by_more_than_the_tolerance() -> None:
    block = Solid(BLOCK.vertices, BLOCK.triangles)
    rules = Rules(0.0, 0.0, (60.0, 60.0, 40.0))
    for shift, count in ((20.0, 0), (19.999, 0), (19.95, 2), (1.0, 2)):
        other = BLOCK.moved(at((shift, 0.0, 0.0)))
        found = list(rules.between(block, Solid(other.vertices, other.triangles)))
        assert bool(found) == bool(count), (shift, found)


def test_a_part_inside_another_is_found_by_winding_numbers_alone() -> None:
    outer = shapes.box((30, 30, 30))
    inner = shapes.box((5, 5, 5)).moved(at((10, 10, 10)))
    one, other = (Solid(each.vertices, each.triangles) for each in (outer, inner))
    found = list(Rules(1.0, 0.0, (60.0, 60.0, 40.0)).between(one, other))
    assert any("inside each other by 15 mm" in text for text in found)


def test_what_is_below_another_can_not_come_straight_down() -> None:
    rules = Rules(0.5, 0.0, (60.0, 60.0, 40.0))
    lid = BLOCK.moved(at((15, 0, 10)))
    one, other = (Solid(each.vertices, each.triangles) for each in (BLOCK, lid))
    assert rules.is_below(one, other) and not rules.is_below(other, one)
    beside = BLOCK.moved(at((20.5, 0, 10)))
    assert not rules.is_below(one, Solid(beside.vertices, beside.triangles))


def test_distances_are_those_of_the_formulas() -> None:
    a = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    cases_of = {
        "above a face": ([[0.2, 0.2, 3], [0.3, 0.2, 4], [0.2, 0.3, 4]], 3.0),
        "beside a corner": ([[4, 4, 0], [5, 4, 0], [4, 5, 0]], np.hypot(3.5, 3.5)),
        "through it": ([[0.2, 0.2, -1], [0.3, 0.2, 1], [0.2, 0.3, 1]], 0.0),
        "skew edges": ([[0.5, -2, 1], [0.5, 2, 1], [0.5, 0, 9]], 1.0),
    }
    for name, (corners, expected) in cases_of.items():
        b = np.array([corners], dtype=float)
        for one, other in ((a, b), (b, a)):
            assert triangles.distance(one, other, np.inf) == pytest.approx(expected), name


def test_winding_numbers_are_1_inside() -> None:
    corners = CUP.vertices[CUP.triangles]
    points = np.array([[0.0, 0, 1.5], [0, 0, 10], [13.3, 0.1, 10], [40, 0, 10]])
    assert triangles.winding_numbers(points, corners) == pytest.approx([1, 0, 1, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (BLOCK, 1000.0),
        (HOOK, (9 * 2 + 2 * 5) * 4),
        (shapes.bracket(10, 8, 5, 2), (10 * 2 + 6 * 2) * 5),
        (shapes.channel(10, 8, 5, 2), (10 * 2 + 2 * 6 * 2) * 5),
        (shapes.tube(10, 6, 7, 8), 8 / 2 * np.sin(np.pi / 4) * (100 - 36) * 7),
        (shapes.cup(15, 12, 20, 3, 8), 4 * np.sin(np.pi / 4) * (225 * 20 - 144 * 17)),
        (shapes.ball(10, 64), 4 / 3 * np.pi * 1000),
        (shapes.pierced(BLOCK, 0, 0.1), 1000.0),
        (shapes.united([BLOCK, BLOCK.moved(at((30, 0, 0)))]), 2000.0),
    ],
)
def test_shapes_are_closed_and_have_the_volume_of_their_formula(
    shape: Shape, volume: float
) -> None:
    assert shape.volume == pytest.approx(volume, rel=1e-2 if volume > 4000 else 1e-9)
    edges = {
        (int(a), int(b)) for t in shape.triangles for a, b in zip(t, np.roll(t, -1), strict=True)
    }
    assert len(edges) == 3 * len(shape.triangles) and edges == {(b, a) for a, b in edges}


@pytest.mark.parametrize("kind", mesh_writers.WRITERS)
def test_the_product_reads_every_mesh_as_it_is(kind: str, tmp_path: Path) -> None:
    suffix, write_mesh = mesh_writers.WRITERS[kind]
    write_mesh(tmp_path / f"hook{suffix}", HOOK)
    mesh = mesh_files.read(tmp_path / f"hook{suffix}").mesh
    mesh.merge_vertices()
    assert mesh.is_volume and mesh.volume == pytest.approx(HOOK.volume, rel=1e-5)


def test_a_seed_has_one_case(tmp_path: Path) -> None:
    for seed in range(20):
        one, other = (cases.make(seed, tmp_path / name) for name in "ab")
        assert one.boxes == other.boxes and one.of_bricks == other.of_bricks
        assert str(one.settings).replace("/a/", "/b/") == str(other.settings)
        assert len(one.truth.parts) == len(other.truth.parts) > 0
        assert one.by_cells == other.by_cells
        for file in (tmp_path / "a" / "inputs").rglob("*.stl"):
            assert (
                file.read_bytes()
                == (tmp_path / "b" / file.relative_to(tmp_path / "a")).read_bytes()
            )


def test_counts_are_those_of_the_trials() -> None:
    def trial(kind: str, *problems: tuple[tuple[str, ...], bool]) -> dict[str, Any]:
        told = [{"text": "", "kinds": list(k), "is_unread": unread} for k, unread in problems]
        parts = {kind: 2, "OFF": 1}
        own = {"seconds": 1.0, "list": "", "parts": parts, "packed": 3, "problems": told}
        own |= {"of bricks": False, "around a keep-out": kind == "GLB"}
        return own | {"by cells": kind == "STEP", "separable": False}

    found = totals(
        {
            "0": trial("GLB"),
            "1": trial("GLB", (("OFF",), False)),
            "2": trial("STEP", (("STEP",), True)),
            "3": trial("STEP", ((), False)),
        }
    )
    rows = found["formats"]
    assert rows["GLB"] == {"packings": 2, "wrong": 0, "unread": 0, "parts": 4}
    assert rows["OFF"] == {"packings": 4, "wrong": 2, "unread": 0, "parts": 4}
    assert rows["STEP"] == {"packings": 2, "wrong": 1, "unread": 1, "parts": 4}
    assert rows["all"] == {"packings": 4, "wrong": 2, "unread": 1, "parts": 12}
    assert rows["search: by cells"] == {"packings": 2, "wrong": 1, "unread": 1, "parts": 6}
    assert rows["search: around a keep-out"]["packings"] == 2
    assert rows["search: of bricks"]["packings"] == rows["search: separable"]["packings"] == 0
    assert found["items"] == 12 and list(found["problems"]) == ["1", "2", "3"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_case_is_packed_and_right(seed: int, tmp_path: Path) -> None:
    trial = tried(seed, tmp_path)
    assert trial["problems"] == [] and trial["packed"] > 0
    assert not list(tmp_path.iterdir())


def test_the_page_has_the_results() -> None:
    assert table(read_results("packings")) == table_in_page("packings")
