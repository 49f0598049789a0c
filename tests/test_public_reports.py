"""Files and requests of public bug reports of other programs, as PackIt-Sim handles them.

The tables in `docs/trust/public-reports` link each report, and name its test here or elsewhere.
"""

from __future__ import annotations

import csv
import json
import re
import struct
import zipfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import PackedParts, PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts import check, export, table
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.results import exports
from tests.foreign_files import (
    ROOT,
    ascii_stl,
    at,
    binary_stl,
    block_glb,
    components,
    items,
    mesh_xml,
    model,
    package,
    thing,
    write_glb,
)

FOLDER = Path(__file__).parent
OWN = Path(__file__).name

PAGE = FOLDER.parent / "docs" / "trust" / "public-reports.md"

TABLES = sorted(PAGE.with_suffix("").glob("*.csv"))

REPORT = re.compile(
    r"\[(?P<title>[^\]]+)\]"
    r"\(https://github\.com/[\w.-]+/(?P<repository>[\w.-]+)/(issues|pull)/(?P<number>\d+)\)"
)
"""A report in the first cell of a row."""

TEST = re.compile(r"`(?:(?P<file>test_\w+\.py)::)?(?P<name>test_\w+)`")
"""The last cell of a row, unless it says why there is no test."""

BLOCK = creation.box((30, 20, 10))

