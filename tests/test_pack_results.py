"""Results of packing: the record comes first, and what fails later loses nothing."""

from __future__ import annotations

import colorsys
import json
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import PackSettings, Part, ShapeLibrary, pack
from packit_sim.core.errors import RenderError
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import reduced, triangle_limit
from packit_sim.parts import check, export
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.packings import posed_parts
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading import prepared
from packit_sim.parts.results import check as check_module
from packit_sim.parts.results import exports, pictures
from packit_sim.web import page_models
from tests.runs import packit

QUICK = PackSettings(workers=1, iterations=20)

STEPS = ("packing.3mf", "packing.glb", "packing.stl", "packing.png", "packing.html")


def cube(name: str = "cube", count: int = 1) -> Part:
    return Part(name, creation.box((10, 10, 10)), count=count)


def record(folder: Path) -> dict[str, object]:
    return dict(json.loads((folder / "packing.json").read_text()))


@pytest.fixture(name="packed", scope="module")
def _packed() -> PackedParts:
    return pack([cube(count=2)], (21, 11, 11), settings=QUICK)


def fail(*_: object, **__: object) -> None:
    raise RenderError("more triangles than can be drawn")


@pytest.mark.parametrize("name", ["draw", "write_page", "_encoded"])
def test_a_file_that_can_not_be_made_is_a_warning(
    packed, tmp_path, monkeypatch, caplog, name
) -> None:
    monkeypatch.setattr(exports, name, fail)
    files = [file.name for file in export(packed, tmp_path)]
    missing = {"draw": {"packing.png"}, "write_page": {"packing.html"}}
    lost = missing.get(name, {"packing.3mf", "packing.glb", "packing.stl"})
    assert set(STEPS) - set(files) == lost
    written = [name for name in record(tmp_path)["files"] if "/" not in name]
    assert written == [step for step in STEPS if step not in lost]
    assert [each.getMessage() for each in caplog.records] == [
        f"{tmp_path / file} is not written: more triangles than can be drawn"
        for file in STEPS
        if file in lost
    ]


def test_the_record_is_there_before_the_check_and_says_so(packed, tmp_path, monkeypatch) -> None:
    found = []

    def look(packed: PackedParts, *_: object) -> check_module.Check:
        found.append((record(tmp_path), [file.name for file in tmp_path.iterdir()]))
        return check(packed)

    monkeypatch.setattr(exports, "check", look)
    export(packed, tmp_path)
    ((first, files),) = found
    assert first["summary"]["check"] == "not done"
    assert sorted(files) == ["meshes", "packing.json"]
    assert all(name.startswith("meshes/cube-") for name in first["files"])
    assert record(tmp_path)["summary"]["check"].startswith("no problems")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_the_search_resumes_from_an_export_that_was_interrupted(
    tmp_path, monkeypatch, error
) -> None:
    def interrupt(*_: object) -> None:
        raise error

    monkeypatch.setattr(exports, "draw", interrupt)
    with pytest.raises(type(error)):
        pack([cube(count=2)], (21, 11, 11), settings=QUICK, out=tmp_path)
    monkeypatch.undo()
    again = pack([cube(count=2)], (21, 11, 11), settings=QUICK, out=tmp_path)
    assert again.searches == 2 and again.count == 2
    assert {"packing.json", *STEPS} < {file.name for file in tmp_path.iterdir()}


def test_files_of_another_packing_do_not_outlast_its_record(packed, tmp_path, monkeypatch) -> None:
    export(packed, tmp_path)
    monkeypatch.setattr(exports, "_encoded", fail)
    export(packed, tmp_path)
    assert not (tmp_path / "packing.stl").exists() and (tmp_path / "packing.png").exists()


def test_a_check_that_fails_is_a_problem(tmp_path, monkeypatch) -> None:
    packed = pack([cube()], (11, 11, 11), settings=QUICK)
    monkeypatch.setattr(check_module, "_read", fail)
    (problem,) = check(packed).problems
    assert problem.startswith("cube can't be read again: ")
    export(packed, tmp_path)
    assert record(tmp_path)["summary"]["check"] == "1 problem"


def test_a_file_that_can_not_be_read_again_is_named_also_next_to_a_fixed_part(
    tmp_path, monkeypatch
) -> None:
    read_again = check_module._read
    cube, gone, block = (tmp_path / f"{name}.stl" for name in ("cube", "gone", "block"))
    for file in (cube, gone):
        creation.box((10, 10, 10)).export(file)
    creation.box((5, 5, 5)).apply_translation((37, 37, 37)).export(block)
    settings = replace(QUICK, fixed=[block])
    packed = pack([cube, gone], (40, 40, 40), settings=settings)
    assert packed.count == 2
    monkeypatch.setattr(
        check_module, "_read", lambda part: (fail if part.name == "gone" else read_again)(part)
    )
    (problem,) = check(packed).problems
    assert problem.startswith("gone can't be read again: ")


