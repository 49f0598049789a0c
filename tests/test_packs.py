import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from packit_sim.box import Box
from packit_sim.core.errors import InfeasibleError, PackFormatError
from packit_sim.game.datasets.manifests import manifest_path
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import (
    dataset_file,
    dataset_library,
    load_tasks,
    read_packs,
    write_packs,
)
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.datasets.provenance import Other
from packit_sim.geometry.shapes import Item
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from tests.zoo import ZOO

RECORDS = Path(__file__).parent / "references" / "format-1"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ShapeLibrary:
    path = tmp_path_factory.mktemp("library") / "zoo"
    stored.write(path, "zoo", "1", [stored.entry(shape) for shape in ZOO])
    return ShapeLibrary.open(path)


@pytest.fixture(scope="module")
def pack(library: ShapeLibrary) -> Pack:
    rng = np.random.default_rng(3)
    box = Box()
    for shape_id in library.ids:
        item = Item(library[shape_id], 0.1 + 0.1 * rng.random(), int(rng.integers(24)))
        location = box.blbf(item)
        assert location is not None
        box.place(item, location)
    return Pack.of(box, LibraryRef.of(library), Other(author="a test", notes="seed 3"))


def test_reading_back_is_the_identity(pack, tmp_path) -> None:
    assert Pack.from_json(pack.to_json()) == pack
    assert "\n" not in pack.to_json()
    path = tmp_path / "new folder" / "packs.jsonl"
    write_packs(path, [pack, pack])
    assert read_packs(path) == [pack, pack]
    assert sorted(p.name for p in path.parent.iterdir()) == [
        "packs.jsonl",
        "packs.jsonl.manifest.json",
    ]
    manifest = json.loads(manifest_path(path).read_text())
    assert manifest["packs"] == 2 and manifest["libraries"][0]["name"] == "zoo"


def test_replay_reproduces_the_pack(pack, library) -> None:
    box = pack.replay(library)
    assert Pack.of(box, LibraryRef.of(library), pack.provenance) == pack
    assert Pack.of(box, library, pack.provenance) == pack
    assert verify(pack, library) == []


def test_a_task_has_the_items_in_canonical_orientation(pack, library) -> None:
    task = pack.task(library)
    assert all(item.rotation == 0 for item in task.items)
    assert sorted((i.shape.id, i.scale) for i in task.items) == sorted(
        (i.shape, i.scale) for i in pack.items
    )
    assert task.volume == pytest.approx(pack.density)
    box = Box(task.cells)
    for index, rotation, location in task.solution:
        box.place(Item(task.items[index].shape, task.items[index].scale, rotation), location)
    assert Pack.of(box, pack.library, pack.provenance) == pack


def _tampered(pack: Pack, **changes) -> Pack:
    raw = json.loads(pack.to_json())
    for path, value in changes.items():
        keys = path.split("__")
        target = raw
        for key in keys[:-1]:
            target = target[int(key) if key.isdigit() else key]
        target[int(keys[-1]) if keys[-1].isdigit() else keys[-1]] = value
    return Pack.from_json(json.dumps(raw))


def test_verify_finds_what_was_tampered_with(pack, library) -> None:
    first = list(pack.items[0].location)
    moved = _tampered(pack, items__3__location=first)
    assert any("item 3" in p and "in conflict with items [0" in p for p in verify(moved, library))
    outside = _tampered(pack, items__1__location=[24, 24, 24])
    assert any("item 1" in p and "not inside the box" in p for p in verify(outside, library))
    grown = _tampered(pack, items__2__scale=pack.items[2].scale * 1.01)
    assert any("density is recorded" in p for p in verify(grown, library))
    giant = _tampered(pack, items__1__scale=600.0)
    assert any("item 1" in p and "not inside the box" in p for p in verify(giant, library))
    lying = _tampered(pack, density=0.9)
    assert len(verify(lying, library)) == 1
    foreign = _tampered(pack, library__digest="0" * 64)
    assert "the pack is of library 'zoo' 1 (000000000000)" in verify(foreign, library)[0]
    unknown = _tampered(pack, items__0__shape="zebra")
    assert "zebra" in verify(unknown, library)[0]


def test_a_pack_that_does_not_hold_is_not_replayed(pack, library) -> None:
    moved = _tampered(pack, items__3__location=list(pack.items[0].location))
    with pytest.raises(InfeasibleError, match="in conflict with placed item 0"):
        moved.replay(library)


