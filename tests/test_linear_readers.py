"""Readers take time linear in the file: files that took minutes, hours or for ever.

Each is read in a child process with a limit of CPU time that only a defect can reach.
"""

import io
import json
import os
import re
import resource
import signal
import time
import warnings
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from openpyxl import Workbook
from trimesh import creation

from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import dataset_file, read_packs
from packit_sim.libraries import mesh_3mf, mesh_files, step_files
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.model_3mf import Object3MF
from packit_sim.libraries.slicer_settings import ObjectSettings
from packit_sim.parts.packings import item_types
from packit_sim.parts.packings.instances import read_instance
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.files import find_parts, with_own_names
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.tables import read_table
from packit_sim.parts.results import check

SECONDS = 20
"""CPU time; each of these reads takes less than one second, and took minutes or more."""

MANY = 400_000


def ends(function: Callable[[], object]) -> bool:
    """Return whether a function ends within the limit; a PackItError is an end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which only wait
        child = os.fork()
    if child == 0:
        status = 1
        try:
            used = resource.getrusage(resource.RUSAGE_SELF)
            limit = int(used.ru_utime + used.ru_stime) + SECONDS
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
            with suppress(PackItError):
                function()
            status = 0
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
        return False
    assert status == 0
    return True


def test_no_pattern_of_lines_begins_with_blanks_that_are_ends_of_lines() -> None:
    folder = Path(mesh_files.__file__).parents[1]
    for file in folder.rglob("*.py"):
        assert not re.search(r"\^\\s[*+]", file.read_text()), f"{file}: write [^\\S\\n] for \\s"


DAE = b'<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset>'

TEXTS = {
    "comments.off": b"OFF\n" + b"# \n" * 30 + b"x",
    "many comments.off": b"OFF\n" + b"# \n" * MANY + b"x",
    "newlines.stl": b"solid " + b"\n" * MANY + b"x",
    "facets.stl": b"solid x\n" + b"\n" * MANY + b"facet" + b"\n" * MANY + b"endsolid",
    "newlines.ply": b"ply\n" + b"\n" * MANY + b"x\nend_header\n",
    "blanks.ply": b"ply\n" + b"element" + b" " * MANY + b"x\nend_header\n",
    "unit.dae": DAE + b"</asset></COLLADA>" + b"<unit " * MANY,
    "meter.dae": DAE + b"<unit " + b"meter=' " * MANY + b"></asset></COLLADA>",
    "axis.dae": DAE + b"<up_axis>" + b" " * MANY + b"</up_axis></asset></COLLADA>",
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_mesh_file_is_read_or_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(TEXTS[name])
    assert ends(lambda: mesh_files.read(tmp_path / name))


def test_comments_and_blank_lines_change_no_mesh(tmp_path: Path) -> None:
    box = creation.box((1, 2, 3))
    off, stl, ply = (tmp_path / f"a.{kind}" for kind in ("off", "stl", "ply"))
    counts, _, rest = box.export(file_type="off").partition("\n")[2].partition("\n")
    off.write_text(f"# OFF of 9 9\nOFF # 1 1\n# \n\n  # 7 7\n{counts} # 3 3\n{rest}")
    stl.write_text("\n\n" + box.export(file_type="stl_ascii").replace("\n", "\r\n\n \t"))
    ply.write_bytes(box.export(file_type="ply", encoding="ascii"))
    for file in (off, stl, ply):
        assert np.allclose(mesh_files.read(file).mesh.extents, (1, 2, 3)), file
    ply.write_bytes(ply.read_bytes().rpartition(b"\n3 ")[0])
    stl.write_text(stl.read_text().replace("outer", "").replace("vertex", "point", 3))
    for file in (ply, stl):
        with pytest.raises(PackItError):
            mesh_files.read(file)


@pytest.mark.parametrize("kind", ["off", "ply"])
def test_a_count_of_thousands_of_digits_is_refused_in_our_words(tmp_path: Path, kind: str) -> None:
    digits = "9" * 5000
    texts = {
        "off": f"OFF\n{digits} 1 0\n",
        "ply": f"ply\nformat ascii 1.0\nelement vertex {digits}\nend_header\n",
    }
    file = tmp_path / f"a.{kind}"
    file.write_text(texts[kind])
    with pytest.raises(PackItError, match="a number of 5,000 digits: at most 20"):
        mesh_files.read(file)


def test_the_unit_and_the_axis_of_a_dae_are_those_of_its_asset(tmp_path: Path) -> None:
    file = tmp_path / "a.dae"
    text = creation.box((1, 2, 3)).export(file_type="dae").decode()
    start, end = text.index("<asset"), text.index("</asset>") + len("</asset>")
    for asset, up, unit_cm in (
        ("<asset/>", "y", 100.0),
        ('<asset><unit name="a>b" meter="0.01"/><up_axis> Z_UP </up_axis></asset>', "z", 1.0),
    ):
        file.write_text(text[:start] + asset + text[end:])
        raw = mesh_files.read(file)
        assert (raw.up, raw.unit_cm) == (up, unit_cm)
    file.write_text(text[:start] + "<asset><up_axis>W_UP</up_axis></asset>" + text[end:])
    with pytest.raises(PackItError, match="'W_UP' is none of X_UP, Y_UP, Z_UP"):
        mesh_files.read(file)


def test_equal_names_are_numbered_in_one_pass() -> None:
    box = creation.box((1, 1, 1))
    few = [Part(name, box) for name in ("a", "a-2", "a", "a", "a-2")]
    assert [each.name for each in with_own_names(few, ["a-3"])] == [
        *("a", "a-2", "a-4", "a-5", "a-2-2")
    ]
    names = [f"a-{n}" for n in range(2, 5002)]
    looked: list[int] = []

    class Name(str):
        """A name that counts how often names made of it are compared."""

        def __format__(self, spec: str) -> str:
            looked.append(1)
            return str(self)

    parts = [Part("a", box) for _ in range(200)]
    for part in parts:
        object.__setattr__(part, "name", Name("a"))
    made = [each.name for each in with_own_names(parts, names)]
    assert len(set(made)) == len(parts) and len(looked) <= len(names) + len(parts)


def test_overlapping_volumes_of_a_slicer(tmp_path: Path) -> None:
    vertices, triangles = np.zeros((3, 3)), np.zeros((50_000, 3), dtype=np.int64)
    own = Object3MF("a", "model", 1, 1, vertices, triangles)
    slices = (slice(0, 10), slice(5, 20), slice(40, 40), slice(49_990, 60_000), slice(-5, 3))
    kept = np.ones(len(triangles), dtype=bool)
    for each in slices:
        kept[each] = False
    found = mesh_3mf._solid(own, ObjectSettings(triangles=slices), {})
    assert len(found.triangles) == kept.sum()
    many = ObjectSettings(triangles=(slice(0, 49_999),) * 200_000)
    assert ends(lambda: mesh_3mf._solid(own, many, {}))


def test_errors_that_opencascade_prints() -> None:
    syntax = "**** ERR StepFile : Undefined Parsing: Line 4: Incorrect syntax: no '('    ****\n"
    fails = "\x1b[32;1m**** ERR StepFile : Incorrect Syntax : Fails Count : 1 ****\x1b[0m\n"
    assert step_files._problem("nothing\n" + syntax + fails) == "no '('"
    assert step_files._problem(fails) == "Incorrect Syntax"
    assert step_files._problem("skipped node : 1\n") is None
    assert ends(lambda: step_files._problem("Incorrect syntax: " + " " * MANY + "x"))
    assert ends(lambda: step_files._problem(" ERR x : " * MANY))


@pytest.mark.parametrize(
    "sheet",
    [b"<row " * MANY, b"<row " + b'r="1" ' * MANY + b">", b'<c "' * MANY, b"<row>" + b" " * MANY],
)
def test_a_workbook_is_measured_in_one_pass(tmp_path: Path, sheet: bytes) -> None:
    book = Workbook()
    book.active.append(["file", "count"])
    book.save(content := io.BytesIO())
    file = tmp_path / "a.xlsx"
    with zipfile.ZipFile(content) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            new.writestr(name, sheet if "sheet1" in name else old.read(name))
    assert ends(lambda: read_table(file))


@pytest.mark.parametrize("cell", [b'<c t=">" r="XFD1048576"/>', b"<c t='\"' x=\"'\" r='XFD9999'/>"])
def test_a_cell_far_away_is_seen_behind_any_attribute(tmp_path: Path, cell: bytes) -> None:
    file = tmp_path / "a.xlsx"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("sheet1.xml", b'<row r="1">' + cell + b"</row>")
    with pytest.raises(PackItError, match="cells are too many"):
        read_table(file)


def test_a_mesh_that_is_named_again_and_again_is_read_once(tmp_path: Path, monkeypatch) -> None:
    creation.box((1, 2, 3)).export(tmp_path / "a.stl")
    types = [{"path": "a.stl", "demand": n} for n in range(1, 101)]
    instance = {"container": {"size-x": 9, "size-y": 9}, "item-types": types}
    (tmp_path / "instance.json").write_text(json.dumps(instance))
    posed = {"mesh": "a.stl", "pose": np.eye(4).tolist()}
    packing = {"box": [9, 9, 9], "items": [posed], "obstacles": [posed] * 20}
    (tmp_path / "packing.json").write_text(json.dumps(packing))
    opened: list[Path] = []
    read = mesh_files.read
    monkeypatch.setattr(item_types, "read", lambda file: opened.append(file) or read(file))
    found, _ = read_instance(tmp_path / "instance.json")
    assert [each.demand for each in found] == list(range(1, 101)) and len(opened) == 1
    assert len(Packing.read(tmp_path / "packing.json").container.obstacles) == 20
    assert len(opened) == 2


def test_rows_of_a_manifest_take_as_long_as_files(tmp_path: Path) -> None:
    creation.box((1, 2, 3)).export(tmp_path / "a.stl")
    (tmp_path / "m.csv").write_text("file\n" + "a.stl\n" * 1000)
    found = find_parts([tmp_path / "m.csv"])
    assert len({each.name for each in found.parts}) == 1000


def test_a_pack_of_many_equal_items(tmp_path: Path) -> None:
    pack = read_packs(dataset_file("starter"))[0]
    library = ShapeLibrary.open("everyday")
    found = verify(replace(pack, items=pack.items[:1] * 12), library)
    assert found[0].endswith("is in conflict with items [0]")
    assert found[-3].endswith("is in conflict with items [0, 1, 2, 3, 4, 5, 6, 7] and others")
    assert ends(lambda: verify(replace(pack, items=pack.items[:1] * 1500), library))


def _boxes(count: int) -> trimesh.Trimesh:
    """Return a row of boxes: a surface of so many parts."""
    box = creation.box()
    at = np.arange(count)
    vertices = box.vertices + 2.0 * at[:, None, None] * [1, 0, 0]
    faces = box.faces + 8 * at[:, None, None]
    return trimesh.Trimesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), process=False)


def test_a_surface_of_many_parts_is_divided_once() -> None:
    """Each part was looked for among all triangles, in containers, checks and STEP files."""
    mesh = _boxes(8000)
    row = SimpleNamespace(vertices=mesh.vertices, faces=mesh.faces, low=np.zeros(3))
    original = SimpleNamespace(mesh=mesh, drawn=lambda times: 1.0)
    mesh.triangles_center  # noqa: B018  computed once
    started = time.process_time()
    low, high = MeshContainer._parts.func(SimpleNamespace(mesh=row))
    samples = check._Original.samples.func(original)
    assert time.process_time() - started < 1.2  # 0.3 s; it took 3.3 s
    assert np.allclose(low[:, 0] + 1, high[:, 0]) and len(low) == len(samples) == 8000
    found = step_files.bodies(_boxes(3))
    assert [len(each.vertices) for each in found] == [8, 8, 8]
    assert np.allclose([each.volume for each in found], step_files.MM**3)


@pytest.mark.slow
def test_a_product_of_many_solids() -> None:
    assert ends(lambda: step_files.bodies(_boxes(8000)))
