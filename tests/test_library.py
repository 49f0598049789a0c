"""Shape libraries: the built-in one, stored ones, folders of mesh files, and their errors."""

from __future__ import annotations

import errno
import json
import pickle
import re
import sys
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
import trimesh

from campaigns import injector
from packit_sim.box import Box
from packit_sim.core import caches
from packit_sim.core.assets import assets_folder
from packit_sim.core.choices import SPLITS
from packit_sim.core.errors import LibraryError, MeshError, UnknownShapeError
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.sources import ShapeInfo
from packit_sim.libraries.stored import entry

Entry = tuple[QuantizedMesh, ShapeInfo]

SOME_OR_ALL = pytest.mark.parametrize(
    "step", [9, pytest.param(1, marks=pytest.mark.slow)], ids=["some", "all"]
)
"""Test every ninth shape, or every one."""

LICENCES = {"Apache-2.0", "CC0-1.0", "CC-BY-3.0", "CC-BY-3.0-US"}


@pytest.fixture(scope="module")
def everyday() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


@pytest.fixture
def entries() -> list[Entry]:
    bowl = Shape.from_mesh(trimesh.creation.annulus(0.8, 1, 0.5), "sets/bowl", "bowl")
    block = Shape.from_mesh(trimesh.creation.box((1, 2, 3)), "block", "box")
    return [entry(bowl, "Bowl", "Ann", "CC0-1.0", "a kiln", (8.0, 8.0, 4.5), 0.001), entry(block)]


@pytest.fixture
def written(tmp_path: Path, entries: list[Entry]) -> Path:
    stored.write(tmp_path / "lib", "mine", "3", entries)
    return tmp_path / "lib"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    meshes = tmp_path / "meshes"
    (meshes / "toys" / "round").mkdir(parents=True)
    trimesh.creation.box((1, 2, 3)).export(meshes / "block.stl")
    trimesh.creation.icosphere(subdivisions=2).export(meshes / "toys" / "round" / "ball.PLY")
    trimesh.creation.cone(1, 2).export(meshes / "toys" / "cone.obj")
    trimesh.creation.capsule().export(meshes / "toys" / "pill.off")
    scene = trimesh.Scene()
    for x in (0, 9):
        at = trimesh.transformations.translation_matrix((x, 0, 0))
        scene.add_geometry(trimesh.creation.box((1, 2, 3)), transform=at)
    scene.export(meshes / "pair.glb")
    (meshes / ".hidden.stl").write_text("not a mesh")
    (meshes / "notes.txt").write_text("nor this")
    return meshes


def test_everyday_has_many_shapes_of_many_kinds(everyday: ShapeLibrary) -> None:
    assert len(everyday) >= 550
    assert len(everyday.categories) >= 40
    assert list(everyday) == sorted(everyday.ids) == sorted(sum(everyday.categories.values(), ()))
    assert everyday.name == "everyday"
    files = [file for file in everyday.path.rglob("*") if file.is_file()]
    assert len(files) == len(everyday) + 2
    assert sum(file.stat().st_size for file in files) <= 40e6


@SOME_OR_ALL
def test_everyday_shapes_are_canonical_and_as_described(everyday: ShapeLibrary, step: int) -> None:
    for id in everyday.ids[::step]:
        shape, info = everyday[id], everyday.info(id)
        low, high = shape.mesh.bounds
        assert (low == -high).all(), id
        assert np.linalg.norm(high - low) == pytest.approx(1, abs=1e-9), id
        assert shape.mesh.area_faces.min() > 0, id
        assert shape.category == info.category
        assert id in everyday.categories[info.category]
        assert len(shape.mesh.faces) == info.triangles <= 4000
        assert (shape.mesh.is_watertight, shape.is_solid) == (info.watertight, info.solid)
        assert (shape.volume, shape.digest) == (info.volume, info.digest)
        assert 0 < shape.volume <= np.prod(shape.extents) * 1.001, id
        assert 0 <= info.error_bound <= 0.01
        assert info.size_cm is not None
        assert shape.extents / shape.extents.max() == pytest.approx(
            np.array(info.size_cm) / max(info.size_cm), abs=0.02
        ), id