FACES = BLOCK.faces.tolist()


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than all else here."""
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


def task(
    *sources: Path, box: str = "1000x1000x1000mm", unit: str = "mm", **reading: Any
) -> PackTask:
    """Read and prepare parts."""
    settings = PackSettings(unit="mm", reading=ReadSettings(unit=unit, **reading))
    return prepared_task(sources, box, "volume", settings)


def one(*sources: Path, **settings: Any) -> PreparedPart:
    """Read and prepare the only part."""
    (part,) = task(*sources, **settings).parts
    return part


def sizes(part: PreparedPart) -> list[float]:
    return sorted(part.item_type.extents.round(6).tolist())


def quick(parts: Sequence[Part | Path], box: str, **settings: Any) -> PackedParts:
    """Pack a few parts, and check them by their files."""
    objective = settings.pop("objective", "count")
    packed = pack(
        parts, box, objective, settings=PackSettings(workers=1, iterations=200, **settings)
    )
    assert check(packed).problems == ()
    return packed


def slab(x: float, y: float, z: float, **settings: Any) -> Part:
    return Part("slab", creation.box((x, y, z)), **settings)


# --- the tables


@cache
def rows() -> list[list[str]]:
    found = []
    for file in TABLES:
        header, *own = csv.reader(file.read_text(encoding="utf-8").splitlines())
        assert header == ["reports", "tried", "result", "test"], file
        found += own
    return found


def reports() -> list[re.Match[str]]:
    return [report for row in rows() for report in REPORT.finditer(row[0])]


def names_in(file: str) -> set[str]:
    text = (FOLDER / file).read_text(encoding="utf-8")
    return set(re.findall(r"^def (test_\w+)", text, re.MULTILINE))


def test_every_report_has_a_test_or_a_reason() -> None:
    for row in rows():
        assert len(row) == 4 and all(row), row
        assert "; ".join(report[0] for report in REPORT.finditer(row[0])) == row[0], row
        named = TEST.findall(row[3])
        assert named or row[3].startswith("none: "), row
        for file, name in named:
            assert name in names_in(file or OWN), row


def test_every_report_is_listed_once_and_titled_by_its_link() -> None:
    links = [report[0].partition("](")[2] for report in reports()]
    assert len(set(links)) == len(links) > 60
    for report in reports():
        assert report["title"].startswith(f"{report['repository']} {report['number']}: "), report
    assert f" {len(links)} reports and requests" in PAGE.read_text(encoding="utf-8")


def test_every_test_here_is_in_a_table() -> None:
    named = {name for row in rows() for file, name in TEST.findall(row[3]) if not file}
    own = {name for name in names_in(OWN) if not name.startswith("test_every_")}
    assert own == named


# --- 3MF


def plate(folder: Path, build: str, name: str = "plate.3mf", **settings: str) -> Path:
    """A plate with items of one block, which is object 1."""
    return package(folder / name, model(thing(1, mesh_xml(BLOCK)), build, **settings))


@pytest.mark.parametrize(
    ("unit", "mm"),
    [("micron", 1e-3), ("centimeter", 10), ("inch", 25.4), ("foot", 304.8), ("meter", 1000)],
)
def test_3mf_has_the_size_that_its_unit_says(tmp_path, unit, mm) -> None:
    file = plate(tmp_path, items((1, "")), unit=unit)
    part = one(file, box="100x100x100m")
    assert sizes(part) == pytest.approx([10 * mm, 20 * mm, 30 * mm])


def test_the_unit_of_3mf_applies_to_translations(tmp_path) -> None:
    pair = thing(2, components((1, at()), (1, at(x=90))))
    text = model(thing(1, mesh_xml(BLOCK)) + pair, items((2, at(x=7, y=3))), unit="inch")
    part = one(package(tmp_path / "pair.3mf", text), box="9x9x9m")
    assert sizes(part) == pytest.approx([254, 508, 120 * 25.4])


def test_an_object_of_components_is_one_rigid_part(tmp_path) -> None:
    upright = at(x=20, linear="0 0 1 0 1 0 -1 0 0")
    angle = thing(2, components((1, at()), (1, upright)), 'name="Angle"')
    text = model(thing(1, mesh_xml(BLOCK)) + angle, items((2, at(x=50)), (2, at(y=80))))
    part = one(package(tmp_path / "angles.3mf", text))
    assert part.part.count == 2 and sizes(part) == pytest.approx([20, 30, 40])
    assert part.volume == pytest.approx(2 * 6000, rel=0.01)


def test_the_scale_of_an_item_is_applied(tmp_path) -> None:
    small = BLOCK.copy().apply_scale(1 / 1000)
    text = model(thing(1, mesh_xml(small)), items((1, at(linear="1000 0 0 0 1000 0 0 0 1000"))))
    part = one(package(tmp_path / "cura.3mf", text))
    assert sizes(part) == pytest.approx([10, 20, 30]) and part.volume == pytest.approx(6000)


def test_meshes_in_other_models_of_the_package_are_read(tmp_path) -> None:
    path = 'p:path="/3D/Objects/block.model"'
    root = model(thing(2, components((1, f"{path} {at()}"))), items((2, at(x=9)), (2, at(y=90))))
    file = package(tmp_path / "a.3mf", root, block=model(thing(1, mesh_xml(BLOCK)), ""))
    part = one(file)
    assert part.part.count == 2 and part.volume == pytest.approx(6000)
    assert sizes(part) == [10, 20, 30]


def test_equal_numbers_in_different_models_are_different_objects(tmp_path) -> None:
    names = ("block", "rod")
    own = "".join(
        thing(n, components((1, f'p:path="/3D/Objects/{name}.model"')))
        for n, name in enumerate(names, start=2)
    )
    rod = creation.box((5, 5, 40))
    file = package(
        tmp_path / "two.3mf",
        model(own, items((2, ""), (3, at(x=60)))),
        block=model(thing(1, mesh_xml(BLOCK)), ""),
        rod=model(thing(1, mesh_xml(rod)), ""),
    )
    assert sorted(part.volume for part in task(file).parts) == pytest.approx([1000, 6000])


def test_a_plate_of_copies_is_counted_packed_and_verified(tmp_path) -> None:
    file = plate(tmp_path, items(*((1, at(x=40 * n)) for n in range(6))))
    packed = quick([file], "62x42x32mm")
    assert packed.count == 6 and packed.task.parts[0].part.count == 6
    export(packed, tmp_path / "out")
    assert verify_packing(tmp_path / "out" / "packing.json").problems == ()
    assert len(list((tmp_path / "out" / "meshes").iterdir())) == 1


def test_items_that_are_not_to_be_printed_are_left_out_and_named(tmp_path) -> None:
    file = plate(tmp_path, items((1, 'printable="1"'), (1, f'{at(x=50)} printable="0"')))
    found = task(file)
    assert [part.part.count for part in found.parts] == [1]
    assert any("printable" in note for note in found.notes)


def test_the_mirror_image_of_an_item_is_another_part_of_the_same_volume(tmp_path) -> None:
    stairs = trimesh.util.concatenate(
        [creation.box((30, 10, 10)), creation.box((10, 10, 10)).apply_translation((10, 10, 0))]
    )
    text = model(
        thing(1, mesh_xml(stairs)),
        items((1, at()), (1, at(x=90, linear="-1 0 0 0 1 0 0 0 1"))),
    )
    found = task(package(tmp_path / "mirror.3mf", text)).parts
    assert [part.part.count for part in found] == [1, 1]
    assert [part.volume for part in found] == pytest.approx([4000, 4000], rel=0.01)


def test_objects_without_triangles_stop_no_others_or_are_named(tmp_path) -> None:
    empty = "<mesh><vertices/><triangles/></mesh>"
    text = model(thing(1, mesh_xml(BLOCK)) + thing(2, empty), items((1, ""), (2, at(x=99))))
    file = package(tmp_path / "fusion.3mf", text)
    BLOCK.export(tmp_path / "good.stl")
    found = task(file, tmp_path / "good.stl")
    assert found.unread or found.notes
    assert any(part.volume == pytest.approx(6000) for part in found.parts)


def test_flat_triangles_of_3mf_are_no_obstacle(tmp_path) -> None:
    text = model(thing(1, mesh_xml(BLOCK, '<triangle v1="0" v2="0" v3="0"/>')), items((1, "")))
    assert one(package(tmp_path / "flat.3mf", text)).volume == pytest.approx(6000)


@pytest.mark.parametrize(
    "broken", ['v1="0" v3="2"', 'v1="0" v2="3abc" v3="2"', 'v1="0" v2="-1" v3="2"']
)
def test_indices_of_3mf_that_are_no_numbers_are_an_error(tmp_path, broken) -> None:
    text = model(thing(1, mesh_xml(BLOCK, f"<triangle {broken}/>")), items((1, "")))
    with pytest.raises(ArgumentError, match=r"broken\.3mf"):
        task(package(tmp_path / "broken.3mf", text))


def test_the_only_object_of_3mf_is_named_after_the_file(tmp_path) -> None:
    text = model(thing(1, mesh_xml(BLOCK), 'name="Body1"'), items((1, "")))
    assert one(package(tmp_path / "lid.3mf", text)).part.name == "lid/Body1"


def test_objects_of_3mf_are_named_after_the_file_and_the_object(tmp_path) -> None:
    rod = mesh_xml(creation.box((5, 5, 40)))
    own = thing(1, mesh_xml(BLOCK), 'name="Крышка"') + thing(2, rod, 'name="R &amp; D &lt;2&gt;"')
    file = package(tmp_path / "kit.3mf", model(own, items((1, ""), (2, at(x=60)))))
    assert {part.part.name for part in task(file).parts} == {"kit/Крышка", "kit/R & D <2>"}


def test_names_in_the_settings_of_bambu_studio_are_read(tmp_path) -> None:
    rod = mesh_xml(creation.box((5, 5, 40)))
    own = thing(1, mesh_xml(BLOCK)) + thing(2, rod)
    file = package(tmp_path / "kit.3mf", model(own, items((1, ""), (2, at(x=60)))))
    names = "".join(
        f'<object id="{n}"><metadata key="name" value="{name}"/></object>'
        for n, name in ((1, "lid"), (2, "pin"))
    )
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("Metadata/model_settings.config", f"<config>{names}</config>")
    assert {part.part.name for part in task(file).parts} == {"kit/lid", "kit/pin"}


def test_supports_and_modifiers_of_prusa_slicer_are_not_solid(tmp_path) -> None:
    blocker = creation.box((9, 9, 90))
    both = trimesh.util.concatenate([BLOCK, blocker])
    file = package(tmp_path / "cover.3mf", model(thing(1, mesh_xml(both)), items((1, ""))))
    volumes = "".join(
        f'<volume firstid="{first}" lastid="{first + 11}">'
        f'<metadata type="volume" key="volume_type" value="{kind}"/></volume>'
        for first, kind in ((0, "ModelPart"), (12, "SupportBlocker"))
    )
    with zipfile.ZipFile(file, "a") as archive:
        text = f'<config><object id="1" instances_count="1">{volumes}</object></config>'
        archive.writestr("Metadata/Slic3r_PE_model.config", text)
    found = task(file)
    assert sizes(found.parts[0]) == [10, 20, 30] and any("support" in note for note in found.notes)


@pytest.mark.parametrize("kind", ["modifier_part", "support_blocker", "negative_part"])
def test_modifiers_of_bambu_studio_are_not_solid_or_named(tmp_path, kind) -> None:
    blocker = creation.box((9, 9, 9))
    own = thing(1, mesh_xml(BLOCK)) + thing(2, mesh_xml(blocker))
    text = model(own + thing(3, components((1, ""), (2, at(x=90)))), items((3, "")))
    file = package(tmp_path / "cover.3mf", text)
    kinds = f'<part id="1" subtype="normal_part"/><part id="2" subtype="{kind}"/>'
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr(
            "Metadata/model_settings.config", f'<config><object id="3">{kinds}</object></config>'
        )
    found = task(file)
    assert any("cover" in note and ("modifiers" in note or "cuts" in note) for note in found.notes)
    if kind != "negative_part":
        assert sizes(found.parts[0]) == [10, 20, 30]


def test_components_are_packed_together_or_apart_as_asked(tmp_path) -> None:
    file = plate(tmp_path, items((1, at()), (1, at(x=40))))
    assert task(file).parts[0].part.count == 2
    (joined,) = task(file, split=False).parts
    assert joined.part.count == 1 and sizes(joined) == [10, 20, 70]


# --- meshes


def changed(value: Any) -> Any:
    triangles = BLOCK.triangles.copy()
    triangles[3, 1] = value
    return triangles


BROKEN = {
    "nan": lambda file: binary_stl(file, changed((1, 2, np.nan))),
    "garbage": lambda file: binary_stl(file, changed((1.5e31, 2.9e25, -1.1e23))),
    "empty": lambda file: file.write_bytes(b""),
    "no-triangles": lambda file: binary_stl(file, []),
    "no-count": lambda file: binary_stl(file, BLOCK.triangles, count=0),
    "wrong-count": lambda file: binary_stl(file, BLOCK.triangles, count=2_205_010),
    "comma": lambda file: file.write_text(ascii_stl("a", BLOCK).replace(".", ",")),
    "cut": lambda file: file.write_bytes(BLOCK.export(file_type="stl")[:-30]),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_stl_is_named_and_the_others_are_packed(tmp_path, kind) -> None:
    BROKEN[kind](tmp_path / f"{kind}.stl")
    BLOCK.export(tmp_path / "good.stl")
    found = task(tmp_path)
    assert [part.part.name for part in found.parts] == ["good"]
    assert [Path(each.source).name for each in found.unread] == [f"{kind}.stl"]
    assert len(found.unread[0].reason) > 10


@pytest.mark.parametrize("header", [b"solid block", b"solid block\nfacet", b"\xef\xbb\xbfsolid"])
def test_a_binary_stl_may_begin_like_an_ascii_one(tmp_path, header) -> None:
    part = one(binary_stl(tmp_path / "a.stl", BLOCK.triangles, header=header))
    assert part.volume == pytest.approx(6000)


def test_an_ascii_stl_may_begin_with_spaces(tmp_path) -> None:
    (tmp_path / "a.stl").write_text("  \n \t" + ascii_stl("block", BLOCK))
    assert one(tmp_path / "a.stl").volume == pytest.approx(6000)


def test_all_solids_of_an_stl_are_read(tmp_path) -> None:
    other = BLOCK.copy().apply_translation((50, 0, 0))
    (tmp_path / "two.stl").write_text(ascii_stl("a", BLOCK) + ascii_stl("b", other))
    found = task(tmp_path / "two.stl")
    assert sizes(found.parts[0]) == [10, 20, 80] and "--separate" in found.notes[-1]
    assert sum(part.part.count for part in task(tmp_path / "two.stl", split=True).parts) == 2


@pytest.mark.parametrize(
    "kinds", ["uchar int", "uint8 int32", "uint uint", "ushort uint", "int16 int8"]
)
def test_lists_of_ply_have_numbers_of_any_type(tmp_path, kinds) -> None:
    lines = ["ply", "format ascii 1.0", "element vertex 8"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += ["element face 12", f"property list {kinds} vertex_indices", "end_header"]
    lines += [" ".join(map(str, point)) for point in BLOCK.vertices.tolist()]
    lines += ["3 " + " ".join(map(str, face)) for face in FACES]
    (tmp_path / "a.ply").write_text("\n".join(lines) + "\n")
    assert one(tmp_path / "a.ply").volume == pytest.approx(6000)


def test_comments_and_blank_lines_of_off_are_skipped(tmp_path) -> None:
    lines = ["OFF", "# a block", "", "8 12 0", "# its vertices"]
    lines += [" ".join(map(str, point)) for point in BLOCK.vertices.tolist()]
    lines += ["", "# its faces", *("3 " + " ".join(map(str, face)) for face in FACES)]
    (tmp_path / "a.off").write_text("\n".join(lines) + "\n")
    assert one(tmp_path / "a.off").volume == pytest.approx(6000)


def test_negative_indices_of_obj_count_from_where_they_are(tmp_path) -> None:
    lines = []
    for shift in (0, 50):
        lines += [
            "v {} {} {}".format(*p) for p in (BLOCK.vertices + np.array((shift, 0, 0))).tolist()
        ]
        lines += ["f " + " ".join(str(i - 8) for i in face) for face in FACES]
    (tmp_path / "a.obj").write_text("\n".join(lines) + "\n")
    part = one(tmp_path / "a.obj")
    assert part.volume == pytest.approx(12000, rel=0.01) and sizes(part) == [10, 20, 80]


def test_a_part_far_from_the_origin_keeps_its_size(tmp_path) -> None:
    far = BLOCK.copy().apply_translation((10_000, -20_000, 10_000))
    far.export(tmp_path / "far.stl")
    packed = quick([tmp_path / "far.stl"], "31x21x11mm")
    assert packed.count == 1 and packed.task.parts[0].volume == pytest.approx(6000, rel=1e-3)


def test_a_part_in_survey_coordinates_is_as_exact_as_its_file(tmp_path) -> None:
    far = BLOCK.copy().apply_translation((400_000, 800_000, 0))
    far.export(tmp_path / "far.obj", digits=9)
    assert sizes(one(tmp_path / "far.obj")) == pytest.approx([10, 20, 30], abs=1e-6)


def inside_out() -> trimesh.Trimesh:
    mesh = BLOCK.copy()
    mesh.invert()
    return mesh


def partly_turned() -> trimesh.Trimesh:
    faces = BLOCK.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return trimesh.Trimesh(BLOCK.vertices, faces, process=False)


@pytest.mark.parametrize("make", [inside_out, partly_turned])
def test_normals_do_not_decide_what_is_solid(tmp_path, make) -> None:
    make().export(tmp_path / "a.stl")
    assert one(tmp_path / "a.stl").volume == pytest.approx(6000, rel=0.02)


@pytest.mark.parametrize("is_turned", [False, True])
def test_nothing_is_packed_into_a_closed_cavity(tmp_path, is_turned) -> None:
    hollow = creation.box((20, 20, 20))
    if is_turned:
        hollow.invert()
    trimesh.util.concatenate([creation.box((30, 30, 30)), hollow]).export(tmp_path / "hollow.stl")
    creation.box((10, 10, 10)).export(tmp_path / "cube.stl")
    packed = quick(
        [tmp_path / "hollow.stl", tmp_path / "cube.stl"], "31x31x31mm", objective="volume"
    )
    assert [packed.part(each).part.name for _, each in packed.placements] == ["hollow"]


def test_a_small_hole_does_not_change_the_volume(tmp_path) -> None:
    fine = BLOCK.subdivide().subdivide().subdivide()
    trimesh.Trimesh(fine.vertices, fine.faces[1:], process=False).export(tmp_path / "a.stl")
    found = task(tmp_path / "a.stl")
    assert found.parts[0].volume == pytest.approx(6000, rel=0.01)
    assert any("hole" in note for note in found.notes)


def test_a_mesh_that_stays_open_is_named(tmp_path) -> None:
    trimesh.Trimesh(BLOCK.vertices, BLOCK.faces[2:], process=False).export(tmp_path / "tray.stl")
    assert any("tray" in note and "open" in note for note in task(tmp_path / "tray.stl").notes)


def test_sizes_are_never_changed_and_doubtful_ones_are_named(tmp_path) -> None:
    BLOCK.copy().apply_scale(1 / 1000).export(tmp_path / "metres.stl")
    found = task(tmp_path / "metres.stl", box="300x300x300mm")
    assert sizes(found.parts[0]) == pytest.approx([0.01, 0.02, 0.03])
    assert any("metres" in note and "unit" in note for note in found.notes)
    assert sizes(one(tmp_path / "metres.stl", unit="m")) == pytest.approx([10, 20, 30])


@pytest.mark.parametrize(("unit", "mm"), [('<unit meter="0.0254" name="inch"/>', 25.4), ("", 1000)])
def test_dae_has_the_size_that_its_unit_says(tmp_path, unit, mm) -> None:
    points = " ".join(map(str, BLOCK.vertices.ravel().tolist()))
    faces = " ".join(map(str, BLOCK.faces.ravel().tolist()))
    (tmp_path / "a.dae").write_text(
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        f"{unit}<up_axis>Z_UP</up_axis></asset><library_geometries><geometry id='g'><mesh>"
        f"<source id='s'><float_array id='f' count='24'>{points}</float_array><technique_common>"
        "<accessor source='#f' count='8' stride='3'><param name='X' type='float'/><param name='Y' "
        "type='float'/><param name='Z' type='float'/></accessor></technique_common></source>"
        "<vertices id='v'><input semantic='POSITION' source='#s'/></vertices><triangles count='12'>"
        f"<input semantic='VERTEX' source='#v' offset='0'/><p>{faces}</p></triangles></mesh>"
        "</geometry></library_geometries><library_visual_scenes><visual_scene id='c'><node id='n'>"
        "<instance_geometry url='#g'/></node></visual_scene></library_visual_scenes><scene>"
        "<instance_visual_scene url='#c'/></scene></COLLADA>"
    )
    assert sizes(one(tmp_path / "a.dae", box="99x99x99m")) == pytest.approx(
        [10 * mm, 20 * mm, 30 * mm]
    )


# --- names

NAMES = [
    "töwers.stl",
    "totem_é_tarde.stl",
    "колесо2.stl",  # noqa: RUF001
    "部品 ñ.stl",
    "a & b <c>.stl",
    'it\'s "q" #7*.stl',
    "[red] 50%.stl",
    "part=2.stl",
    "-dash.stl",
    "UPPER.STL",
    "🔧.stl",
]


def test_files_of_any_name_are_found_and_named_as_they_are(tmp_path) -> None:
    folder = tmp_path / "źródła [1]"
    folder.mkdir()
    for name in NAMES:
        BLOCK.export(folder / name, file_type="stl")
    found = task(folder)
    assert {part.part.name for part in found.parts} == {name[:-4] for name in NAMES}
    for name in NAMES:
        assert one(folder / name).part.name == name[:-4]


@pytest.mark.parametrize("suffix", ["3mf", "glb", "ply", "off", "obj"])
def test_accents_in_file_names_do_not_matter_to_any_reader(tmp_path, suffix) -> None:
    file = tmp_path / f"Pompe péristaltique (v6).{suffix}"
    creation.box((0.03, 0.02, 0.01) if suffix == "glb" else (30, 20, 10)).export(file)
    assert sizes(one(file)) == pytest.approx([10, 20, 30])


@pytest.fixture(name="named", scope="module")
def _named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A packing of parts with all kinds of names, written to a folder with such a name."""
    folder = tmp_path_factory.mktemp("names")
    for name in ("деталь 1", "右手", "A / B & <C>", "Amouroux 3.5 Fati.stl"):
        stem = name.replace("/", "_")
        BLOCK.export(folder / f"{stem}.stl")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
        packed = quick([folder], "65x45x25mm")
        export(packed, folder / "проекты [x]")
    return folder / "проекты [x]"


