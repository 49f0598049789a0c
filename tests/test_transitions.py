"""Transitions of recorded episodes: what they contain, resuming, and damaged folders."""

import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from packit_sim.box import Box
from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import digest_of
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.transitions import (
    TransitionsError,
    TransitionsManifest,
    read_transitions,
    record_transitions,
)
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from tests.runs import packit

AGENTS = ["largest-first/aligned/blbf", "random/random/random"]


@pytest.fixture(scope="module")
def library() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


@pytest.fixture(scope="module")
def tasks(library: ShapeLibrary) -> tuple[Task, ...]:
    return load_tasks("starter", library)[:2]


def record(
    folder: Path, tasks: tuple[Task, ...], shards: int, seed: int = 3
) -> TransitionsManifest:
    agents = [Agent.from_name(name) for name in AGENTS]
    return record_transitions(folder, tasks, agents, shards, episodes=2, seed=seed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, tasks: tuple[Task, ...]) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "transitions"
    record(folder, tasks, 2)
    return folder


def test_each_step_is_that_of_the_game(folder, tasks, library) -> None:
    steps = 0
    for shard in read_transitions(folder):
        assert shard.agent.tolist() == [0, 1]
        for episode, first in enumerate(shard.first[:-1].tolist()):
            task, box = tasks[shard.task[episode]], Box()
            assert not shard.filled(first + episode).any()
            for step in range(first, shard.first[episode + 1]):
                assert shard.state(step) == step + episode
                shape = library[str(shard.shapes[shard.shape[step]])]
                item = Item(shape, float(shard.scale[step]), int(shard.rotation[step]))
                assert item.turned(0) in task.items
                assert np.array_equal(shard.feasible(step), box.feasible(item))
                box.place(item, shard.location[step].tolist())
                after = shard.state(step) + 1
                assert np.array_equal(shard.filled(after), box.outer)
                assert shard.reward[step] == item.volume / task.volume
                tops = box.outer * np.arange(1, 101)
                assert np.array_equal(shard.heights[after], tops.max(axis=2))
                steps += 1
    assert steps == TransitionsManifest.read(folder).steps > 20


def test_a_recording_is_resumed_and_extended(tmp_path, tasks, folder) -> None:
    record(tmp_path, tasks, 1)
    before = (tmp_path / "000000.npz").stat().st_mtime_ns
    (tmp_path / "000001.npz").write_bytes(b"written, but not in the manifest")
    assert record(tmp_path, tasks, 2) == TransitionsManifest.read(folder)
    assert (tmp_path / "000000.npz").stat().st_mtime_ns == before
    (*_, last) = read_transitions(tmp_path)
    (*_, expected) = read_transitions(folder)
    assert np.array_equal(last.occupancy, expected.occupancy)


def test_other_settings_are_refused(tasks, folder) -> None:
    with pytest.raises(TransitionsError, match="transitions of other seed: 3, not 4; choose"):
        record(folder, tasks, 2, seed=4)
    with pytest.raises(TransitionsError, match="other tasks"):
        record(folder, tasks[:1], 2)
    planner = Agent.from_name("largest-first/aligned/blbf+beam=2")
    with pytest.raises(ArgumentError, match="leave out its search"):
        record_transitions(folder, tasks, [planner], 1)
    with pytest.raises(ArgumentError, match="at least one task"):
        record_transitions(folder, (), [planner], 1)


def _truncate(folder: Path) -> None:
    file = folder / "000000.npz"
    file.write_bytes(file.read_bytes()[:1000])


def _edit(**changes: object) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / "manifest.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | changes))

    return edit


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_truncate, "000000.npz is not the file that the manifest records"),
        (lambda folder: (folder / "000000.npz").unlink(), "000000.npz can't be read: No such file"),
        (lambda folder: (folder / "manifest.json").unlink(), "holds no transitions: No such file"),
        (_edit(version=2), "version 2: this one reads"),
        (_edit(seed="x"), "manifest.json: field 'seed' is 'x'"),
    ],
)
def test_a_damaged_folder_is_named(tmp_path, folder, damage, message) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    damage(copy)
    with pytest.raises(TransitionsError, match=message):
        list(read_transitions(copy))


def _put(**arrays: object) -> Callable[[Path], None]:
    """Replace arrays of the first shard, and the digest in the manifest."""

    def put(folder: Path) -> None:
        file = folder / "000000.npz"
        with np.load(file) as found:
            kept = {name: found[name] for name in found if arrays.get(name, 0) is not None}
        np.savez(file, **kept | {name: own for name, own in arrays.items() if own is not None})
        _sign(folder)

    return put


def _sign(folder: Path) -> None:
    shards = json.loads((folder / "manifest.json").read_text())["shards"]
    shards[0]["sha256"] = digest_of(folder / "000000.npz")
    _edit(shards=shards)(folder)


def _shard(**changes: object) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        shards = json.loads((folder / "manifest.json").read_text())["shards"]
        _edit(shards=[shards[0] | changes, *shards[1:]])(folder)

    return edit


