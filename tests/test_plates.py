"""3MF files as slicers mean them: each item of the build is a part."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

from packit_sim.core.errors import MeshError
from packit_sim.libraries.mesh_files import read, read_parts
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.reading.file_copies import FileCopies
from packit_sim.parts.reading.files import ReadSettings, find_parts
from packit_sim.parts.results.check import check
from packit_sim.parts.results.reread_3mf import read_3mf
from packit_sim.render.export_3mf import PlacedMesh, encode_3mf
from tests import slicer_projects as projects
from tests.bad_meshes import package, stl
from tests.read_3mf import bodies
from tests.slicer_projects import CUBE, PROJECTS, ROD, mesh, model, shift

QUICK = PackSettings(workers=1, iterations=50)


def plate(file: Path, resources: str, *items: str, **options: str) -> Path:
    build = "".join(f"<item {item}/>" for item in items)
    projects.write(
        file, {"3D/3dmodel.model": model(resources, f"<build>{build}</build>", **options)}
    )
    return file


@pytest.mark.parametrize("slicer", PROJECTS)
def test_projects_of_slicers_are_read_as_they_mean_them(tmp_path: Path, slicer: str) -> None:
    write, unit_cm, expected, notes = PROJECTS[slicer]
    file = tmp_path / f"{slicer}.3mf"
    write(file)
    copy = FileCopies().add({file.name: file.read_bytes()})
    parts = read_parts(file)
    assert [(part.name, part.count) for part in parts] == [own[:2] for own in expected]
    for part, (_, _, volume, extents) in zip(parts, expected, strict=True):
        assert part.raw.mesh.is_volume and part.raw.unit_cm == unit_cm
        assert part.raw.mesh.volume == pytest.approx(volume)
        assert part.raw.mesh.extents == pytest.approx(extents)
        second = read_3mf(copy, part.node)  # the check's reader, which shares no code
        assert second.triangles == pytest.approx(np.asarray(part.raw.mesh.triangles), abs=1e-9)
    found = parts[0].raw.notes
    assert len(found) == len(notes)
    assert all(map(re.search, notes, found))
    whole, second = read(file), read_3mf(copy, None)
    assert whole.parts == sum(count for _, count, _, _ in expected)
    assert whole.mesh.volume == pytest.approx(
        sum(count * volume for _, count, volume, _ in expected)
    )
    assert np.sort(second.triangles.reshape(-1, 9), axis=0) == pytest.approx(
        np.sort(whole.mesh.triangles.reshape(-1, 9), axis=0), abs=1e-4
    )


@pytest.mark.parametrize("slicer", PROJECTS)
def test_projects_of_slicers_are_packed_and_verified(tmp_path: Path, slicer: str) -> None:
    file = tmp_path / f"{slicer}.3mf"
    PROJECTS[slicer][0](file)
    out = tmp_path / "out"
    packed = pack([file], "200x200x150mm", settings=QUICK, out=out)
    assert packed.count == sum(count for _, count, _, _ in PROJECTS[slicer][2])
    assert check(packed).problems == ()
    assert verify_packing(out / "packing.json").problems == ()
    assert len(list((out / "meshes").iterdir())) == len(PROJECTS[slicer][2])
    assert len(bodies(out / "packing.3mf")) == packed.count


def test_a_plate_of_copies_has_one_mesh(tmp_path: Path) -> None:
    items = [f'objectid="1" {shift(30 * (n % 3), 25 * (n // 3))}' for n in range(6)]
    hook = f'<object id="1" type="model" name="hook">{mesh(((0, 0, 0), (20, 20, 5)))}</object>'
    file = plate(tmp_path / "copies.3mf", hook, *items)
    packed = pack([file], "100x100x50mm", settings=QUICK, out=tmp_path / "out")
    assert packed.count == 6 and check(packed).problems == ()
    assert verify_packing(tmp_path / "out" / "packing.json").problems == ()
    assert len(list((tmp_path / "out" / "meshes").glob("copies-hook-*.obj"))) == 1
    (part,) = find_parts([file]).parts
    assert (part.name, part.count) == ("copies/hook", 6)
    whole = find_parts([file], ReadSettings(split=False))
    assert whole.parts[0].count == 1 and "6 meshes are packed as one part" in whole.notes[0]


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_a_plate_of_many(tmp_path: Path, count: int) -> None:
    items = [f'objectid="{n % 2 + 1}" {shift(30 * n)}' for n in range(count)]
    objects = f'<object id="1" name="a">{CUBE}</object><object id="2" name="b">{ROD}</object>'
    parts = read_parts(plate(tmp_path / "many.3mf", objects, *items))
    assert [(part.name, part.count) for part in parts] == [("a", count // 2), ("b", count // 2)]


def test_units_of_3mf(tmp_path: Path) -> None:
    brick = f'<object id="1">{mesh(((-1, 0, 0), (0, 0.5, 0.25)))}</object>'
    inch = plate(tmp_path / "inch.3mf", brick, f'objectid="1" {shift(2)}', unit="inch")
    (part,) = find_parts([inch]).parts
    assert part.mesh.extents * part.scale("mm") == pytest.approx((25.4, 12.7, 6.35))
    assert part.name == "inch"
    pair = (
        f'<object id="1">{mesh(((0, 0, 0), (0.02, 0.02, 0.02)))}</object>'
        f'<object id="2"><components><component objectid="1"/>'
        f'<component objectid="1" {shift(0.04)}/></components></object>'
    )
    metres = plate(tmp_path / "metres.3mf", pair, 'objectid="2"', unit="meter")
    for split in (True, False):
        (part,) = find_parts([metres], ReadSettings(split=split)).parts
        assert part.mesh.extents * part.scale("mm") == pytest.approx((60, 20, 20))
    without = model(brick, '<build><item objectid="1"/></build>').replace('unit="millimeter"', "")
    package({"3D/3dmodel.model": without})(tmp_path / "without.3mf")
    reading = find_parts([tmp_path / "without.3mf"])
    assert reading.parts[0].unit == "mm"
    assert "without.3mf: it names no unit: millimetres" in reading.notes[0]


def test_transforms_are_part_of_a_part(tmp_path: Path) -> None:
    """Copies that differ by more than a translation are other parts; mirrored ones stay solid."""
    own = f'<object id="1" name="Haken groß">{mesh(((0, 0, 0), (20, 10, 5)))}</object>'
    twice, mirrored = "2 0 0 0 2 0 0 0 2", "-1 0 0 0 1 0 0 0 1"
    items = ("", shift(30), shift(60, linear=twice), shift(150, linear=mirrored))
    file = plate(tmp_path / "plate.3mf", own, *(f'objectid="1" {item}' for item in items))
    parts = find_parts([file]).parts
    assert [(part.name, part.count, part.node) for part in parts] == [
        ("plate/Haken groß", 2, "1"),
        ("plate/Haken groß-2", 1, "3"),
        ("plate/Haken groß-3", 1, "4"),
    ]
    assert [float(part.mesh.volume) for part in parts] == pytest.approx([1000, 8000, 1000])
    assert parts[2].mesh.bounds[:, 0] == pytest.approx((130, 150))
    manifest = tmp_path / "parts.csv"
    manifest.write_text("file,name,count\nplate.3mf,mine,3\n")
    assert [part.count for part in find_parts([manifest]).parts] == [6, 3, 3]


def test_equal_objects_are_counted_once(tmp_path: Path) -> None:
    objects = "".join(
        f'<object id="{n}" name="cube {n}">{CUBE}</object>'
        f'<object id="{n + 10}" name="turned {n}"><components><component objectid="{n}" '
        f"{shift(0, linear='0 1 0 -1 0 0 0 0 1')}/></components></object>"
        for n in (1, 2)
    )
    file = plate(tmp_path / "clones.3mf", objects, *(f'objectid="{n}"' for n in (1, 2, 11, 12)))
    assert [(part.name, part.count) for part in read_parts(file)] == [
        ("cube 1", 2),
        ("turned 1", 2),
    ]


def test_triangles_without_three_corners_lose_no_file(tmp_path: Path) -> None:
    flat = '<triangles><triangle v1="0" v2="0" v3="1"/>'
    objects = f'<object id="1">{CUBE.replace("<triangles>", flat)}</object>'
    file = plate(tmp_path / "flat.3mf", objects, 'objectid="1"')
    (part,) = read_parts(file)
    assert part.raw.mesh.volume == pytest.approx(8000) and len(part.raw.mesh.faces) == 12
    assert part.raw.notes == ("1 triangles with fewer than three corners are left out",)


def test_a_file_is_needed_only_until_it_is_read(tmp_path: Path) -> None:
    file = plate(tmp_path / "gone.3mf", f'<object id="1">{CUBE}</object>', 'objectid="1"')
    packed = pack([file], "100x100x50mm", settings=QUICK)
    file.unlink()
    assert check(packed).problems == ()


def test_lattices_are_errors(tmp_path: Path) -> None:
    beams = (
        '<b:beamlattice minlength="0.1" radius="1"><b:beams><b:beam v1="0" v2="6"/></b:beams>'
        "</b:beamlattice></mesh>"
    )
    file = plate(
        tmp_path / "lattice.3mf",
        f'<object id="1">{CUBE.replace("</mesh>", beams)}</object>',
        'objectid="1"',
        root='xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" '
        'requiredextensions="b"',
    )
    with pytest.raises(MeshError, match=r"lattice\.3mf: its object 1 has a beam lattice"):
        read(file)


NAMES = ["деталь 1", "Körper groß", "部品 🔧", "<b>&amp;\"'", "a\x00b\x1b\n", "\ufffe", "[red]", ""]


def test_the_written_3mf_is_strict(tmp_path: Path) -> None:
    """Names of all scripts, triangles without an area, open meshes, far coordinates."""
    box = creation.box((20, 12, 8))
    faces = np.concatenate([box.faces[:-1], [(0, 0, 1), (3, 3, 3)]])
    matrix = np.eye(4)
    matrix[:3, 3] = 123.456789, 1234.56789, 0
    placed = [
        PlacedMesh(f"{n:02d} {name}", name, box.vertices, np.array(faces), matrix)
        for n, name in enumerate(NAMES, 1)
    ]
    (tmp_path / "all.3mf").write_bytes(encode_3mf(placed))
    found = bodies(tmp_path / "all.3mf")
    assert list(found)[:3] == ["01 деталь 1", "02 Körper groß", "03 部品 🔧"]
    assert [triangles.shape for triangles in found.values()] == [(11, 3, 3)] * len(NAMES)
    middle = found["01 деталь 1"].reshape(-1, 3).min(axis=0)
    assert middle == pytest.approx((113.456789, 1228.56789, -4), abs=1e-4)  # six digits: 2e-3


def test_packings_of_files_with_any_name_are_strict(tmp_path: Path) -> None:
    for name in ("деталь 1", "🔧", "<b>&amp;", "két\u0301"):
        creation.box((20, 12, 8)).export(tmp_path / f"{name}.stl", file_type="stl")
    solid = creation.box((9, 9, 9))
    corners = np.concatenate([solid.triangles, solid.triangles[:1, [0, 0, 1]]])
    stl(corners)(tmp_path / "degenerate.stl")
    stl(solid.triangles[:-1])(tmp_path / "open.stl")
    packed = pack([tmp_path], "100x100x50mm", settings=QUICK, out=tmp_path / "out")
    found = bodies(tmp_path / "out" / "packing.3mf")
    names = [packed.part(one).part.name for _, one in packed.placements]
    assert list(found) == [f"{n:02d} {name}" for n, name in enumerate(names, 1)]
    assert len(names) == 6 and "деталь 1" in names