WRITTEN = {"деталь 1", "右手", "A _ B & <C>", "Amouroux 3.5 Fati.stl"}


def test_names_are_in_the_glb_as_they_are(named) -> None:
    content = (named / "packing.glb").read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    nodes = json.loads(content[20 : 20 + length])["nodes"]
    found = {node["name"].partition(" ")[2] for node in nodes if "mesh" in node}
    assert found == WRITTEN


def test_names_are_in_the_3mf_as_they_are(named) -> None:
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf is not installed")
    opened = lib3mf.get_wrapper().CreateModel()
    reader = opened.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(named / "packing.3mf"))
    assert reader.GetWarningCount() == 0
    entries, found = opened.GetBuildItems(), set()
    while entries.MoveNext():
        found.add(entries.GetCurrent().GetPartNumber().partition(" ")[2])
    assert found == WRITTEN


def test_the_3mf_has_only_objects_of_the_type_that_is_printed(named) -> None:
    with zipfile.ZipFile(named / "packing.3mf") as archive:
        text = archive.read(ROOT).decode()
    kinds = re.findall(r"<object[^>]*>", text)
    assert kinds and all('type="model"' in kind or "type=" not in kind for kind in kinds)


def test_the_record_of_any_names_is_verified(named) -> None:
    assert verify_packing(named / "packing.json").problems == ()
    record = json.loads((named / "packing.json").read_text(encoding="utf-8"))
    assert {item["name"] for item in record["items"]} == WRITTEN