# Triangles


@pytest.mark.parametrize(
    ("counts", "total", "limit"),
    [([10, 20], 100, 20), ([100, 100], 120, 60), ([10, 500, 900], 410, 200), ([9000] * 99, 9, 50)],
)
def test_meshes_share_a_number_of_triangles(counts, total, limit) -> None:
    assert triangle_limit(counts, total) == limit


def test_a_reduced_shape_keeps_its_volume() -> None:
    ball = Shape.from_mesh(creation.icosphere(subdivisions=3), "ball")
    assert len(reduced(ball, 200).mesh.faces) <= 200
    assert reduced(ball, 200).volume == ball.volume
    assert reduced(ball, 5000) is ball


@pytest.mark.parametrize("name", ["fork-lift", "desk-lamp-3", "mailbox"])
def test_reduced_shapes_stay_in_their_boxes(name: str) -> None:
    shape = ShapeLibrary.open("everyday")[name]
    found = reduced(shape, 52)
    assert len(found.mesh.faces) < len(shape.mesh.faces) / 5
    assert found.mesh.bounds == pytest.approx(shape.mesh.bounds, abs=1e-9)


def test_pictures_and_pages_share_their_triangles(tmp_path, monkeypatch, caplog) -> None:
    monkeypatch.setattr(posed_parts, "MAX_TRIANGLES", 2000)
    monkeypatch.setattr(page_models, "ALL_TRIANGLES", 1000)
    monkeypatch.setattr("packit_sim.render.bullet._EGL_TRIANGLES", 9000)
    balls = [Part(f"ball-{n}", creation.icosphere(3, radius=4 + n / 9)) for n in range(9)]
    packed = pack(balls, (40, 40, 15), settings=PackSettings(workers=1, iterations=1))
    shown = pictures.shown(packed.contents[0])
    assert 1000 < sum(len(one.item.shape.mesh.faces) for one in shown.placed) <= 2000
    export(packed, tmp_path)
    assert (tmp_path / "packing.png").exists() and caplog.records == []
    text = (tmp_path / "packing.html").read_text(encoding="utf-8")
    models = json.loads(text.split('id="models"')[1].split(">", 1)[1].split("</script>")[0])
    faces = sum(len(shape["faces"]) * 3 // 4 // 12 for shape in models["shapes"])
    assert 500 < faces <= 1000


# Colours


def grid(count: int, types: int) -> Packing:
    parts = [cube(f"cube-{n}", count) for n in range(types)]
    task = prepared_task(parts, (1000, 1000, 1000), "volume", QUICK)
    places = [
        Placement.from_matrix(n % types, trimesh.transformations.translation_matrix((n * 10, 5, 5)))
        for n in range(count)
    ]
    return Packing(task.types, task.container(task.boxes[0]), tuple(places), 0.0, "knapsack")


@pytest.mark.parametrize("types", [1, 2, 30])
def test_neighbours_differ_in_colour(types) -> None:
    colors = pictures.part_colors(grid(60, types))
    assert all(np.abs(np.subtract(*pair)).max() > 0.05 for pair in pairwise(colors))
    if types == 2:
        assert not set(colors[::2]) & set(colors[1::2])
    hues = {round(colorsys.rgb_to_hsv(*color)[0], 2) for color in colors[::types]}
    assert (len(hues) == 1) == (types > 1)  # all hues where there is nothing else to tell apart


# The command


def stl(folder: Path, name: str, mesh: trimesh.Trimesh) -> Path:
    mesh.export(folder / f"{name}.stl")
    return folder / f"{name}.stl"


COMMAND = ("--workers", 1, "--iterations", 20)


def test_all_is_required_on_request(tmp_path) -> None:
    parts = tmp_path / "parts"
    parts.mkdir()
    stl(parts, "cube", creation.box((10, 10, 10)))
    arguments = ("pack", parts, "--box", "11x11x11mm", *COMMAND, "--require-all")
    assert "not all" not in packit(*arguments, "--out", tmp_path / "one")
    stl(parts, "long", creation.box((50, 10, 10)))
    (parts / "broken.stl").write_text("nothing")
    with pytest.raises(AssertionError, match="not all is packed: 1 part left out and 1 file not"):
        packit(*arguments, "--out", tmp_path / "other")
    assert record(tmp_path / "other")["items"]


def test_square_brackets_in_names_are_printed(tmp_path) -> None:
    file = stl(tmp_path, "cube [x] [bold]", creation.box((10, 10, 10)))
    out = tmp_path / "out [red]"
    output = packit("pack", file, "--box", "11x11x11mm", *COMMAND, "--out", out)
    assert "cube [x] [bold]  " in output and f"wrote {out}: 1 parts" in output


def test_a_film_that_can_not_be_drawn_is_a_warning(tmp_path, monkeypatch, caplog) -> None:
    monkeypatch.setattr(exports, "write_film", fail)
    file = stl(tmp_path, "cube", creation.box((10, 10, 10)))
    packit("pack", file, "--box", "11x11x11mm", *COMMAND, "--film", "--out", tmp_path / "out")
    assert "packing.gif is not written: more triangles" in caplog.text


def test_notes_on_many_parts_are_one(monkeypatch) -> None:
    monkeypatch.setattr(prepared, "TRIANGLES", 100)
    balls = [Part(f"ball-{n}", creation.icosphere(3, radius=9 + n / 9)) for n in range(12)]
    rough = PackSettings(workers=1, accuracy=2.0)
    task = prepared_task(balls, (40, 40, 40), "volume", rough)
    (note,) = [each for each in task.notes if "triangles reduced" in each]
    assert note.startswith("12 parts (ball-0, ball-1, ") and "and 4 more" in note
    few = prepared_task(balls[:2], (40, 40, 40), "volume", rough)
    assert len([each for each in few.notes if "triangles reduced" in each]) == 2


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38])
def test_meshes_that_are_not_finite_cause_no_warnings_of_numpy(tmp_path, value) -> None:
    box = creation.box((10, 10, 10))
    box.vertices[0] = value
    with np.errstate(all="ignore"):
        stl(tmp_path, "bad", box)
    stl(tmp_path, "good", creation.box((10, 10, 10)))
    task = prepared_task([tmp_path], (40, 40, 40), "volume", QUICK)
    assert [each.part.name for each in task.parts if each.part.name != "bad"] == ["good"]


