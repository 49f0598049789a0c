"""A Ray cluster on this machine generates the same packs, even if it loses machines."""

import gc
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from trimesh import creation

from packit_sim import BoxContainer, ItemType, NestSettings, nest
from packit_sim.core import parallel
from packit_sim.core.errors import LibraryError
from packit_sim.core.parallel import Workers, WorkersError
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.generation import jobs
from packit_sim.game.generation.jobs import GenerationJob, generate, under_way
from packit_sim.libraries.library import ShapeLibrary

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    # Ray leaves sockets and the processes of removed nodes to the garbage collector
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

SETTINGS = EvolutionSettings(
    pool=20, population=24, elite=6, lucky=6, generations=40, size_range=(0.65, 0.8)
)
"""A pack takes some seconds."""


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A head that does no work."""
    ray = pytest.importorskip("ray", reason="the extra `cluster` is not installed")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    from ray.cluster_utils import Cluster

    started = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    yield started
    ray.shutdown()
    started.shutdown()
    gc.collect()  # so that warnings about what Ray leaves appear here, not in another test


@pytest.fixture(scope="module")
def order() -> GenerationJob:
    return GenerationJob(
        ShapeLibrary.open("everyday").split("train"), 6, 90, "train", settings=SETTINGS
    )


@pytest.fixture(scope="module")
def local(order, tmp_path_factory) -> Path:
    """The file of a run in this process."""
    file = tmp_path_factory.mktemp("local") / "train.jsonl"
    generate(order, file)
    return file


@pytest.fixture
def begun(tmp_path, monkeypatch) -> Path:
    """Where a line is added for each evolution that begins: number, generation, node."""
    file = tmp_path / "begun.jsonl"
    evolve = jobs.evolve_pack

    def logged(*job):  # a nested function, so that it travels by value
        import json

        from packit_sim.game.generation import jobs

        _, _, folder, number, _ = job
        jobs.CHECKPOINT_SECONDS = 0.0
        state = jobs.read_state(jobs.checkpoint(folder, number), jobs.EvolutionState)
        line = number, len(state.densities) if state else 0, node()
        with file.open("a") as log:
            log.write(json.dumps(line) + "\n")
        return evolve(*job)

    def node() -> str:
        import ray

        return ray.get_runtime_context().get_node_id()

    monkeypatch.setattr(jobs, "evolve_pack", logged)
    return file


def in_the_middle(file: Path) -> list[int]:
    """Numbers of the packs that are still in progress."""
    return [at.number for at in under_way(file) if 3 <= at.generation < 20]


def lines(file: Path) -> list[list[Any]]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def wait_for(holds, seconds: float = 120.0) -> None:
    until = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.05)


def check(file: Path, local: Path, arrived: list[tuple[int, Pack]], packs: int = 6) -> None:
    """Each pack is there once, and equal to the local run's."""
    assert sorted(number for number, _ in arrived) == list(range(packs))
    for suffix in (".jsonl", ".jsonl.manifest.json"):
        assert file.with_suffix(suffix).read_bytes() == local.with_suffix(suffix).read_bytes()
    assert not jobs.work_folder(file).exists()


def test_a_node_dies_halfway(cluster, order, local, begun, tmp_path) -> None:
    nodes = {node.node_id: node for node in (cluster.add_node(num_cpus=1) for _ in range(2))}
    file = tmp_path / "train.jsonl"
    arrived, lost = [], []

    def on_pack(number: int, pack: Pack) -> None:
        arrived.append((number, pack))
        if len(arrived) == 3:
            wait_for(lambda: in_the_middle(file))
            at = in_the_middle(file)[0]
            where = next(node for n, _, node in lines(begun) if n == at)
            cluster.remove_node(nodes[where], allow_graceful=False)
            lost.append((at, where))

    with Workers(2, "ray", cluster.address) as workers:
        generate(order, file, workers, on_pack)
    check(file, local, arrived)
    ((number, where),) = lost
    first, *_, again = [line for line in lines(begun) if line[0] == number]
    assert first[2] == where != again[2]
    assert first[1] == 0 and again[1] > 3  # it went on from its checkpoint


def test_where_no_node_is_left_the_packs_wait_for_one(
    cluster, order, local, begun, tmp_path
) -> None:
    import ray

    node = cluster.add_node(num_cpus=1)
    file = tmp_path / "train.jsonl"
    arrived = []

    def on_pack(number: int, pack: Pack) -> None:
        arrived.append((number, pack))
        if len(arrived) == 1:
            cluster.remove_node(node, allow_graceful=False)
            wait_for(lambda: "CPU" not in ray.cluster_resources())
            time.sleep(3)
            cluster.add_node(num_cpus=2)

    with Workers(0, "ray", cluster.address) as workers:
        assert workers.count == 1
        generate(order, file, workers, on_pack)
    check(file, local, arrived)
    assert len({node for _, _, node in lines(begun)}) == 2