@SOME_OR_ALL
def test_everyday_shapes_voxelise_and_pack(everyday: ShapeLibrary, step: int) -> None:
    for id in everyday.ids[::step]:
        item = Item(everyday[id], 0.25)
        assert item.outer.any(), id
        box = Box()
        location = box.blbf(item)
        assert location == (0, 0, 0), id
        box.place(item, location)


def test_no_object_is_in_two_splits(everyday: ShapeLibrary) -> None:
    splits = [everyday.split(name) for name in SPLITS]
    assert sorted(id for split in splits for id in split) == sorted(everyday)
    groups = [{everyday.info(id).group for id in split} for split in splits]
    assert sum(map(len, groups)) == len(set.union(*groups))
    assert max(map(len, splits)) - min(map(len, splits)) <= 6
    for category in everyday.categories:
        sizes = [len(split.categories.get(category, ())) for split in splits]
        objects = {everyday.info(id).group for id in everyday.categories[category]}
        assert min(sizes) > 0 or len(objects) < 3, category


def test_everyday_records_the_source_of_each_shape(everyday: ShapeLibrary) -> None:
    rows = (assets_folder() / "everyday.md").read_text(encoding="utf-8").splitlines()
    listed = {row.split(" | ")[0].lstrip("| "): row for row in rows if row.startswith("| ")}
    for info in map(everyday.info, everyday):
        assert info.licence in LICENCES
        assert info.author and info.title and info.source
        assert all(text in listed[info.id] for text in (info.author, info.licence, info.source))
    assert len(listed) == len(everyday) + 1
    assert "Apache License" in (assets_folder() / "Apache-2.0.txt").read_text()


def test_a_split_is_the_library_with_fewer_shapes(everyday: ShapeLibrary) -> None:
    train = everyday.split("train")
    assert (train.name, train.version, train.digest) == (
        everyday.name,
        everyday.version,
        everyday.digest,
    )
    assert set(train) < set(everyday) and train[train.ids[0]] is everyday[train.ids[0]]
    other = everyday.split("test").ids[0]
    assert other not in train
    with pytest.raises(UnknownShapeError, match=f"{other!r} in train of library 'everyday'"):
        train[other]
    again = pickle.loads(pickle.dumps(train))
    assert again.ids == train.ids and "train" in repr(again)
    with pytest.raises(LibraryError, match="no split 'dev': choose from train, test, validation"):
        everyday.split("dev")


def test_damaged_splits_are_named(written: Path) -> None:
    file = written / "splits.json"
    splits = json.loads(file.read_text())
    one, other = (id for ids in splits.values() if isinstance(ids, list) for id in ids)
    for change in (
        {"train": [one], "test": [one, other]},
        {"train": ["nobody"]},
        {"train": 5},
        {"format": 7},
    ):
        file.write_text(json.dumps(splits | change))
        with pytest.raises(LibraryError, match=r"lib/splits\.json"):
            ShapeLibrary.open(written).split("train")


def test_shapes_are_loaded_once_by_any_thread() -> None:
    library = ShapeLibrary.open("everyday")
    first = library.ids[0]
    with ThreadPoolExecutor(8) as pool:
        shapes = list(pool.map(lambda _: library[first], range(64)))
    assert all(shape is shapes[0] for shape in shapes)


def test_library_travels_to_another_process(written: Path) -> None:
    library = ShapeLibrary.open(written)
    copy = pickle.loads(pickle.dumps(library))
    assert copy.digest == library.digest
    assert copy["block"] == library["block"]


def test_unknown_id_names_the_closest_ones(everyday: ShapeLibrary) -> None:
    assert "coffee-mugg" not in everyday
    with pytest.raises(UnknownShapeError, match=r"'coffee-mugg' in library 'everyday'.*coffee-mug"):
        everyday["coffee-mugg"]
    with pytest.raises(UnknownShapeError, match="'qqq'"):
        everyday.info("qqq")


