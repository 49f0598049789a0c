import copy
import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from msgspec import structs
from trimesh import creation

from packit_sim import EvolutionSettings, evolve, placement
from packit_sim.box import Box
from packit_sim.core import typed_json
from packit_sim.core.check_reports import Report
from packit_sim.core.errors import PackFormatError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import manifest_path
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import dataset_file, read_packs, write_packs
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.datasets.provenance import Evolved, Other, Played
from packit_sim.geometry.shapes import Item
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.parts.packings.packing_files import verify_packing
from tests.zoo import HOLLOW, ZOO, item_of, random_item

SPLITS = {
    "train": ("bowl", "cube", "soup"),
    "test": ("plate", "ring", "tilted-cube"),
    "validation": ("ball", "hollow-box"),
}

ITEMS = {
    "train": (("cube", 2, 5), ("bowl", 2, 1), ("cube", 1, 0), ("bowl", 1, 7)),
    "test": (("tilted-cube", 2, 0), ("ring", 2, 3), ("plate", 1, 9)),
    "validation": (("hollow-box", 4, 0), ("ball", 2, 0), ("hollow-box", 1, 8), ("ball", 0.25, 0)),
}
"""Of each split's packs: shape, scale of the settings, rotation."""

SIZES = (0.5, 0.45)
"""Size factors of the two packs of a split, which have the seeds 0 and 1."""

Raw = dict[str, Any]
Files = dict[str, list[Raw]]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ShapeLibrary:
    path = tmp_path_factory.mktemp("library") / "zoo"
    entries = [stored.entry(shape) for shape in ZOO]
    stored.write(path, "zoo", "1", entries, split=lambda infos: SPLITS)
    return ShapeLibrary.open(path)


@pytest.fixture(scope="module")
def packs(library) -> dict[str, list[Pack]]:
    return {
        split: [_filled(library, split, seed, size) for seed, size in enumerate(SIZES)]
        for split in SPLITS
    }


@pytest.fixture
def files(packs) -> Files:
    """A dataset's packs as JSON, to be tampered with."""
    return {split: [json.loads(pack.to_json()) for pack in two] for split, two in packs.items()}


def _filled(library: ShapeLibrary, split: str, seed: int, size: float) -> Pack:
    box = Box()
    for shape, scale, rotation in ITEMS[split]:
        item = Item(library[shape], scale * size**3, rotation)
        location = box.blbf(item)
        assert location is not None
        box.place(item, location)
    settings = EvolutionSettings(pool=4, size_range=(0.4, 0.5))
    evolved = Evolved(seed=seed, generation=0, size=size, settings=settings)
    return Pack.of(box, LibraryRef.of(library), evolved)


def _written(folder: Path, files: Files) -> Path:
    """The folder of a dataset whose manifests describe its files, whatever they hold."""
    folder.mkdir()
    for name, packs in files.items():
        _write(folder / f"{name}.jsonl", packs)
    return folder


def _write(path: Path, packs: list[Raw]) -> None:
    path.write_text("".join(json.dumps(pack) + "\n" for pack in packs))
    libraries = {json.dumps(pack["library"]): pack["library"] for pack in packs}
    manifest = {
        "format": 2,
        "version": "0",
        "packs": len(packs),
        "sha256": "",
        "libraries": list(libraries.values()),
    }
    manifest_path(path).write_text(json.dumps(manifest))
    _sign(path)


def _sign(path: Path) -> None:
    """Brings the digest in a manifest up to date."""
    _change_manifest(path, sha256=hashlib.sha256(path.read_bytes()).hexdigest())


def _change_manifest(path: Path, **changes: Any) -> None:
    manifest = json.loads(manifest_path(path).read_text())
    manifest_path(path).write_text(json.dumps({**manifest, **changes}))


def _problem_lines(report: Report) -> str:
    return "\n".join(map(str, report.problems))


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(10, marks=pytest.mark.slow)])
def test_the_starter_packs_hold(count, tmp_path) -> None:
    calls: list[tuple[int, int]] = []
    file = dataset_file("starter")
    recorded = [pack.density for pack in read_packs(file)][:count]
    if count < 10:
        file = tmp_path / "packs.jsonl"
        write_packs(file, read_packs(dataset_file("starter"))[:count])
    report = verify_dataset(
        file,
        ShapeLibrary.open("everyday"),
        lambda done, total: calls.append((done, total)),
    )
    assert report.is_valid, _problem_lines(report)
    assert calls == [(n + 1, count) for n in range(count)]
    assert (report.files, report.packs, report.broken) == (1, count, 0)
    assert report.density == pytest.approx(np.mean(recorded))


