"""Generation: resumable at any moment with little loss, and with the same packs."""

import errno
import os
import pickle
import random
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import trimesh
from msgspec import structs

import packit_sim.libraries.library
from packit_sim.core import typed_json
from packit_sim.core.errors import BusyError, LibraryError
from packit_sim.core.extras import MissingPackageError
from packit_sim.core.parallel import Workers, WorkersError
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import load_tasks, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.generation import jobs
from packit_sim.game.generation.jobs import (
    GenerationError,
    GenerationJob,
    checkpoint,
    generate,
    work_folder,
)
from packit_sim.libraries.library import ShapeLibrary

SMALL = EvolutionSettings(
    pool=8, population=8, elite=2, lucky=2, generations=6, keep_every=2, size_range=(0.6, 0.8)
)


@pytest.fixture(scope="module")
def library() -> ShapeLibrary:
    return ShapeLibrary.open("everyday").split("train")


@pytest.fixture(scope="module")
def undisturbed(library, tmp_path_factory) -> list[Pack]:
    return generate(
        GenerationJob(library, 3, 40, "train", settings=SMALL),
        tmp_path_factory.mktemp("g") / "train.jsonl",
    )


def order(library: ShapeLibrary, packs: int = 3, **changes: object) -> GenerationJob:
    return GenerationJob(
        library, packs, **{"seed": 40, "split": "train", "settings": SMALL, **changes}
    )


@pytest.mark.slow
def test_a_dataset_has_its_packs_by_seed_and_nothing_else_is_left(
    library, undisturbed, tmp_path
) -> None:
    seen = []
    with Workers(2) as workers:
        generated = generate(
            order(library),
            tmp_path / "train.jsonl",
            workers,
            lambda *reported: seen.append(reported),
        )
    assert generated == undisturbed == read_packs(tmp_path / "train.jsonl")
    assert [pack.provenance.seed for pack in generated] == [40, 41, 42]
    assert sorted(number for number, _ in seen) == [0, 1, 2]
    assert all(verify(pack, library) == [] for pack in generated)
    assert {item.shape for pack in generated for item in pack.items} <= set(library.ids)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["train.jsonl", "train.jsonl.manifest.json"]
    tasks = load_tasks(tmp_path, ShapeLibrary.open("everyday"), "train")
    assert [task.pack for task in tasks] == generated


def test_more_packs_are_added_to_those_there_are(library, undisturbed, tmp_path) -> None:
    file = tmp_path / "train.jsonl"
    assert generate(order(library, 1), file) == undisturbed[:1]
    fresh = []
    assert generate(order(library, 3), file, None, lambda n, _: fresh.append(n)) == undisturbed
    assert fresh == [1, 2]


def test_the_way_can_be_kept(library, tmp_path) -> None:
    packs = generate(order(library, 2, history=True), tmp_path / "train.jsonl")
    assert [(pack.provenance.seed, pack.provenance.after) for pack in packs] == [
        (seed, after) for seed in (40, 41) for after in (0, 2, 4, 6)
    ]
    assert all(pack.provenance.generation <= pack.provenance.after for pack in packs)
    with pytest.raises(GenerationError, match="other settings"):
        generate(order(library, 2), tmp_path / "train.jsonl")


SCRIPT = """
import sys
from dataclasses import replace
from pathlib import Path
from packit_sim.game.generation import jobs
from packit_sim.libraries.library import ShapeLibrary
from tests.test_generation import SMALL, order
jobs.CHECKPOINT_SECONDS = 0.0
print("ready", flush=True)
jobs.generate(order(ShapeLibrary.open("everyday").split("train")), Path(sys.argv[1]))
"""


def killed_until_done(file: Path, moments: list[float]) -> int:
    """Runs the generator, kills it after so many seconds of work, and again; at last lets it end.

    Returns how often it was killed at work.
    """
    kills = 0
    for moment in [*moments, None]:
        with subprocess.Popen(
            [sys.executable, "-c", SCRIPT, str(file)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout and process.stdout.readline() == "ready\n"
            try:
                process.wait(timeout=moment or 200)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                kills += 1
        assert process.returncode in (0, -signal.SIGKILL)
    return kills


@pytest.mark.slow
def test_a_killed_generator_resumes_and_ends_in_the_same_packs(undisturbed, tmp_path) -> None:
    file = tmp_path / "train.jsonl"
    assert killed_until_done(file, [0.3, 0.9]) == 2
    assert read_packs(file) == undisturbed
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "train.jsonl",
        "train.jsonl.manifest.json",
    ]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(20))
def test_killed_at_any_moment(undisturbed, tmp_path, seed) -> None:
    file = tmp_path / "train.jsonl"
    draw = random.Random(seed)
    assert killed_until_done(file, [draw.uniform(0, 0.9) for _ in range(3)]) >= 1
    assert read_packs(file) == undisturbed


def test_a_kill_loses_the_work_since_the_last_checkpoint_alone(
    library, tmp_path, monkeypatch
) -> None:
    assert jobs.CHECKPOINT_SECONDS <= 10
    monkeypatch.setattr(jobs, "CHECKPOINT_SECONDS", 0.0)
    file = tmp_path / "train.jsonl"
    steps = []
    step = jobs.Evolution.step

    def counted(evolution, workers=None):
        if len(steps) == 4:
            raise KeyboardInterrupt
        steps.append(evolution.seed)
        return step(evolution, workers)

    monkeypatch.setattr(jobs.Evolution, "step", counted)
    with pytest.raises(KeyboardInterrupt):
        generate(order(library), file)
    assert [p.generation for p in jobs.under_way(file)] == [3]
    steps[:] = [None] * 5
    generate(order(library, 1), file)
    assert steps[5:] == [40] * 3