def test_writing_and_reopening_is_the_identity(
    written: Path, entries: list[Entry], tmp_path: Path
) -> None:
    library = ShapeLibrary.open(written)
    assert (library.name, library.version) == ("mine", "3")
    assert library.ids == ("block", "sets/bowl")
    assert dict(library.categories) == {"bowl": ("sets/bowl",), "box": ("block",)}
    info = library.info("sets/bowl")
    assert (info.title, info.author, info.licence) == ("Bowl", "Ann", "CC0-1.0")
    assert (info.source, info.size_cm, info.error_bound) == ("a kiln", (8.0, 8.0, 4.5), 0.001)
    for mesh, info in entries:
        shape = library[info.id]
        assert shape.mesh.is_volume and info.watertight and info.solid
        assert (shape.volume, shape.digest) == (info.volume, info.digest)
        assert (shape.mesh.vertices == mesh.mesh().vertices).all()
        assert library.info(info.id) == info

    again = [
        entry(library[i.id], i.title, i.author, i.licence, i.source, i.size_cm, i.error_bound)
        for i in map(library.info, library)
    ]
    stored.write(tmp_path / "again", "mine", "3", again)
    files = [file.relative_to(written) for file in written.rglob("*") if file.is_file()]
    assert len(files) == 4
    for file in files:
        assert (written / file).read_bytes() == (tmp_path / "again" / file).read_bytes()


def test_triangles_that_vanish_on_the_lattice_are_dropped(tmp_path: Path) -> None:
    block, speck = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1e-7, 1e-7, 1e-7))
    speck.apply_translation((0.5 + 1e-6, 0.1, 0.1))
    shape = Shape.from_mesh(block + speck, "block", "box")
    stored.write(tmp_path / "lib", "mine", "1", [entry(shape)])
    mesh = ShapeLibrary.open(tmp_path / "lib")["block"].mesh
    assert len(mesh.faces) == 12
    assert mesh.is_volume
    assert np.linalg.norm(mesh.extents) == pytest.approx(1, abs=1e-12)


def test_writing_replaces_an_older_library_only(written: Path, entries: list[Entry]) -> None:
    stored.write(written, "mine", "4", entries[1:])
    assert ShapeLibrary.open(written).ids == ("block",)
    (written / "diary.txt").write_text("dear diary")
    with pytest.raises(LibraryError, match=r"diary\.txt"):
        stored.write(written, "mine", "5", entries)
    with pytest.raises(LibraryError, match="it is a file"):
        stored.write(written / "diary.txt", "mine", "5", entries)
    assert ShapeLibrary.open(written).version == "4"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="exchanges folders in one step")
def test_a_library_that_is_replaced_is_there_at_any_moment(
    written: Path, entries: list[Entry]
) -> None:
    first, folder = ShapeLibrary.open(written).digest, written.parent
    whole = partial(stored.write, written, "mine", "4", entries[1:])
    changes = injector.changes_of(whole, folder)
    second = ShapeLibrary.open(written).digest
    found = set()
    for n in range(1, changes + 1):
        stored.write(written, "mine", "3", entries)
        assert injector.fork(whole, folder, at=n) == -9
        found.add(ShapeLibrary.open(written).digest)
        stored.remove_unfinished(written)
        assert [path.name for path in folder.iterdir()] == [written.name]
    assert found == {first, second}