def test_a_dataset_with_splits_is_valid(files, library, tmp_path) -> None:
    report = verify_dataset(_written(tmp_path / "dataset", files), library)
    assert report.is_valid, _problem_lines(report)
    assert (report.files, report.packs, report.items) == (3, 6, 22)


def test_generated_datasets_are_valid_with_all_kept_packs(library, tmp_path) -> None:
    sizes = {"pool": 8, "population": 6, "elite": 2, "lucky": 1, "generations": 1}
    settings = EvolutionSettings(**sizes, size_range=(0.4, 0.5))
    evolved = [evolve(library, seed, settings).best for seed in range(3)]
    write_packs(tmp_path / "packs.jsonl", evolved)
    report = verify_dataset(tmp_path, library)
    assert report.is_valid, _problem_lines(report)
    assert report.items >= 15


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_places_before_an_items_own_are_those_of_the_oracle(seed, library, tmp_path) -> None:
    rng = np.random.default_rng(seed)
    box = Box((48, 40, 44))
    places = []
    for _ in range(8):
        item = random_item(ZOO, 0.25, rng)
        locations = np.argwhere(box.feasible(item))
        if len(locations):
            places.append(placement.first(placement.oracle(box, item)))
            box.place(item, rng.choice(locations))
    evolved = Evolved(seed=0, generation=0, size=1.0, settings=EvolutionSettings(cells=box.cells))
    write_packs(tmp_path / "packs.jsonl", [Pack.of(box, LibraryRef.of(library), evolved)])
    lines = _problem_lines(verify_dataset(tmp_path, library))
    for n, (placed, first) in enumerate(zip(box.placed, places, strict=True)):
        wrong = f"item {n} ({placed.item.shape.id!r}) stands at {placed.location}, but"
        if placed.location != first:
            assert f"{wrong} bottom-left-back fill puts it at {first}" in lines
        assert (wrong in lines) == (placed.location != first)
    assert len(places) >= 5


def test_kept_packs_of_a_seed_and_attempts_at_a_task_may_be_alike(packs, library, tmp_path) -> None:
    raw = json.loads(packs["train"][0].to_json())
    kept = [{**raw, "provenance": {**raw["provenance"], "after": after}} for after in (0, 50)]
    _write(tmp_path / "kept.jsonl", kept)
    assert verify_dataset(tmp_path / "kept.jsonl", library).is_valid
    fields = {"task": 3, "task_digest": "", "seed": 0, "total": 0.5, "end": "no room"}
    rollouts = [Played(agent=agent, **fields) for agent in ("one", "two")]
    played = [{**raw, "provenance": typed_json.builtins(one)} for one in rollouts]
    _write(tmp_path / "played.jsonl", played)
    assert verify_dataset(tmp_path / "played.jsonl", library).is_valid


Change = Callable[[Files], object]


def put(split: str, number: int, path: str, value: Any) -> Change:
    """Sets a field of a pack: "items.0.scale"; a function is given what stands there."""

    def change(files: Files) -> None:
        target: Any = files[split][number]
        *keys, last = (int(key) if key.isdigit() else key for key in path.split("."))
        for key in keys:
            target = target[key]
        target[last] = value(target[last]) if callable(value) else value

    return change


def swap(split: str, one: int, other: int) -> Change:
    """Exchanges two items of a split's first pack."""

    def change(files: Files) -> None:
        items = files[split][0]["items"]
        items[one], items[other] = items[other], items[one]

    return change


def repeat(split: str, to: str, **changes: Any) -> Change:
    """Writes a split's first pack once more at the end of a split."""

    def change(files: Files) -> None:
        again = copy.deepcopy(files[split][0])
        again["provenance"].update(changes)
        files[to].append(again)

    return change


def reversed_twin(files: Files) -> None:
    """The first pack once more, by somebody else, its items the other way round."""
    twin = copy.deepcopy(files["train"][0])
    twin["items"].reverse()
    twin["provenance"] = {"kind": "other", "author": "somebody"}
    files["train"].append(twin)


def add_item(**changes: Any) -> Change:
    """A copy of the first validation pack's last item, with changes."""

    def change(files: Files) -> None:
        items = files["validation"][0]["items"]
        items.append({**items[-1], **changes})

    return change


def add_file(name: str) -> Change:
    """A file with a pack of the test split alone, which goes from there."""

    def change(files: Files) -> None:
        files[name] = [files["test"].pop()]

    return change


