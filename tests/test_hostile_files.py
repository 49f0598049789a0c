"""Hostile files: what was found by fuzzing is read or refused; the fuzzer finds planted defects."""

from __future__ import annotations

import json
import logging
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import gymnasium
import pytest

pytest.importorskip("torch")
pytest.importorskip("minari")
from campaigns import common
from campaigns.fuzzing import children, learning_readers, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from campaigns.fuzzing.readers import READERS
from campaigns.fuzzing.reduction import reduce
from campaigns.fuzzing.table import HOSTILE, PAGE, table
from campaigns.fuzzing.verdicts import MAX_MEMORY, judge
from packit_sim.core.errors import LibraryError, PackItError, UnknownShapeError
from packit_sim.core.plain_text import MAX_CHARACTERS, plain_logger
from packit_sim.game.envs.minari_format import RecordingError
from packit_sim.game.envs.recording import stage_steps
from packit_sim.game.episodes.episode import Stage
from packit_sim.libraries import folder
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.parts.reading.files import find_parts

h5py = pytest.importorskip("h5py")

FILES = sorted(HOSTILE.glob("*/*"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}-{file.name}")
def test_a_file_that_was_found_is_read_or_refused(file: Path) -> None:
    assert judge(READERS[file.parent.name], file.read_bytes()) is None


@pytest.mark.parametrize("reader", READERS.values(), ids=lambda reader: reader.name)
def test_a_reader_reads_a_file_to_start_from(reader: Reader) -> None:
    seeds = reader.seeds()
    assert seeds and max(map(len, seeds)) < 50_000
    read = 0
    for data in seeds:
        try:
            reader.read(data)  # also compiles what the time of the reader does not include
            read += 1
        except PackItError:
            pass  # of the bad meshes, and of shapes that the small library does not have
        assert judge(reader, data) is None
    assert read or reader.name == "results-1"


def _raise(error: BaseException) -> None:
    raise error


def _take_memory() -> None:
    b"x" * (MAX_MEMORY + 2**24)


def _take_time() -> None:
    while True:
        pass


PLANTED: dict[str, Callable[[], object]] = {
    "untyped error": lambda: _raise(KeyError("scale")),
    "memory": _take_memory,
    "time": _take_time,
    "warning": lambda: warnings.warn("a division by 0", RuntimeWarning, stacklevel=1),
    "message": lambda: logging.getLogger("packit_sim.planted").warning("named \x1b[2J"),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_a_planted_defect_is_found(kind: str) -> None:
    limit = 0.05 if kind == "time" else 5.0
    reader = Reader("x", "", list, lambda data: PLANTED[kind](), seconds=limit)

    def find() -> None:
        found = judge(reader, b"")
        assert found is not None and found.kind == kind

    child = children.start(find)  # its peak of memory is not that of earlier tests
    assert children.wait(child, 60) == 0


def test_a_batch_finds_planted_defects_and_survives_a_crash(tmp_path: Path) -> None:
    atheris = pytest.importorskip("atheris")
    from campaigns.fuzzing import batches

    @atheris.instrument_func
    def read(data: bytes) -> None:
        if b"null" in data:
            os.abort()
        if b"scale" in data and b"-1" in data:
            raise KeyError("scale")

    reader = Reader("planted", "", lambda: [b'{"scale": 1}'], read, json_tree)
    inputs, kinds = 0, set()
    for seed in range(20):
        inputs += batches.run(reader, 1, seed, tmp_path).inputs
        kinds |= {json.loads(f.read_text())["kind"] for f in (tmp_path / "found").glob("*.json")}
        if kinds == {"untyped error", "crash"}:
            break
    assert kinds == {"untyped error", "crash"} and inputs > 20


def test_what_was_found_is_reduced() -> None:
    reader = Reader("x", "", list, lambda data: _raise(KeyError()) if b"bad" in data else None)
    data = b"some words, of which bad is one, and more words"
    found = judge(reader, data)
    assert found is not None and reduce(reader, data, found) == b"bad"


@pytest.mark.parametrize("name", ["packs", "settings", "glb", "weights", "library-meshes", "obj"])
def test_changed_files_are_other_files_and_the_same_for_a_seed(name: str) -> None:
    reader = READERS[name]
    data = reader.seeds()[-1]
    made = [[_changed(reader, data, seed) for seed in range(40)] for _ in range(2)]
    assert made[0] == made[1] and len({*made[0]}) > 20


def _changed(reader: Reader, data: bytes, seed: int) -> bytes:
    return reader.mutator(data, Random(seed), lambda data: data + b"x")


def test_the_page_shows_the_results() -> None:
    assert common.table_in_page(PAGE) == table()


# what was found and can't be a single file


def test_a_recording_without_spaces_runs_nothing(tmp_path: Path) -> None:
    recording = learning_readers.recording_folder()
    for file in recording.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    metadata = json.loads((tmp_path / "metadata.json").read_text())
    touched = tmp_path / "touched"
    spec = gymnasium.envs.registration.EnvSpec(
        "Evil-v0", entry_point="pathlib:Path.touch", kwargs={"self": str(touched)}
    )
    spec.entry_point = "subprocess:check_output"
    spec.kwargs = {"args": ["touch", str(touched)]}
    metadata["env_spec"] = spec.to_json()
    del metadata["observation_space"]
    (tmp_path / "metadata.json").write_text(json.dumps(metadata))
    with pytest.raises(RecordingError, match="'observation_space' is missing"):
        list(stage_steps(tmp_path, Stage.SHAPE))
    assert not touched.exists()


RECORDED: dict[str, tuple[Callable[[Any], object], str]] = {
    "external link": (
        lambda group: group.__setitem__("x", h5py.ExternalLink("/etc/passwd", "/")),
        "'/episode_0/x' is a link",
    ),
    "soft link": (lambda group: group.__setitem__("x", h5py.SoftLink("/")), "x' is a link"),
    "circle": (lambda group: group["infos"].__setitem__("x", group["infos"]), "x' is linked twice"),
    "external data": (
        lambda group: group.create_dataset("x", (9,), "u1", external=[("/etc/passwd", 0, 9)]),
        "x' is in another file",
    ),
    "nothing, very large": (
        lambda group: group.create_dataset("x", (10**9,), "u1", chunks=(1000,)),
        "x' would take 1,000,000,000 bytes",
    ),
}


@pytest.mark.parametrize(("change", "problem"), RECORDED.values(), ids=RECORDED)
def test_a_recording_is_read_from_its_file_alone(
    tmp_path: Path, change: Callable[[Any], object], problem: str
) -> None:
    for file in learning_readers.recording_folder().iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    assert len(list(stage_steps(tmp_path, Stage.SHAPE))) == 2
    with h5py.File(tmp_path / "main_data.hdf5", "a") as file:
        change(file["episode_0"])
    with pytest.raises(RecordingError, match=problem):
        list(stage_steps(tmp_path, Stage.SHAPE))


def test_a_folder_of_too_many_files_is_not_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder, "MAX_ENTRIES", 20)
    for number in range(21):
        (tmp_path / f"{number}.txt").touch()
    with pytest.raises(LibraryError, match="more than 20 files"):
        ShapeLibrary.open(tmp_path)


LONG = "a" * 5000
"""No file can have such a name."""

NAMED = {
    "instances": (b"parts/box.stl", f"{LONG}/x.stl"),
    "solutions": (b"given.json", f"{LONG}.json"),
    "manifests": (b"@LIBRARY@", LONG),
    "boxes": (b"A:30", f"{LONG}.stl\nA:30"),
}


@pytest.mark.parametrize("name", NAMED)
def test_a_file_that_names_a_file_by_too_long_a_name_is_refused(name: str) -> None:
    text, long = NAMED[name]
    data = READERS[name].seeds()[0]
    assert text in data
    with pytest.raises(PackItError):
        READERS[name].read(data.replace(text, long.encode()))


@pytest.mark.parametrize("name", [f"{LONG}.stl", f"{LONG}.stl=3", f"{LONG}*", f"{LONG}.csv"])
def test_too_long_a_name_of_a_part_is_refused(name: str) -> None:
    with pytest.raises(PackItError):
        find_parts([name])
    with pytest.raises(LibraryError, match="no shape library"):
        ShapeLibrary.open(name)


def test_messages_are_one_plain_line() -> None:
    text = str(UnknownShapeError("no shape 'a\x1b]0;x\x07\nb\u202e\ud800\x9b'"))
    assert text == "no shape 'a\u241b]0;x\u2407 b\ufffd\ufffd\ufffd'"
    text = str(PackItError("x" * 10_000 + "end"))
    assert len(text) <= MAX_CHARACTERS and text.endswith("end") and " more] " in text


def test_records_are_one_plain_line(caplog: pytest.LogCaptureFixture) -> None:
    logger = plain_logger("planted")
    logger.warning("%s is skipped\n%s", "\x1b[2J", 7)
    assert caplog.messages == ["\u241b[2J is skipped 7"]


def test_every_logger_writes_plain_lines() -> None:
    root = Path(world.__file__).parents[2]
    for name in ("packit_sim", "agents/packit_agents"):
        for file in (root / name).rglob("*.py"):
            assert "_log = logging.getLogger" not in file.read_text(), file