def test_two_generators_refuse_each_other(library, tmp_path) -> None:
    file = tmp_path / "train.jsonl"

    def second(number: int, pack: Pack) -> None:
        with pytest.raises(BusyError, match=f"process {os.getpid()} is at work there"):
            generate(order(library), file)

    generate(order(library, 1), file, None, second)


def test_a_full_disk_stops_it_and_loses_nothing(
    library, undisturbed, tmp_path, monkeypatch
) -> None:
    file = tmp_path / "train.jsonl"
    generate(order(library, 1), file)
    written = []

    def full(handle: int) -> None:
        written.append(handle)
        if len(written) > 2:
            raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            generate(order(library), file)
    assert read_packs(file)[:1] == undisturbed[:1]
    assert generate(order(library), file) == undisturbed
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "train.jsonl",
        "train.jsonl.manifest.json",
    ]


def test_a_damaged_checkpoint_begins_its_pack_anew(library, undisturbed, tmp_path, caplog) -> None:
    file = tmp_path / "train.jsonl"
    folder = work_folder(file)
    folder.mkdir()
    checkpoint(folder, 0).write_text('{"seed": 40, "setti')
    checkpoint(folder, 1).write_bytes(b"\0" * 100)
    assert generate(order(library), file) == undisturbed
    assert "00001.json is damaged: pack 1 starts again" in caplog.text


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": 41}, "seed was 40, now 41"),
        ({"split": None}, "split was 'train', now None"),
        ({"history": True}, "history was False"),
        ({"settings": EvolutionSettings(pool=9)}, "settings was"),
    ],
)
def test_a_different_job_does_not_resume(library, tmp_path, changes, named) -> None:
    file = tmp_path / "train.jsonl"
    folder = work_folder(file)
    folder.mkdir()
    (folder / "job.json").write_text(typed_json.encode(order(library).record))
    with pytest.raises(GenerationError, match=named):
        generate(order(library, **changes), file)


def test_a_machine_without_our_folder_keeps_no_checkpoints(
    library, undisturbed, tmp_path, monkeypatch
) -> None:
    """That of a cluster without a shared folder: the path may hold nothing, or another's files."""
    monkeypatch.setattr(jobs, "CHECKPOINT_SECONDS", 0.0)
    wanted = order(library)
    anothers = tmp_path / "anothers"
    anothers.mkdir()
    other = structs.replace(wanted.record, seed=7)
    (anothers / "job.json").write_text(typed_json.encode(other))
    checkpoint(anothers, 1).write_text("{}")
    for folder in (tmp_path / "no" / "such" / "folder", anothers, Path("/proc/no/folder")):
        generated = jobs.evolve_pack(wanted, wanted.record, folder, 1, os.getpid())
        assert generated == (1, undisturbed[1:2])
    assert checkpoint(anothers, 1).read_text() == "{}"
    assert [path.name for path in tmp_path.iterdir()] == ["anothers"]


def test_a_machine_with_another_library_makes_no_packs(library, tmp_path) -> None:
    known = order(library).record
    foreign = replace(known.library, digest="0123456789abcdef")
    wanted = structs.replace(known, library=foreign)
    with pytest.raises(GenerationError, match="should be 0123456789ab"):
        jobs.evolve_pack(order(library), wanted, tmp_path, 0, os.getpid())


def test_a_library_that_travels_is_found_wherever_it_is_installed(
    library, tmp_path, monkeypatch
) -> None:
    travelling = pickle.dumps(library)
    (tmp_path / "everyday").symlink_to(library.path)
    monkeypatch.setattr(packit_sim.libraries.library, "assets_folder", lambda: tmp_path)
    arrived = pickle.loads(travelling)
    assert arrived.path == tmp_path / "everyday" and arrived.ids == library.ids
    assert len(pickle.dumps(order(arrived))) < 1000


def test_a_library_at_a_path_travels_with_all_of_the_path(tmp_path, monkeypatch) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    trimesh.creation.box().export(folder / "box.stl")
    monkeypatch.chdir(tmp_path)
    travelling = pickle.dumps(ShapeLibrary.open("folder:mine"))
    monkeypatch.chdir("/")
    assert pickle.loads(travelling).ids == ("box",)
    folder.rename(tmp_path / "gone")
    with pytest.raises(LibraryError, match=f"no shape library 'folder:{folder}'"):
        pickle.loads(travelling)


def test_a_killed_worker_is_reported_in_a_line() -> None:
    with Workers(2) as workers:
        for ask in (workers.map, lambda *jobs: list(workers.as_done(*jobs))):
            with pytest.raises(WorkersError, match="repeat the command to resume"):
                ask(os._exit, [(1,), (1,)])


def test_without_ray_it_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'packit-sim\[cluster\]'"):
        Workers(backend="ray")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"backend": "threads"}, "choose from loky, ray"),
        ({"count": -1}, "choose 1 or more"),
        ({"address": "10.0.0.1:6379"}, "needs the backend ray"),
    ],
)
def test_workers_that_cannot_be_are_refused(settings, message) -> None:
    with pytest.raises(WorkersError, match=message):
        Workers(**settings)