TAMPERED: dict[str, tuple[Change, str]] = {
    "moved up by a node": (
        put("train", 0, "items.3.location.2", lambda z: z + 1),
        r"train.jsonl, pack 0: item 3 \('bowl'\) stands at .* but .* fill puts it at \(",
    ),
    "moved onto another": (
        put("train", 0, "items.2.location", [0, 0, 0]),
        r"train.jsonl, pack 0: item 2 \('cube'\) is in conflict with items \[0",
    ),
    "moved out of the box": (
        put("test", 1, "items.1.location", [24, 0, 0]),
        r"test.jsonl, pack 1: item 1 \('ring'\) is not inside the box",
    ),
    "two items exchanged": (
        swap("validation", 0, 1),
        r"validation.jsonl, pack 0: item 0 \('ball'\) stands at .* puts it at \(0, 0, 0\)",
    ),
    "larger": (
        put("test", 0, "items.2.scale", lambda scale: 2 * scale),
        r"density is recorded as .*, replayed it is",
    ),
    "at a scale of no settings": (
        put("test", 0, "items.2.scale", lambda scale: 1.001 * scale),
        r"item 2 \('plate'\) has scale .* its settings' \[0.25, 0.5, 1.0, 2.0, 4.0\] at size 0.5",
    ),
    "a giant": (
        put("train", 0, "items.0.scale", 1e60),
        r"items\[0\].scale.*1e\+60: expected float <= 697",
    ),
    "a speck": (put("train", 0, "items.0.scale", 1e-300), r"item 0 .* none of its settings'"),
    "turned": (
        put("test", 1, "items.2.rotation", lambda rotation: (rotation + 8) % 24),
        r"test.jsonl, pack 1: item 2 \('plate'\)",
    ),
    "a negative scale": (
        put("train", 1, "items.0.scale", -0.5),
        "line 2: .*scale.*expected float > 0",
    ),
    "a scale in words": (
        put("train", 1, "items.0.scale", "1"),
        r"items\[0\].scale' is '1': expected float",
    ),
    "rotation 24": (
        put("train", 0, "items.0.rotation", 24),
        "line 1: .*rotation.*expected int <= 23",
    ),
    "a location off the grid": (
        put("train", 0, "items.0.location", [0, 25, 0]),
        "outside the grid",
    ),
    "a location between nodes": (put("train", 0, "items.0.location", [0, 0.5, 0]), "expected int"),
    "an unknown shape": (put("train", 0, "items.0.shape", "zebra"), "no shape 'zebra' in library"),
    "a shape of another split": (
        put("train", 0, "items.0.shape", "tilted-cube"),
        r"item 0 \('tilted-cube'\) is a shape of split test, the pack is of train",
    ),
    "a library's other version": (put("train", 0, "library.version", "2"), "library 'zoo' 2 "),
    "a library's other name": (put("train", 0, "library.name", "zebras"), "library 'zebras' 1 "),
    "a library's other digest": (put("train", 0, "library.digest", "0" * 64), r"\(000000000000\)"),
    "a larger box": (
        put("test", 0, "cells", [100, 100, 104]),
        r"\[100, 100, 104\] cells, its settings say \[100, 100, 100\]",
    ),
    "cells of no box": (put("test", 0, "cells", [100, 100, 102]), "'cells'.*multiple of 4"),
    "another format": (put("test", 0, "format", 3), "test.jsonl, pack 0: line 1: .*'format' is 3"),
    "an item removed": (
        lambda files: files["train"][0]["items"].pop(0),
        "density is recorded as",
    ),
    "no items": (lambda files: files["train"][0].update(items=[]), "it holds no items"),
    "an item twice": (add_item(), r"item 4 \('ball'\) is in conflict with items \[3"),
    "an item inside a hollow one": (
        add_item(location=[3, 3, 3]),
        r"item 4 \('ball'\) is in conflict with items \[0\]",
    ),
    "more items than the pool": (add_item(), "holds 5 items, more than its pool of 4"),
    "density off by 1e-6": (
        put("test", 0, "density", lambda density: density + 1e-6),
        "test.jsonl, pack 0: density is recorded as",
    ),
    "density as text": (put("test", 0, "density", "0.5"), "'density' is '0.5'.*expected float"),
    "the same pack twice": (repeat("train", "train", seed=7), "pack 2: .* the same as pack 0"),
    "the same pack the other way round": (reversed_twin, "pack 2: it is the same as pack 0"),
    "the same pack in two splits": (
        repeat("train", "test"),
        "train.jsonl, pack 0: it is the same as pack 2 of test.jsonl",
    ),
    "the same seed twice": (
        put("train", 1, "provenance.seed", 0),
        "pack 1: its seed 0 is that of pack 0",
    ),
    "a seed in words": (
        put("train", 1, "provenance.seed", "one"),
        "'provenance.seed' is 'one': expected int",
    ),
    "a seed that is a bool": (put("train", 1, "provenance.seed", True), "seed' is True: .*int"),
    "no seed": (
        lambda files: files["train"][1]["provenance"].pop("seed"),
        "'provenance.seed' is missing",
    ),
    "settings in words": (
        put("train", 0, "provenance.settings", "usual"),
        "'provenance.settings' is 'usual': expected object",
    ),
    "a pool in words": (put("train", 0, "provenance.settings.pool", "50"), "pool' is '50'"),
    "a pool of none": (put("train", 0, "provenance.settings.pool", 0), "pool = 0 is not possible"),
    "scales in words": (
        put("train", 0, "provenance.settings.scales", [1, "2"]),
        r"settings.scales\[1\]' is '2'",
    ),
    "no size": (
        lambda files: files["train"][0]["provenance"].pop("size"),
        "'provenance.size' is missing",
    ),
    "an infinite size": (
        put("train", 0, "provenance.size", 10**400),
        "line 1: an integer of 401 digits is not",
    ),
    "a size out of range": (
        put("train", 0, "provenance.settings.size_range", [0.1, 0.2]),
        "size 0.5 is",
    ),
    "a range of sizes in words": (
        put("train", 0, "provenance.settings.size_range", "all"),
        "size_range' is 'all': expected array",
    ),
    "recorded to be of another split": (
        put("train", 0, "provenance.split", "test"),
        "of several splits",
    ),
    "recorded to be of no split": (
        put("train", 0, "provenance.split", "dev"),
        "'provenance.split' is 'dev': choose from test, train, validation",
    ),
    "a provenance in words": (put("train", 0, "provenance", []), "'provenance' is .*object"),
    "a provenance of no kind": (
        put("train", 0, "provenance.kind", "magic"),
        "'provenance.kind' is 'magic': choose from evolution, ",
    ),
    "a location and a pose": (
        put("train", 0, "items.0.pose", {"position": [0, 0, 0], "wxyz": [1, 0, 0, 0]}),
        "an item must have either a location or a pose",
    ),
    "a file with a name of no split": (add_file("dev"), "dev.jsonl: .* can't have this name"),
    "a file for the whole beside splits": (add_file("packs"), "packs.jsonl: .* can't have this"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_tampering_is_reported(name, files, library, tmp_path) -> None:
    change, sentence = TAMPERED[name]
    change(files)
    lines = _problem_lines(verify_dataset(_written(tmp_path / "dataset", files), library))
    assert re.search(sentence, lines), lines
    assert "manifest" not in lines


def bytes_of(change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """Changes the bytes of the train split, and the digest in its manifest with them."""

    def damage(folder: Path) -> None:
        path = folder / "train.jsonl"
        path.write_bytes(change(path.read_bytes()))
        _sign(path)

    return damage


def manifest_with(**changes: Any) -> Callable[[Path], object]:
    return lambda folder: _change_manifest(folder / "train.jsonl", **changes)


def manifest_text(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "train.jsonl.manifest.json").write_text(text)


def without(key: str) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        path = folder / "train.jsonl.manifest.json"
        manifest = json.loads(path.read_text())
        del manifest[key]
        path.write_text(json.dumps(manifest))

    return damage


def add_byte(folder: Path) -> None:
    with (folder / "train.jsonl").open("ab") as file:
        file.write(b"\n")


def exchange_files(folder: Path) -> None:
    """The train split under the name of the test split, and the other way round."""
    for suffix in (".jsonl", ".jsonl.manifest.json"):
        one, other = folder / f"train{suffix}", folder / f"test{suffix}"
        first = one.read_bytes()
        one.write_bytes(other.read_bytes())
        other.write_bytes(first)


DAMAGED: dict[str, tuple[Callable[[Path], object], str]] = {
    "a truncated line": (
        bytes_of(lambda data: data[:-30]),
        "train.jsonl, pack 1: line 2: not JSON",
    ),
    "no end of line": (bytes_of(lambda data: data[:-1]), "train.jsonl: its last line has no end"),
    "a line of garbage": (
        bytes_of(lambda data: b"\x80\xff\x00\n" + data),
        "train.jsonl, pack 0: line 1: not JSON",
    ),
    "a line of brackets": (
        bytes_of(lambda data: b"[" * 100_000 + b"\n" + data),
        "line 1: a pack must",
    ),
    "a line with a long number": (
        bytes_of(lambda data: b'{"format":' + b"9" * 5000 + b"}\n" + data),
        "line 1: an integer of 5000 digits is not possible",
    ),
    "a line that is no pack": (bytes_of(lambda data: data + b"3\n"), "line 3: .* object, not int"),
    "NaN for density": (
        bytes_of(lambda data: data.replace(b'"density": 0', b'"density": NaN, "d": 0', 1)),
        "line 1: not JSON",
    ),
    "a density beyond floats": (
        bytes_of(lambda data: data.replace(b'"density": 0', b'"density": 1e999, "d": 0', 1)),
        "field 'density' is .*out of range",
    ),
    "a field twice": (
        bytes_of(lambda data: data.replace(b'"density"', b'"density": 0.9, "density"', 1)),
        "line 1: field 'density' comes twice",
    ),
    "a blank file": (bytes_of(lambda data: b"\n\n"), "train.jsonl: it holds no packs"),
    "an empty file": (bytes_of(lambda data: b""), "train.jsonl: it holds no packs"),
    "one byte more": (
        add_byte,
        "train.jsonl.manifest.json: field 'sha256' is .*, of train.jsonl it is",
    ),
    "a wrong digest": (manifest_with(sha256="0" * 64), "manifest.json: field 'sha256' is '000"),
    "a wrong number": (manifest_with(packs=3), "'packs' is 3, of train.jsonl it is 2"),
    "a number that is none": (manifest_with(packs=2.0), "'packs' is 2.0: expected int"),
    "no digest": (without("sha256"), "train.jsonl.manifest.json: field 'sha256' is missing"),
    "no number": (without("packs"), "field 'packs' is missing"),
    "no libraries": (without("libraries"), "field 'libraries' is missing"),
    "no version": (without("version"), "field 'version' is missing"),
    "a wrong library": (manifest_with(libraries=[]), r"'libraries' is \(\), of train.jsonl it is"),
    "a manifest of another format": (manifest_with(format=9), "'format' is 9"),
    "a manifest of another split": (manifest_with(split="test"), "several splits: 'train', 'test'"),
    "no manifest": (
        lambda folder: (folder / "train.jsonl.manifest.json").unlink(),
        "train.jsonl: it has no manifest train.jsonl.manifest.json",
    ),
    "no JSON for a manifest": (manifest_text("{"), "train.jsonl.manifest.json: not JSON"),
    "a list for a manifest": (manifest_text("[]"), "a manifest must be a JSON object, not list"),
    "a manifest alone": (
        lambda folder: (folder / "train.jsonl").unlink(),
        "train.jsonl.manifest.json: there is no file that this manifest describes",
    ),
    "files exchanged": (exchange_files, "is a shape of split test, the pack is of train"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_reported(name, files, library, tmp_path) -> None:
    damage, sentence = DAMAGED[name]
    folder = _written(tmp_path / "dataset", files)
    damage(folder)
    lines = _problem_lines(verify_dataset(folder, library))
    assert re.search(sentence, lines), lines


def test_one_run_reports_all_problems(files, library, tmp_path) -> None:
    put("train", 0, "density", 0.9)(files)
    put("train", 1, "items.0.location", [24, 24, 24])(files)
    put("validation", 1, "items.1.shape", "zebra")(files)
    folder = _written(tmp_path / "dataset", files)
    with (folder / "test.jsonl").open("ab") as file:
        file.write(b"garbage\n")
    report = verify_dataset(folder, library)
    lines = _problem_lines(report)
    for found in (
        "test.jsonl, pack 2: line 3",
        "test.jsonl.manifest.json: field 'packs'",
        "recorded as 0.9",
    ):
        assert found in lines
    assert "train.jsonl, pack 1: item 0" in lines and "zebra" in lines
    assert (report.packs, report.broken, report.is_valid) == (7, 4, False)


def test_a_library_without_splits_is_reported_for_each_pack(packs, tmp_path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    creation.box((1, 1, 1)).export(meshes / "cube.stl")
    library = ShapeLibrary.open(meshes)
    box = Box()
    box.place(Item(library["cube"], 0.1), (0, 0, 0))
    write_packs(
        tmp_path / "train.jsonl", [Pack.of(box, LibraryRef.of(library), Other(split="train"))]
    )
    report = verify_dataset(tmp_path / "train.jsonl", library)
    assert len(report.problems) == 1 and "has no splits" in _problem_lines(report)


def test_what_is_no_dataset_is_refused(library, tmp_path) -> None:
    with pytest.raises(PackFormatError, match=r"can't be read from .*absent.jsonl: No such file"):
        verify_dataset(tmp_path / "absent.jsonl", library)
    with pytest.raises(PackFormatError, match=r"a folder without packs"):
        verify_dataset(tmp_path, library)


def test_a_density_above_1_never_verifies(library) -> None:
    box = Box()
    box.place(Item(library["cube"], (0.96 * 3**0.5) ** 3), (0, 0, 0))
    once = Pack.of(box, LibraryRef.of(library))
    assert verify(once, library) == []
    twice = replace(once, items=once.items * 2, density=2 * once.density)
    assert twice.density > 1.7
    assert any("items can't be larger than their box" in one for one in verify(twice, library))


def test_a_pack_with_a_pose_that_is_no_rotation_is_a_problem_of_its_own(files, library, tmp_path):
    item = files["train"][1]["items"][0]
    del item["location"]
    item["pose"] = {"position": [0.5, 0.5, 0.5], "wxyz": [1, 0, 1e308, 0]}
    report = verify_dataset(_written(tmp_path / "dataset", files), library)
    assert "train.jsonl, pack 1: " in _problem_lines(report) and report.packs == 6
    assert "is no rotation" in _problem_lines(report)


# Packings by other tools


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with mesh files in millimetres."""
    folder = tmp_path_factory.mktemp("packing")
    (folder / "parts").mkdir()
    meshes = {
        "cube.stl": creation.box((100, 100, 100)),
        "corner.obj": creation.box(bounds=((0, 0, 0), (100, 50, 25))),
        "ball.ply": creation.icosphere(subdivisions=2, radius=20),
        "thick.stl": creation.box((300, 200, 4.5)),
        "thin.stl": creation.box((210, 110, 1.5)),
        "hollow.stl": HOLLOW.mesh.copy().apply_scale(100 * 3**0.5),
        "open.off": _open_box(),
    }
    for name, mesh in meshes.items():
        mesh.export(folder / "parts" / name)
    (folder / "parts" / "broken.stl").write_bytes(b"solid of nothing")
    return folder


def _open_box() -> trimesh.Trimesh:
    box = creation.box((100, 100, 100))
    return box.submesh([np.flatnonzero(box.face_normals[:, 2] < 0.5)], append=True)


def at(x: float, y: float, z: float, scale: float = 1.0) -> list[list[float]]:
    return [[scale, 0, 0, x], [0, scale, 0, y], [0, 0, scale, z], [0, 0, 0, 1]]


def turned(x: float, y: float, z: float, angle: float) -> list[list[float]]:
    pose = trimesh.transformations.rotation_matrix(angle, (1, 2, 3))
    pose[:3, 3] = x, y, z
    return pose.tolist()


def sheared(x: float, y: float, z: float) -> list[list[float]]:
    pose = at(x, y, z)
    pose[0][1] = 0.1
    return pose


def mirrored(x: float, y: float, z: float) -> list[list[float]]:
    pose = at(x, y, z)
    pose[2][2] = -1
    return pose


def _verify(folder: Path, tmp: Path, *items: tuple[str, Any], **fields: Any) -> Report:
    """Verifies a packing of items, by mesh and pose, in a box of 400 x 300 x 200 mm."""
    for mesh in (folder / "parts").iterdir():
        (tmp / "parts").mkdir(exist_ok=True)
        (tmp / "parts" / mesh.name).write_bytes(mesh.read_bytes())
    listed = [{"mesh": f"parts/{mesh}", "pose": pose} for mesh, pose in items]
    packing = {"box": [400, 300, 200], "unit": "mm", "items": listed, **fields}
    (tmp / "packing.json").write_text(json.dumps(packing))
    return verify_packing(tmp / "packing.json")


def test_a_good_packing_is_valid_and_is_measured(parts, tmp_path) -> None:
    report = _verify(
        parts,
        tmp_path,
        ("cube.stl", at(50, 50, 50)),
        ("cube.stl", at(150, 50, 50)),
        ("corner.obj", at(0, 100, 0)),
        ("ball.ply", turned(30, 250, 100, 0.7)),
        ("cube.stl", at(275, 75, 75, 1.5)),
        ("open.off", at(350, 200, 50)),
    )
    assert report.is_valid, _problem_lines(report)
    assert (report.files, report.packs, report.items) == (1, 1, 6)
    assert report.space == pytest.approx(400 * 300 * 200)
    solids = 2 * 100**3 + 100 * 50 * 25 + 150**3
    ball = creation.icosphere(subdivisions=2, radius=20).volume
    assert solids + ball < report.volume < solids + ball + 100**3
    assert report.density == pytest.approx(report.volume / report.space)


HOLLOW_ITEM = ("hollow.stl", at(50, 50, 50))

WRONG: dict[str, tuple[list[tuple[str, Any]], str]] = {
    "overlap": (
        [("cube.stl", at(50, 50, 50)), ("cube.stl", at(149, 50, 50))],
        r"packing.json: item 1 \('parts/cube.stl'\) crosses item 0 \('parts/cube.stl'\)",
    ),
    "overlap of turned ones": (
        [("cube.stl", turned(100, 100, 100, 0.5)), ("cube.stl", turned(170, 150, 100, 0.9))],
        "item 1 .* crosses item 0",
    ),
    "one at the place of another": (
        [("cube.stl", at(50, 50, 50)), ("cube.stl", at(50, 50, 50))],
        "item 1 .* item 0",
    ),
    "inside another": (
        [("cube.stl", at(50, 50, 50)), ("ball.ply", at(50, 50, 50))],
        r"item 1 \('parts/ball.ply'\) lies, in part or whole, inside item 0",
    ),
    "around another": (
        [("ball.ply", at(50, 50, 50)), ("cube.stl", at(50, 50, 50))],
        "item 0 .* lies, in part or whole, inside item 1",
    ),
    "in a closed cavity": ([HOLLOW_ITEM, ("ball.ply", at(50, 50, 50))], "item 1 .* inside item 0"),
    "a sheet in a thicker one": (
        [("thick.stl", at(160, 110, 5)), ("thin.stl", at(160, 110, 5))],
        r"item 1 \('parts/thin.stl'\) lies, in part or whole, inside item 0",
    ),
    "a sheet around a thinner one": (
        [("thin.stl", at(160, 110, 5)), ("thick.stl", at(160, 110, 5))],
        r"item 0 \('parts/thin.stl'\) lies, in part or whole, inside item 1",
    ),
    "outside the box": (
        [("cube.stl", at(50, 50, 151))],
        r"item 0 \('parts/cube.stl'\) reaches 1 beyond the box's top wall",
    ),
    "beyond the left wall": ([("cube.stl", at(49, 50, 50))], "reaches 1 beyond .* left wall"),
    "mirrored": ([("cube.stl", mirrored(50, 50, 50))], "its pose mirrors the mesh"),
    "sheared": ([("cube.stl", sheared(50, 50, 50))], "its pose shears the mesh"),
    "axes scaled unlike": (
        [("cube.stl", [[2, 0, 0, 100], *at(50, 50, 50)[1:]])],
        "scales its axes unlike",
    ),
    "of no size": ([("cube.stl", at(50, 50, 50, 0))], "its scale is 0"),
    "in perspective": (
        [("cube.stl", [*at(50, 50, 50)[:3], [0, 0, 0, 2]])],
        r"last row \[0.0, 0.0, 0.0, 2.0\]: it must be 0, 0, 0, 1",
    ),
    "a missing mesh": ([("absent.stl", at(50, 50, 50))], "item 0 .* has no mesh: .*No such file"),
    "a broken mesh": ([("broken.stl", at(50, 50, 50))], "item 0 .* has no mesh: .*broken.stl"),
    "no mesh file": ([("cube.txt", at(50, 50, 50))], "not a mesh file"),
}


@pytest.mark.parametrize("name", WRONG)
def test_problems_of_a_packing_are_reported(name, parts, tmp_path) -> None:
    items, sentence = WRONG[name]
    report = _verify(parts, tmp_path, *items, ("ball.ply", at(350, 250, 150)))
    assert len(report.problems) == 1 and re.search(sentence, _problem_lines(report)), (
        _problem_lines(report)
    )


def test_contents_of_an_open_box_are_no_conflict(parts, tmp_path) -> None:
    report = _verify(parts, tmp_path, ("open.off", at(50, 50, 50)), ("ball.ply", at(50, 50, 60)))
    assert report.is_valid, _problem_lines(report)


def test_a_sheet_in_a_thicker_sheet_does_not_hold(tmp_path) -> None:
    """Nothing crosses, and no fine cell is inner for one of them."""
    blocks = (creation.box(size) for size in ((0.3, 0.2, 0.0045), (0.21, 0.11, 0.0015)))
    sheets = [item_of(block, id) for id, block in zip(("thick", "thin"), blocks, strict=True)]
    entries = [stored.entry(sheet.shape) for sheet in sheets]
    stored.write(tmp_path / "sheets", "sheets", "1", entries)
    library = ShapeLibrary.open(tmp_path / "sheets")
    box = Box()
    for sheet, location in zip(sheets, ((1, 1, 1), (3, 10, 1)), strict=True):
        box.place(Item(library[sheet.shape.id], sheet.scale), location)
    apart = Pack.of(box, library)
    assert verify(apart, library) == []
    inside = structs.replace(apart.items[1], location=(3, 1, 1))
    (problem,) = verify(replace(apart, items=(apart.items[0], inside)), library)
    assert problem == "item 1 ('thin') is in conflict with items [0]"


def test_surfaces_may_overlap_by_the_tolerance_of_the_box(parts, tmp_path) -> None:
    cube = ("cube.stl", at(50, 50, 50))
    assert _verify(parts, tmp_path, cube, ("cube.stl", at(149.97, 50, 50))).is_valid
    assert not _verify(parts, tmp_path, cube, ("cube.stl", at(149.9, 50, 50))).is_valid


@pytest.mark.parametrize("long", [10, 1e4, 1e8])
def test_in_a_long_box_the_tolerance_is_that_of_the_smaller_item(long, parts, tmp_path) -> None:
    def verified(*positions: float) -> Report:
        cubes = [("cube.stl", at(x, 0.5, 0.5, 0.01)) for x in positions]
        return _verify(parts, tmp_path, *cubes, box=[long, 1, 1])

    assert len(verified(0.5, 0.5, 0.5, 0.5, 0.5).problems) == 4 + 3 + 2 + 1
    assert len(verified(0.5, 1.4, 2.3).problems) == 2
    assert verified(0.5, 1.5, 2.5, long - 0.5).is_valid
    assert verified(0.5, 1.4995, long - 0.4995).is_valid
    for positions in ((0.5, 1.498), (0.498, 1.5), (0.5, long - 0.498)):
        assert len(verified(*positions).problems) == 1, positions


def test_a_small_item_on_a_large_one_has_the_small_ones_tolerance(parts, tmp_path) -> None:
    large = ("cube.stl", at(50, 50, 50))
    small = lambda x: ("cube.stl", at(x, 50, 50, 0.001))  # noqa: E731
    assert _verify(parts, tmp_path, large, small(100.05)).is_valid
    assert not _verify(parts, tmp_path, large, small(100.049)).is_valid
    assert not _verify(parts, tmp_path, small(100.049), large).is_valid


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"box": [1, 2]}, r"packing.json: field 'box' is \[1, 2\]: expected array of length 3"),
        ({"box": [1, 2, "3"]}, r"field 'box\[2\]' is '3'"),
        ({"box": [1, 2, True]}, r"field 'box\[2\]' is True"),
        ({"box": None}, "field 'box' is None"),
        ({"box": [1, 2, 0]}, r"field 'box\[2\]' is 0: expected float"),
        ({"unit": 3}, "field 'unit' is 3: expected str"),
        ({"items": []}, r"field 'items' is \[\]: expected array of length >= 1"),
        ({"items": {}}, "field 'items'"),
        ({"items": [3]}, r"field 'items\[0\]' is 3: expected object"),
        ({"items": [{"pose": at(0, 0, 0)}]}, r"field 'items\[0\].mesh' is missing"),
        (
            {"items": [{"mesh": "/tmp/a.stl", "pose": at(0, 0, 0)}]},
            "must be a path inside the packing",
        ),
        (
            {"items": [{"mesh": "../a.stl", "pose": at(0, 0, 0)}]},
            "must be a path inside the packing",
        ),
        (
            {"items": [{"mesh": "C:\\a.stl", "pose": at(0, 0, 0)}]},
            "must be a path inside the packing",
        ),
        ({"items": [{"mesh": "a.stl"}]}, r"field 'items\[0\].pose' is missing"),
        ({"items": [{"mesh": "a.stl", "pose": [[1] * 4] * 3}]}, r"field 'items\[0\].pose'"),
        ({"items": [{"mesh": "a.stl", "pose": at(float("nan"), 0, 0)}]}, "not JSON"),
        ({"items": [{"mesh": "a.stl", "pose": at(0, 10**400, 0)}]}, "integer of 401 digits"),
    ],
)
def test_a_file_that_is_no_packing_is_refused(fields, message, parts, tmp_path) -> None:
    with pytest.raises(PackFormatError, match=message):
        _verify(parts, tmp_path, **fields)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"{", "not JSON"), (b"\xff", "not JSON"), (b"[]", "a JSON object, not list")],
)
def test_a_file_that_is_no_json_object_is_refused(content, message, tmp_path) -> None:
    (tmp_path / "packing.json").write_bytes(content)
    with pytest.raises(PackFormatError, match=rf"packing.json: .*{message}"):
        verify_packing(tmp_path / "packing.json")
    with pytest.raises(PackFormatError, match=r"can't be read from .*absent.json: No such file"):
        verify_packing(tmp_path / "absent.json")


@pytest.mark.parametrize("split", SPLITS)
def test_our_own_packs_hold_as_another_tools_packings(split, packs, library, tmp_path) -> None:
    pack = packs[split][0]
    items = []
    for placed in pack.placed(library):
        name = f"{placed.item.shape.id}.ply"
        placed.item.shape.mesh.export(tmp_path / name)
        items.append({"mesh": name, "pose": placed.matrix.tolist()})
    (tmp_path / "packing.json").write_text(json.dumps({"box": [1, 1, 1], "items": items}))
    report = verify_packing(tmp_path / "packing.json")
    assert report.is_valid, _problem_lines(report)
    assert report.density == pytest.approx(pack.density, rel=1e-3)