def _bomb(folder: Path) -> None:
    """Write a shard of few bytes whose heights would take terabytes."""
    text = "{'descr': '<i2', 'fortran_order': False, 'shape': (100000002, 100, 100), }"
    head = text.ljust(117).encode() + b"\n"
    with zipfile.ZipFile(folder / "000000.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["heights.npy"] = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
    with zipfile.ZipFile(folder / "000000.npz", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    _sign(folder)


@pytest.mark.parametrize(
    ("forgery", "message"),
    [
        (_shard(file="../outside.npz"), "its shards are not in order, each with its own name"),
        (_shard(file="/etc/hostname"), "its shards are not in order, each with its own name"),
        (_shard(number=7, file="000007.npz"), "its shards are not in order"),
        (_shard(steps=-1), "steps' is -1: expected int >= 0"),
        (_shard(steps=10**8), "000000.npz: no transitions: .*is int32 of shape"),
        (_edit(cells=[101, 100, 100]), "manifest.json: a box of 101 x 100 x 100 cells"),
        (_edit(episodes=0), "'episodes' is 0"),
        (_put(mask=None), "no transitions: .*mask.npy"),
        (_put(scale=np.array([print], dtype=object)), "no transitions: 'scale' is object"),
        (_put(first=np.array([0, 99, 3], np.int32)), "first steps of its episodes are not in"),
        (_put(first=np.array([0, 3, 10**6], np.int32)), "first steps of its episodes are not in"),
        (_put(task=np.array([-1, 0], np.int32)), "'task' has a number that is not possible"),
        (_bomb, "no transitions: 'heights' is int16 of shape"),
    ],
)
def test_a_shard_of_others_is_read_exactly_or_refused(tmp_path, folder, forgery, message) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    forgery(copy)
    with pytest.raises(TransitionsError, match=message):
        list(read_transitions(copy))


@pytest.mark.parametrize(
    ("name", "value"),
    [("shape", 10**6), ("rotation", 24), ("location", 25), ("scale", 0), ("reward", np.nan)],
)
def test_numbers_of_a_step_that_are_not_possible_are_refused(tmp_path, folder, name, value) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    (shard, *_) = read_transitions(copy)
    changed = getattr(shard, name).copy()
    changed.flat[-1] = value
    _put(**{name: changed})(copy)
    with pytest.raises(TransitionsError, match=f"000000.npz: .*{name}"):
        list(read_transitions(copy))


def test_more_than_a_bound_of_memory_is_refused(tmp_path, tasks, folder, monkeypatch) -> None:
    monkeypatch.setattr("packit_sim.game.evaluation.transition_files.MAX_BYTES", 10**6)
    with pytest.raises(TransitionsError, match=r"would take .* bytes: at most"):
        list(read_transitions(folder))
    with pytest.raises(ArgumentError, match=r"episodes 2 .*1 to 0 of these tasks"):
        record(tmp_path, tasks, 1)
    assert not any(tmp_path.iterdir())


def test_files_of_others_are_not_replaced(tmp_path, tasks, folder) -> None:
    (tmp_path / "000001.npz").write_text("mine")
    with pytest.raises(
        ArgumentError, match=r"000001.npz exists, and this command did not write it"
    ):
        record(tmp_path, tasks, 2)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["mine"]
    copy = shutil.copytree(folder, tmp_path / "copy")
    (copy / "000000.npz").write_text("mine")
    with pytest.raises(TransitionsError, match=r"000000.npz is not the file that the manifest"):
        record(copy, tasks, 2)
    assert (copy / "000000.npz").read_text() == "mine"


def test_a_shard_that_is_missing_is_recorded_again(tmp_path, tasks, folder) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    (copy / "000000.npz").unlink()
    assert record(copy, tasks, 2) == TransitionsManifest.read(folder)
    assert len(list(read_transitions(copy))) == 2


@pytest.mark.slow
def test_a_kill_at_any_rename_leaves_what_is_recorded_and_is_resumed(
    tmp_path, tasks, folder, monkeypatch
) -> None:
    rename, whole = os.replace, {file.name: file.read_bytes() for file in folder.iterdir()}
    for renames in range(5):  # the manifest, and twice a shard and the manifest
        left, own = iter(range(renames)), tmp_path / str(renames)

        def until(*files: Path, left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise KeyboardInterrupt
            rename(*files)

        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", until)
            with pytest.raises(KeyboardInterrupt):
                record(own, tasks, 2)
        if renames:
            assert len(list(read_transitions(own))) == (renames - 1) // 2
        record(own, tasks, 2)
        assert {file.name: file.read_bytes() for file in own.iterdir()} == whole


def test_the_command_records_transitions(tmp_path) -> None:
    out = tmp_path / "recorded"
    options = "--transitions", "--shards", 1, "--episodes", 1, "--workers", 1
    printed = packit("record", "starter", *options, "--out", out)
    (shard,) = read_transitions(out)
    assert f"wrote {out}: {len(shard)} steps" in printed


def test_the_command_records_for_minari(tmp_path) -> None:
    minari = pytest.importorskip("minari")
    agent = "largest-first/aligned/blbf"
    packit("record", "starter", "--agent", agent, "--out", tmp_path / "played")
    assert minari.MinariDataset(tmp_path / "played").total_episodes == 10