# --- glTF


def test_instances_of_gltf_are_counted(tmp_path) -> None:
    scene, block = trimesh.Scene(), creation.box((0.03, 0.02, 0.01))
    for n in range(10):
        place = trimesh.transformations.translation_matrix((0.05 * n, 0, 0))
        scene.add_geometry(block, f"node{n}", "block", transform=place)
    scene.export(tmp_path / "ten.glb")
    assert one(tmp_path / "ten.glb", split=True).part.count == 10
    assert sizes(one(tmp_path / "ten.glb")) == pytest.approx([10, 20, 480])


def test_instances_by_the_gpu_are_counted(tmp_path) -> None:
    header, binary = block_glb()
    places = np.array([(0.05 * n, 0, 0) for n in range(5)], "<f4").tobytes()
    header["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(binary), "byteLength": len(places)}
    )
    header["accessors"].append(
        {
            "bufferView": len(header["bufferViews"]) - 1,
            "componentType": 5126,
            "count": 5,
            "type": "VEC3",
        }
    )
    header["buffers"][0]["byteLength"] = len(binary) + len(places)
    where = {"TRANSLATION": len(header["accessors"]) - 1}
    (node,) = [node for node in header["nodes"] if "mesh" in node]
    node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": where}}
    header["extensionsUsed"] = header["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    file = write_glb(tmp_path / "five.glb", header, binary + places)
    assert one(file, split=True).part.count == 5


@pytest.mark.parametrize("extension", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
def test_an_extension_that_is_required_and_not_known_is_named(tmp_path, extension) -> None:
    header, binary = block_glb()
    header["extensionsUsed"] = header["extensionsRequired"] = [extension]
    write_glb(tmp_path / "packed.glb", header, binary)
    BLOCK.export(tmp_path / "good.stl")
    found = task(tmp_path)
    assert [part.part.name for part in found.parts] == ["good"]
    assert extension in found.unread[0].reason


@pytest.mark.parametrize("mode", [5, 6])
def test_strips_of_gltf_are_read_and_fans_are_refused(tmp_path, mode) -> None:
    header, binary = block_glb()
    points = np.array([(0.1, 0, 0), (0.13, 0, 0), (0.1, 0.02, 0), (0.1, 0, 0.01)], "<f4")
    indices = np.array({5: [0, 1, 2, 3, 0, 1], 6: [1, 2, 3, 0, 2]}[mode], "<u4")
    for data in (indices.tobytes(), points.tobytes()):
        header["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)}
        )
        binary += data
    views, first = len(header["bufferViews"]), len(header["accessors"])
    header["accessors"] += [
        {"bufferView": views - 2, "componentType": 5125, "count": len(indices), "type": "SCALAR"},
        {"bufferView": views - 1, "componentType": 5126, "count": 4, "type": "VEC3"},
    ]
    header["buffers"][0]["byteLength"] = len(binary)
    more = {"attributes": {"POSITION": first + 1}, "indices": first, "mode": mode}
    header["meshes"][0]["primitives"].append(more)
    file = write_glb(tmp_path / "two.glb", header, binary)
    if mode == 5:
        assert max(sizes(one(file))) > 100
    else:
        with pytest.raises(ArgumentError, match="fans"):
            one(file)


@pytest.mark.parametrize("is_normalized", [False, True])
def test_quantized_positions_are_read_if_plain_and_refused_if_normalized(
    tmp_path, is_normalized
) -> None:
    header, binary = block_glb()
    (node,) = [node for node in header["nodes"] if "mesh" in node]
    mesh = header["meshes"][node["mesh"]]["primitives"][0]
    signs = np.sign(creation.box().vertices).astype("<i2")
    points = np.zeros((8, 4), "<i2")
    points[:, :3] = signs * (32767 if is_normalized else 100)
    faces = creation.box().faces.astype("<u4").tobytes()
    binary = faces + points.tobytes()
    header["buffers"] = [{"byteLength": len(binary)}]
    header["bufferViews"] = [
        {"buffer": 0, "byteOffset": 0, "byteLength": len(faces)},
        {"buffer": 0, "byteOffset": len(faces), "byteLength": 64, "byteStride": 8},
    ]
    header["accessors"] = [
        {"bufferView": 0, "componentType": 5125, "count": 36, "type": "SCALAR"},
        {
            "bufferView": 1,
            "componentType": 5122,
            "count": 8,
            "type": "VEC3",
            "normalized": is_normalized,
        },
    ]
    mesh.update(indices=0, attributes={"POSITION": 1})
    half = 1.0 if is_normalized else 100.0
    node.pop("matrix", None)
    node["scale"] = [0.015 / half, 0.01 / half, 0.005 / half]
    header["extensionsUsed"] = header["extensionsRequired"] = ["KHR_mesh_quantization"]
    file = write_glb(tmp_path / "quantized.glb", header, binary)
    if is_normalized:
        with pytest.raises(ArgumentError, match="normalized integers"):
            one(file)
    else:
        assert sizes(one(file)) == pytest.approx([10, 20, 30])


def test_nodes_below_nodes_are_where_the_scene_has_them(tmp_path) -> None:
    header, binary = block_glb()
    (node,) = [node for node in header["nodes"] if "mesh" in node]
    mesh = node["mesh"]
    header["nodes"] = [
        {"children": [1, 2]},
        {"mesh": mesh, "translation": [0.1, 0, 0]},
        {"children": [3], "translation": [0.2, 0, 0], "rotation": [0, 0, 0.5**0.5, 0.5**0.5]},
        {"mesh": mesh, "translation": [0.1, 0, 0]},
        {"mesh": mesh, "translation": [9, 9, 9]},
    ]
    header["scenes"], header["scene"] = [{"nodes": [0]}], 0
    file = write_glb(tmp_path / "nested.glb", header, binary)
    assert sizes(one(file)) == pytest.approx([10, 125, 125])


# --- lists


def listed(folder: Path, text: str, name: str = "parts.csv", encoding: str = "utf-8") -> PackTask:
    for part in ("lid.stl", "Körper.stl"):
        BLOCK.export(folder / part)
    (folder / name).write_bytes(text.encode(encoding))
    return task(folder / name)


LISTS = {
    "semicolons": ("file;count;density\nlid.stl;2;7,8\nKörper.stl;3;2,7\n", "utf-8"),
    "commas-in-fields": (
        'file,count,name\nlid.stl,2,"Small (.07"", 1.8 mm), wide"\nKörper.stl,3,x\n',
        "utf-8",
    ),
    "more-commas": ("file;count;name\nlid.stl;2;a,b,c,d,e\nKörper.stl;3;1,5, 2,5, 3,5\n", "utf-8"),
    "tabs": ("file\tcount\nlid.stl\t2\nKörper.stl\t3\n", "utf-16"),
    "excel": ("\ufeffFile,Count\r\nlid.stl,2.0\r\nKörper.stl,3\r\n,\r\n", "utf-8"),
    "windows": ("Datei;count\r\nlid.stl;2\r\nKörper.stl;3\r\n".replace("Datei", "file"), "cp1252"),
}


@pytest.mark.parametrize("kind", LISTS)
def test_lists_of_spreadsheets_are_read(tmp_path, kind) -> None:
    text, encoding = LISTS[kind]
    found = listed(tmp_path, text, encoding=encoding)
    assert [part.part.count for part in found.parts] == [2, 3]
    if kind == "semicolons":
        assert [part.part.density for part in found.parts] == [7.8, 2.7]


# --- packing


def test_sums_of_decimal_lengths_fit_exactly() -> None:
    assert quick([slab(12, 10, 0.7, count=2)], "15x12x2mm").count == 2
    assert quick([slab(0.1, 0.1, 0.1, count=27)], "0.3x0.3x0.3mm").count == 27


@pytest.mark.parametrize("box", ["6x1x5mm", "5x1x6mm"])
def test_the_order_of_the_sides_of_the_box_does_not_matter(box) -> None:
    assert quick([slab(3, 1, 2, count=5)], box).count == 5


def test_equal_parts_fill_a_box_that_is_a_multiple_of_them() -> None:
    assert quick([slab(40, 30, 30, count=3)], "90x40x30mm").count == 3
    assert quick([slab(65, 66, 83, count=27)], "200x200x300mm").count == 27


def test_equal_parts_that_stay_upright_are_rows() -> None:
    part = slab(90, 200, 200, count=14, rotations="upright")
    assert quick([part], "250x1360x260mm").count == 14


def test_a_part_as_large_as_the_box_fits() -> None:
    assert quick([slab(210, 210, 50)], "210x210x50mm").count == 1


def test_plates_that_fit_exactly_with_their_clearance_are_all_packed() -> None:
    plates = slab(20, 20, 10, count=6)
    assert quick([plates], "62x41x10mm", clearance=1.0).count == 6
    packed = quick([plates], "64x43x12mm", clearance=1.0, wall_clearance=1.0)
    assert packed.count == 6


def test_upright_parts_stay_upright() -> None:
    part = slab(10, 10, 30, count=2, rotations="upright")
    packed = quick([part, slab(5, 5, 5)], "32x32x31mm")
    for _, each in packed.placements:
        if packed.part(each).part.rotations != "cube":
            assert packed.pose(each)[2, 2] == pytest.approx(1)
    with pytest.raises(ArgumentError, match="no part fits"):
        quick([slab(10, 10, 30, rotations="upright")], "32x32x20mm")


def test_what_is_larger_than_the_box_is_left_out_with_the_reason() -> None:
    packed = quick([slab(10, 10, 10), Part("beam", creation.box((90, 5, 5)))], "20x20x20mm")
    assert packed.count == 1
    assert [(each.name, "larger" in each.reason) for each in packed.left_out] == [("beam", True)]
    assert "beam" in table(packed)


def test_wedges_are_put_head_to_tail() -> None:
    outline = [(0, 0), (40, 0), (0, 20)]
    wedge = trimesh.Trimesh(
        [(x, y, z) for z in (0, 10) for x, y in outline],
        [(0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5)],
    )
    assert quick([Part("wedge", wedge, count=2)], "42x22x11mm").count == 2


# --- results


def test_copies_are_one_mesh_in_every_file(tmp_path) -> None:
    packed = quick([Part("ball", creation.icosphere(subdivisions=2), count=8)], "5x5x5mm")
    export(packed, tmp_path)
    with zipfile.ZipFile(tmp_path / "packing.3mf") as archive:
        root = archive.read(ROOT).decode()
    assert packed.count == 8 and root.count("<item ") == 8
    scene = trimesh.load_scene(tmp_path / "packing.glb")
    assert len(scene.geometry) <= 8 and len(scene.graph.nodes_geometry) == 8
    assert len(list((tmp_path / "meshes").iterdir())) == 1


def test_flat_triangles_do_not_spoil_the_3mf(tmp_path) -> None:
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf is not installed")
    flat = np.repeat(BLOCK.triangles[:1, :1], 3, axis=1)
    line = BLOCK.triangles[:1][:, [0, 1, 1]]
    binary_stl(tmp_path / "flat.stl", np.concatenate([BLOCK.triangles, flat, line]))
    export(quick([tmp_path / "flat.stl"], "31x21x11mm"), tmp_path / "out")
    opened = lib3mf.get_wrapper().CreateModel()
    reader = opened.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tmp_path / "out" / "packing.3mf"))
    assert reader.GetWarningCount() == 0