def test_a_single_worker_is_on_the_cluster(cluster) -> None:
    cluster.add_node(num_cpus=1)
    with Workers(1, "ray", cluster.address) as workers:
        numbers = [(n,) for n in range(5)]
        assert workers.map(abs, numbers) == sorted(workers.as_done(abs, numbers)) == [*range(5)]
        assert os.getpid() not in workers.map(lambda _: os.getpid(), numbers)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "nowhere"])
def test_where_no_cluster_is_there_is_none_to_join(address) -> None:
    pytest.importorskip("ray", reason="the extra `cluster` is not installed")
    with pytest.raises(WorkersError, match=f"there is no Ray cluster at '{address}'"):
        Workers(backend="ray", address=address)


def test_errors_arrive_and_say_where_they_are_from(cluster, monkeypatch) -> None:
    cluster.add_node(num_cpus=1)
    monkeypatch.setattr(parallel, "MAX_RETRIES", 1)

    def fail(error: Exception | None) -> None:
        if error is None:
            os._exit(1)
        raise error

    with Workers(1, "ray", cluster.address) as workers:
        for error, message in (
            (LibraryError("no library"), f"{os.uname().nodename}: no library"),
            (ImportError("no module"), f"{os.uname().nodename}: no module"),
            (None, "the cluster gave up a job: The worker died"),
        ):
            with pytest.raises(WorkersError, match=message):
                workers.map(fail, [(error,)])
        with pytest.raises(AssertionError, match="ours"):
            list(workers.as_done(fail, [(AssertionError("ours"),)]))
        monkeypatch.setattr(parallel, "__version__", "0.0.0")
        with pytest.raises(
            WorkersError, match=r"PackIt-Sim has version \d+\.\d+\.\d+ here, not 0\.0\.0"
        ):
            workers.map(fail, [(None,)])


def test_a_search_resumes_with_what_came_back_from_the_cluster(cluster) -> None:
    """Its jobs change arrays that they got, round after round."""
    cluster.add_node(num_cpus=2)
    box = creation.box((1, 0.8, 0.6))
    items = [ItemType("box", box.vertices, box.faces, demand=9)]
    settings = NestSettings(workers=2, iterations=250)
    strip = BoxContainer((2, 2, math.inf))
    here = nest(items, strip, settings=settings)
    there = nest(items, strip, settings=replace(settings, backend="ray", address=cluster.address))
    assert there.problems() == [] and there.height == here.height


def test_the_command_is_stopped_and_resumes(cluster, order, tmp_path) -> None:
    cluster.add_node(num_cpus=2)
    settings = EvolutionSettings(pool=20, population=60, generations=20, size_range=(0.65, 0.8))
    generate(replace(order, packs=3, settings=settings), tmp_path / "local" / "train.jsonl")
    file = tmp_path / "cluster" / "train.jsonl"
    command = [
        *(sys.executable, "-m", "packit_sim", "generate", "--out", str(file.parent)),
        *("--packs", "3", "--split", "train", "--seed", "90", "--pool", "20"),
        *("--population", "60", "--generations", "20", "--size-range", "0.65", "0.8"),
        *("--backend", "ray", "--address", cluster.address),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        wait_for(lambda: under_way(file) or file.exists())
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 130 and "repeat the command to resume" in output
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200).stdout
    assert "".join(output.split()).endswith("train.jsonl:3packs")
    assert file.read_bytes() == (tmp_path / "local" / "train.jsonl").read_bytes()


def test_a_training_over_the_cluster_learns_the_same(cluster, tmp_path, monkeypatch) -> None:
    pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")
    import torch

    from packit_agents.learning.networks import NetworkSettings
    from packit_agents.learning.training import Training
    from packit_agents.learning.training_settings import TrainingSettings
    from packit_agents.learning.weights import read_weights

    settings = TrainingSettings(
        network=NetworkSettings(width=16, encoder_blocks=1, trunk_blocks=1),
        packs="starter",
        split=None,
        validation=None,
        teacher="largest-fitting-first/aligned/blbf",
        imitation=48,
        steps=96,
        envs=3,
        rollout_steps=16,
        validate_every=48,
        minibatch=16,
        validation_tasks=2,
    )
    here = Training(settings, tmp_path / "here", "cpu")
    here.run()
    for _ in range(2):
        cluster.add_node(num_cpus=1)
    cluster.connect()
    there = Training(settings, tmp_path / "there", "cpu", workers=2, address=cluster.address)
    there.run()
    assert there.curve == here.curve
    with monkeypatch.context() as changed:
        changed.setattr(parallel, "START_SECONDS", 5.0)
        with pytest.raises(WorkersError, match="2 of 2 processes did not begin in 5 s"):
            Training(settings, tmp_path / "other", "cpu", workers=2, address=cluster.address)
    there.close()
    again = Training(settings, tmp_path / "there", "cpu", workers=2, address=cluster.address)
    assert again.is_over and again.curve == here.curve
    again.close()
    files = [tmp_path / name / "last.safetensors" for name in ("here", "there")]
    weights = [dict(read_weights(file)[0].state_dict()) for file in files]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