def test_where_folders_cannot_be_exchanged_a_killed_replacement_is_undone(
    written: Path, entries: list[Entry], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(one: Path, other: Path) -> None:
        raise OSError(errno.EINVAL, "not here")

    monkeypatch.setattr(stored, "exchange", fail)
    stored.write(written, "mine", "4", entries[1:])
    assert ShapeLibrary.open(written).version == "4"
    staging = written.with_name(f".{written.name}.importing-abc")
    staging.mkdir()
    written.rename(staging / "old")
    stored.remove_unfinished(written)
    assert ShapeLibrary.open(written).version == "4" and not staging.exists()


def test_failed_write_leaves_nothing_behind(written: Path, entries: list[Entry]) -> None:
    before = {file: file.stat().st_mtime_ns for file in written.parent.rglob("*")}
    block = entries[1][0].mesh()
    for id in ("../block", "", ".block", "a b", "block", "BLOCK"):
        twin = entry(Shape(block, id, "box"))
        with pytest.raises(LibraryError, match=f"shape id {id!r}"):
            stored.write(written, "mine", "4", [*entries, twin])
    with pytest.raises(LibraryError, match="at least one shape"):
        stored.write(written.parent / "none", "none", "1", [])
    assert {file: file.stat().st_mtime_ns for file in written.parent.rglob("*")} == before


def test_folder_of_meshes(folder: Path) -> None:
    library = ShapeLibrary.open(folder)
    assert library.name == "meshes"
    assert library.ids == ("block", "pair", "toys/cone", "toys/pill", "toys/round/ball")
    assert dict(library.categories) == {
        "toys": ("toys/cone", "toys/pill"),
        "toys/round": ("toys/round/ball",),
        "uncategorised": ("block", "pair"),
    }
    assert all(library.info(id).solid for id in ("block", "toys/cone", "toys/round/ball"))
    info = library.info("block")
    assert (info.triangles, info.size_cm, info.error_bound) == (12, None, 0)
    assert info.volume == pytest.approx(6 / 14**1.5)
    assert info.source == str(folder / "block.stl")


def test_folders_have_no_splits(folder: Path) -> None:
    with pytest.raises(LibraryError, match="has no splits: `packit shapes import` it"):
        ShapeLibrary.open(folder).split("train")


def test_a_scheme_says_what_is_at_a_path(folder: Path, written: Path) -> None:
    assert ShapeLibrary.open(f"folder:{folder}").ids == ShapeLibrary.open(folder).ids
    with pytest.raises(LibraryError, match=r"neither library\.json nor a mesh file"):
        ShapeLibrary.open(f"folder:{written}")
    with pytest.raises(LibraryError, match="not laid out as ShapeNetCore is"):
        ShapeLibrary.open(f"shapenet:{folder}")
    (folder / "taxonomy.json").write_text("[]")
    with pytest.raises(LibraryError, match=f"open it as 'shapenet:{folder}'"):
        ShapeLibrary.open(folder)
    copy = pickle.loads(pickle.dumps(ShapeLibrary.open(f"folder:{folder}")))
    assert copy.digest == ShapeLibrary.open(f"folder:{folder}").digest


PLUGIN = """
import trimesh
from packit_sim.libraries.sources import Candidate, RawMesh, Source

def read():
    return RawMesh(trimesh.creation.box([3, 2, 1]))

class Bricks(Source):
    def __init__(self, path):
        super().__init__(path, "bricks", "", {"brick": "cuboid"})

    locator = property(lambda self: f"bricks:{self.path}")
    digest = "0" * 64

    def candidate(self, id):
        return Candidate(id, "cuboid", read)
"""


def test_a_package_brings_a_source_by_its_entry_point(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "brick_source.py").write_text(PLUGIN)
    metadata = tmp_path / "brick_source-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: brick-source\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[packit_sim.shape_sources]\nbricks = brick_source:Bricks\nfolder = brick_source:Bricks\n"
    )
    file = tmp_path / "bricks.txt"
    with pytest.raises(LibraryError, match="no shape library 'bricks:"):
        ShapeLibrary.open(f"bricks:{file}")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(LibraryError, match=f"no shape library 'bricks:.*': there is no {file}"):
        ShapeLibrary.open(f"bricks:{file}")
    file.touch()
    library = ShapeLibrary.open(f"bricks:{file}")
    assert library["brick"].volume == pytest.approx(6 / 14**1.5)
    assert pickle.loads(pickle.dumps(library)).source.locator == f"bricks:{file}"
    with pytest.raises(LibraryError, match="nor a mesh file"):  # own schemes come first
        ShapeLibrary.open(f"folder:{metadata}")


def test_scene_is_flattened_with_its_transforms_and_turned_z_up(folder: Path) -> None:
    mesh = ShapeLibrary.open(folder)["pair"].mesh
    assert mesh.body_count == 2
    assert mesh.extents == pytest.approx(np.array((10, 3, 2)) / 113**0.5)