# The time


def test_steps_are_announced(tmp_path) -> None:
    steps: list[tuple[str, int, int]] = []
    pack(
        [cube(count=2), cube("other")],
        (31, 11, 11),
        out=tmp_path,
        settings=QUICK,
        progress=lambda *step: steps.append(step),
    )
    names = list(dict.fromkeys(step for step, _, _ in steps))
    assert names[:3] == ["reading", "preparing", "packing"]
    assert names[3:6] == ["writing the record", "checking the files", "checking the distances"]
    assert names[6:] == [f"writing {step}" for step in STEPS]
    assert ("preparing", 2, 2) in steps and ("checking the files", 2, 3) in steps
    assert all(done <= total for _, done, total in steps)


def everyday(count: int, folder: Path) -> Path:
    """Write so many shapes of the library, by seed, as STL files of 20 to 60 mm."""
    library = ShapeLibrary.open("everyday")
    rng = np.random.default_rng(1)
    ids = sorted(library)
    rng.shuffle(ids)
    folder.mkdir()
    for id in ids[:count]:
        mesh = library[id].mesh.copy()
        mesh.apply_scale(rng.uniform(20, 60) / max(mesh.extents))
        mesh.export(folder / f"{id.replace('/', '_')}.stl")
    return folder


@pytest.mark.parametrize(
    ("count", "box"),
    [
        (8, "100x100x100mm"),
        pytest.param(500, "300x300x300mm", marks=pytest.mark.slow),
    ],
)
def test_many_detailed_parts_are_packed_to_the_last_file(tmp_path, count, box, caplog) -> None:
    parts = everyday(count, tmp_path / "parts")
    output = packit("pack", parts, "--box", box, "--time", "4s", "--out", tmp_path / "out")
    assert "no problems" in output
    assert {"meshes", "packing.json", *STEPS} == {
        file.name for file in (tmp_path / "out").iterdir()
    }


@pytest.mark.slow
def test_the_first_packing_ends_on_time(tmp_path) -> None:
    parts = everyday(100, tmp_path / "parts")
    task = prepared_task([parts], "200x200x200mm", "volume", PackSettings())
    assert len(task.parts) == 100
    before = time.perf_counter()
    pack([parts], "200x200x200mm", time=1, settings=PackSettings(workers=1))
    assert time.perf_counter() - before < 120