def _without(line: str, key: str) -> str:
    raw = json.loads(line)
    del raw[key]
    return json.dumps(raw)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda line: line[:-20], "not JSON"),
        (lambda line: "[]", "a pack must be a JSON object, not list"),
        (
            lambda line: line.replace('"format":2', '"format":99'),
            "'format' is 99: .* reads 1 and 2",
        ),
        (lambda line: _without(line, "density"), "'density' is missing"),
        (lambda line: _without(line, "library"), "'library' is missing"),
        (lambda line: line.replace('"scale":', '"size":', 1), r"'items\[0\].scale' is missing"),
        (
            lambda line: line.replace('"rotation":', '"rotation":9', 1),
            r"rotation' is 9\d+: expected int <= 23",
        ),
        (
            lambda line: line.replace('"rotation":', '"rotation":true,"r":', 1),
            "expected int, got bool",
        ),
        (lambda line: line.replace('"location":[', '"location":[77,', 1), r"items\[0\].location"),
        (lambda line: line.replace('"cells":[100,', '"cells":[99,'), "'cells': .* multiple of 4"),
        (lambda line: line.replace('"scale":0', '"scale":-0', 1), "expected float > 0"),
        (lambda line: line.replace('"density":', '"density":NaN,"d":'), "not JSON"),
        (lambda line: line.replace('"scale":', '"scale":1e999,"s":', 1), "number out of range"),
        (lambda line: "\xff\xfe", "not JSON"),
    ],
)
def test_a_broken_line_is_named_by_file_line_and_field(pack, tmp_path, broken, message) -> None:
    path = tmp_path / "packs.jsonl"
    path.write_text(pack.to_json() + "\n" + broken(pack.to_json()) + "\n")
    with pytest.raises(PackFormatError, match=f"(?s)packs.jsonl, line 2: .*{message}"):
        read_packs(path)


def test_files_that_are_no_dataset_are_refused(pack, tmp_path) -> None:
    with pytest.raises(PackFormatError, match=r"absent.jsonl: No such file"):
        read_packs(tmp_path / "absent.jsonl")
    (tmp_path / "empty.jsonl").write_text("\n")
    with pytest.raises(PackFormatError, match=r"empty.jsonl holds no packs"):
        read_packs(tmp_path / "empty.jsonl")
    path = tmp_path / "packs.jsonl"
    write_packs(path, [pack, pack])
    path.write_text(pack.to_json() + "\n")
    with pytest.raises(
        PackFormatError, match=r"not the file that packs.jsonl.manifest.json describes"
    ):
        read_packs(path)
    manifest_path(path).write_text("{}")
    with pytest.raises(PackFormatError, match="is no manifest"):
        read_packs(path)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(pack, tmp_path, monkeypatch) -> None:
    path = tmp_path / "packs.jsonl"
    write_packs(path, [pack])
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    def fail(*args: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_packs(path, [pack, pack])
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_there_are_starter_packs_of_some_size() -> None:
    library = ShapeLibrary.open("everyday")
    tasks = load_tasks("starter", library)
    assert len(tasks) >= 8
    for task in tasks:
        assert len(task.items) >= 10


def test_bundled_packs_are_written_as_they_were() -> None:
    for name, split in (("starter", None), ("everyday-v1", "test")):
        first = dataset_file(name, split).read_text().splitlines()[0]
        assert Pack.from_json(first).to_json() == first


def test_a_folder_of_packs_may_have_other_splits(tmp_path) -> None:
    for name in ("packs", "extra"):
        (tmp_path / f"{name}.jsonl").touch()
    assert dataset_file(tmp_path).name == "packs.jsonl"
    assert dataset_file(tmp_path, "extra").name == "extra.jsonl"
    with pytest.raises(PackFormatError, match="there is no 'train'"):
        dataset_file(tmp_path, "train")


def test_the_library_of_a_file_without_manifest_is_that_of_its_first_readable_pack(
    tmp_path,
) -> None:
    library = ShapeLibrary.open("blockout")
    pack = Pack(LibraryRef.of(library), (100, 100, 100), (), 0.0)
    (tmp_path / "packs.jsonl").write_text(f"no pack\n{pack.to_json()}\n")
    assert dataset_library(tmp_path / "packs.jsonl").name == "blockout"


def test_a_path_named_like_nothing_is_refused(library) -> None:
    with pytest.raises(PackFormatError, match="can't be read from"):
        load_tasks(Path("nowhere.jsonl"), library)


@pytest.mark.parametrize("digits", [40, 401, 5000])
@pytest.mark.parametrize("number", [1, 2])
def test_endless_integers_are_refused(number, digits, tmp_path) -> None:
    """Wherever they are, in files of each format."""
    files = {1: RECORDS / "packs" / "sampled.jsonl", 2: dataset_file("starter")}
    line = files[number].read_text().splitlines()[0]
    for found in list(re.finditer(r"(?<=[:\[,])[0-9.]+(?=[,}\]])", line))[::5]:
        text = line[: found.start()] + "1" * digits + line[found.end() :]
        (tmp_path / "packs.jsonl").write_text(text)
        with pytest.raises(PackFormatError, match=rf"line 1: an integer of {digits} digits is not"):
            read_packs(tmp_path / "packs.jsonl")


def test_texts_and_floats_may_have_many_digits(pack) -> None:
    long = replace(pack, provenance=Other(author="1" * 401, notes="[" + "2" * 401 + "]"))
    assert Pack.from_json(long.to_json()) == long
    text = pack.to_json().replace('"density":0.', '"density":0.' + "0" * 401)
    assert Pack.from_json(text).density == 0