def test_digest_of_a_folder_follows_its_files(folder: Path) -> None:
    digest = ShapeLibrary.open(folder).digest
    assert ShapeLibrary.open(str(folder)).digest == digest
    trimesh.creation.box((1, 2, 3.5)).export(folder / "block.stl")
    changed = ShapeLibrary.open(folder).digest
    (folder / "block.stl").rename(folder / "brick.stl")
    assert len({digest, changed, ShapeLibrary.open(folder).digest}) == 3


def test_two_files_that_would_have_one_id_keep_their_suffixes(folder: Path) -> None:
    trimesh.creation.box().export(folder / "block.ply")
    library = ShapeLibrary.open(folder)
    assert {"block.ply", "block.stl"} < set(library.ids) and "block" not in library
    assert library["block.ply"].extents == pytest.approx([3**-0.5] * 3)


@pytest.mark.parametrize("suffix", ["glb", "obj", "off", "ply", "stl"])
def test_broken_mesh_files_are_named(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"ball.{suffix}"
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(file)
    whole = file.read_bytes()
    ball.vertices[7] = np.nan
    ball.export(file)
    contents = [file.read_bytes(), b"", b"rubbish", whole[: len(whole) * 2 // 3]]
    for content in contents[: 3 if suffix == "obj" else 4]:  # a cut OBJ is a smaller, valid OBJ
        file.write_bytes(content)
        with pytest.raises(MeshError, match=f"ball.{suffix}"):
            ShapeLibrary.open(tmp_path)["ball"]


def test_meshes_that_are_no_shape_are_named(tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "loose.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    library = ShapeLibrary.open(tmp_path)
    for id in library:
        with pytest.raises(MeshError, match=f"{id}.obj"):
            library[id]


def test_sources_that_are_no_library(tmp_path: Path) -> None:
    with pytest.raises(LibraryError, match=r"'everyda'.*built in.*everyday"):
        ShapeLibrary.open("everyda")
    with pytest.raises(LibraryError, match="no shape library ''"):
        ShapeLibrary.open("")
    with pytest.raises(LibraryError, match="nowhere"):
        ShapeLibrary.open(tmp_path / "nowhere")
    with pytest.raises(LibraryError, match=r"neither library\.json nor a mesh file.*\.stl"):
        ShapeLibrary.open(tmp_path)


def _edited(change: Callable[[dict], object]) -> Callable[[str], str]:
    def edit(text: str) -> str:
        content = json.loads(text)
        change(content)
        return json.dumps(content)

    return edit


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[:-20],
        lambda text: "",
        lambda text: "[" * 100_000,
        lambda text: "[1, 2]",
        lambda text: '{"name": "another program\'s file"}',
        _edited(lambda content: content.update(format=1)),
        _edited(lambda content: content.pop("digest")),
        _edited(lambda content: content.update(version=3)),
        _edited(lambda content: content.update(shapes=7)),
        _edited(lambda content: content.update(shapes=[])),
        _edited(lambda content: content["shapes"].pop()),
        _edited(lambda content: content["shapes"].append(content["shapes"][0])),
        _edited(lambda content: content["shapes"][0].pop("licence")),
        _edited(lambda content: content["shapes"][0].update(id="../../secret")),
        _edited(lambda content: content["shapes"][0].update(category=None)),
        _edited(lambda content: content["shapes"][0].update(triangles="many")),
        _edited(lambda content: content["shapes"][0].update(size_cm=[1, 2])),
        _edited(lambda content: content["shapes"][0].update(volume=float("nan"))),
        _edited(lambda content: content["shapes"][0].update(volume="much")),
        _edited(lambda content: content["shapes"][0].update(digest="0" * 64)),
        _edited(lambda content: content["shapes"][0].update(digest=5)),
    ],
)
def test_damaged_catalogue_is_named(written: Path, damage: Callable[[str], str]) -> None:
    catalogue = written / "library.json"
    catalogue.write_text(damage(catalogue.read_text()))
    with pytest.raises(LibraryError, match=r"lib/(library|splits)\.json"):
        ShapeLibrary.open(written)


def test_damaged_meshes_are_detected(written: Path) -> None:
    file = written / "meshes" / "block.npz"
    content = file.read_bytes()
    middle = len(content) // 2
    damaged = [b"", content[:middle], content[:100] + b"\xff\xff" + content[102:]]
    with np.load(file) as arrays:
        whole = dict(arrays)
    for change in (
        {"vertices": whole["vertices"][:-1]},
        {"vertices": np.flip(whole["vertices"], axis=0)},
        {"vertices": whole["vertices"][:, :2]},
        {"faces": whole["faces"] + 1},
        {"extents": whole["extents"] * 1.001},
        {"extents": np.array([{}, 1, 2], dtype=object)},
    ):
        np.savez_compressed(file, **{**whole, **change})
        damaged.append(file.read_bytes())
    np.savez_compressed(file, vertices=whole["vertices"], faces=whole["faces"])
    damaged.append(file.read_bytes())
    for content in damaged:
        file.write_bytes(content)
        with pytest.raises(LibraryError, match=r"block\.npz: not the mesh of 'block'"):
            ShapeLibrary.open(written)["block"]
    file.unlink()
    with pytest.raises(LibraryError, match=r"block\.npz"):
        ShapeLibrary.open(written)["block"]


def _stored_as(file: Path, *headers: tuple[str, bytes, int]) -> None:
    """Write arrays by name: the header as it stands, and so many zeros."""
    with ZipFile(file, "w", ZIP_DEFLATED) as archive:
        for name, header, zeros in headers:
            archive.writestr(f"{name}.npy", header + bytes(zeros))


def _header(kind: str, shape: tuple[int, ...]) -> bytes:
    content = BytesIO()
    fields = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(content, fields)
    return content.getvalue()


@pytest.mark.parametrize(
    ("rows", "zeros", "message"),
    [
        (10**13, 60, "'vertices' would take 60,000,000,000,000 bytes"),
        (10**7, 6 * 10**7, "'vertices' would take 60,000,000 bytes: at most"),
        (20, 60, "'vertices' does not have the 120 bytes of its shape"),
        (5, 60, "'vertices' does not have the 30 bytes of its shape"),
        (-3, 60, "block.npz: not the mesh of 'block'"),
    ],
)
def test_a_stored_mesh_takes_memory_as_its_file_does(written, rows, zeros, message) -> None:
    file = written / "meshes" / "block.npz"
    rest = ("faces", _header("<u2", (2, 3)), 12), ("extents", _header("<f8", (3,)), 24)
    _stored_as(file, ("vertices", _header("<u2", (rows, 3)), zeros), *rest)
    library = ShapeLibrary.open(written)
    tracemalloc.start()
    try:
        with pytest.raises(LibraryError, match=re.escape(message)):
            library["block"]
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_bit_flips_in_a_stored_mesh_are_detected(written) -> None:
    """A flip that is not, such as one of a time stamp, leaves the same mesh."""
    file = written / "meshes" / "block.npz"
    content = file.read_bytes()
    library = ShapeLibrary.open(written)
    whole = library["block"].digest
    detected = 0
    for bit in np.random.default_rng(0).permutation(8 * len(content))[:1500].tolist():
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        file.write_bytes(flipped)
        caches.clear("shapes")
        try:
            assert library["block"].digest == whole
        except LibraryError:
            detected += 1
    assert detected > 750


@pytest.mark.parametrize("digits", [40, 401, 5000])
@pytest.mark.parametrize("field", ["volume", "triangles", "error_bound", "format"])
def test_endless_integers_in_a_catalogue_are_refused(written, field, digits) -> None:
    file = written / "library.json"
    text = re.sub(rf'("{field}": )[0-9.e-]+', rf"\g<1>{'1' * digits}", file.read_text(), count=1)
    file.write_text(text)
    with pytest.raises(LibraryError, match=f"library.json: .*an integer of {digits} digits is not"):
        ShapeLibrary.open(written)


def test_an_id_that_numpy_drew_names_the_same_shape() -> None:
    library = ShapeLibrary.open("everyday")
    shape = library[np.random.default_rng(0).choice(library.ids)]
    assert type(shape.id) is str and library[shape.id] is shape
