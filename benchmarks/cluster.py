"""Compare a Ray cluster with local processes, and estimate the time of the paper's 2,009 packs.

    .venv/bin/python -m benchmarks.cluster    (about five minutes on 2 cores)

The cluster is a head without work and a machine of two cores, both on this computer. The benchmark
measures its start, the round trip of a pack, and packs per second with one worker and with two. The
estimate uses the time of a pack (--seconds-a-pack); by default it is measured for the given number
of generations. Prints tables, and writes `benchmarks/results/cluster.json`.
"""

from __future__ import annotations

import math
import os
import pickle
import resource
import time
from importlib.metadata import version
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import ray
from ray.cluster_utils import Cluster
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, summary, write_json
from packit_sim import EvolutionSettings, ShapeLibrary
from packit_sim.core import caches
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.builtin import STARTER_PACKS
from packit_sim.game.datasets.pack_files import dataset_file, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.generation import jobs
from packit_sim.game.generation.evolution import Evolution
from packit_sim.game.generation.jobs import GenerationJob

PAPERS_PACKS = 2009

CORES = (1, 8, 64)
"""Numbers of cores in the estimate."""

ROUND_TRIPS = 50

Job = tuple[GenerationJob, jobs.JobRecord, Path, int, int]
"""The arguments that `generation` sends to a worker."""


def no_work(number: int) -> int:
    return number


def send_back(job: Job, packs: list[Pack]) -> tuple[int, list[Pack]]:
    """Open the job's library and return packs, without creating any."""
    return job[3], packs


def one_pack(*job: Any) -> tuple[float, float, int]:
    """Create a pack; return wall seconds, CPU seconds and the process's peak memory in bytes."""
    caches.clear()
    started, cpu = time.perf_counter(), time.process_time()
    jobs.evolve_pack(*job)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return time.perf_counter() - started, time.process_time() - cpu, peak


def generations_of_one(library: ShapeLibrary, seed: int, generations: int) -> list[float]:
    """Measure the CPU seconds of each generation."""
    caches.clear()
    settings = EvolutionSettings(generations=generations, patience=generations + 1)
    evolution = Evolution(library, seed, settings)
    found = []
    while not evolution.is_over:
        started = time.process_time()
        evolution.step()
        found.append(time.process_time() - started)
    return found


def worker_jobs(job: GenerationJob) -> list[Job]:
    """Create the jobs that `generation` sends, without a folder of checkpoints."""
    return [(job, job.record, Path("/none"), n, 0) for n in range(job.packs)]


def round_trips(workers: Workers, job: Job, packs: list[Pack]) -> dict[str, dict[str, float]]:
    """Measure milliseconds of single jobs: without work, and with a pack as result."""
    times: dict[str, list[float]] = {"nothing": [], "a pack's job and result": []}
    for n in range(ROUND_TRIPS):
        for name, function, arguments in (
            ("nothing", no_work, (n,)),
            ("a pack's job and result", send_back, (job, packs)),
        ):
            started = time.perf_counter()
            workers.map(function, [arguments])
            times[name].append((time.perf_counter() - started) * 1000)
    return {name: summary(values) for name, values in times.items()}


def pack_rate(workers: Workers, job: GenerationJob) -> dict[str, float]:
    """Measure packs per second, and the time that workers are idle for each pack."""
    started = time.perf_counter()
    rows = list(workers.as_done(one_pack, worker_jobs(job)))
    whole = time.perf_counter() - started
    seconds, cpu, peaks = zip(*rows, strict=True)
    return {
        "packs/s": len(rows) / whole,
        "seconds a pack": fmean(seconds),
        "CPU seconds a pack": fmean(cpu),
        "idle seconds a pack": workers.count * whole / len(rows) - fmean(seconds),
        "peak bytes of a process": max(peaks),
    }


def measure(
    backend: Any, address: str | None, job: GenerationJob, packs: list[Pack]
) -> dict[str, Any]:
    """Measure joining, first jobs, round trips, and packing with one worker and with two.

    The speedup is of packs per second, which other work on this computer also changes. The
    efficiency is of CPU seconds per pack, which only shows how the two workers slow each other.
    """
    found: dict[str, Any] = {}
    for count in (1, 2):
        started = time.perf_counter()
        # loky's single worker is this process, unlike a cluster's or one of two
        with Workers(count, backend, address) as workers:
            joined = time.perf_counter()
            list(workers.as_done(no_work, [(n,) for n in range(count)]))
            begun = time.perf_counter()
            list(workers.as_done(one_pack, worker_jobs(job)[:count]))  # loads and compiles
            if count == 2:
                found["joining, seconds"] = joined - started
                found["first jobs, seconds"] = begun - joined
                found["round trips, ms"] = round_trips(workers, worker_jobs(job)[0], packs)
            found[("one worker", "two workers")[count - 1]] = pack_rate(workers, job)
    one, two = found["one worker"], found["two workers"]
    found["speedup"] = two["packs/s"] / one["packs/s"]
    found["efficiency"] = one["CPU seconds a pack"] / two["CPU seconds a pack"]
    return found


def loss_notice_time(cluster: Cluster, node: Any) -> float:
    """Measure the seconds until a cluster notices the loss of a machine."""
    with Workers(1, "ray", cluster.address):
        cluster.remove_node(node, allow_graceful=False)
        started = time.perf_counter()
        while "CPU" in ray.cluster_resources():
            time.sleep(0.1)
        return time.perf_counter() - started


def estimate(
    packs: int, cores: int, seconds: float, overhead: float, efficiency: float
) -> dict[str, float]:
    """Estimate hours and core-hours for a number of packs, given the seconds of one.

    All packs are assumed to take the same time, and all cores to be as fast as the measured one.
    """
    rounds = math.ceil(packs / cores)
    hours = rounds * (seconds / (efficiency if cores > 1 else 1) + overhead) / 3600
    return {"cores": cores, "hours": hours, "core hours": hours * cores}


def show(console: Console, result: dict[str, Any]) -> None:
    table = Table("", "processes here", "Ray cluster", title="Costs of a cluster")
    local, remote = result["loky"], result["ray"]
    for name in ("starting a cluster, seconds", "noticing a loss, seconds"):
        table.add_row(name, "", f"{result[name]:.1f}")
    for name in ("joining, seconds", "first jobs, seconds"):
        table.add_row(name, f"{local[name]:.2f}", f"{remote[name]:.2f}")
    for name in local["round trips, ms"]:
        both = (each["round trips, ms"][name] for each in (local, remote))
        table.add_row(
            f"round trip, ms: {name}",
            *(f"{each['median']:.1f} ({each['p10']:.1f} to {each['p90']:.1f})" for each in both),
        )
    for name, spec in (
        ("packs/s", ".3f"),
        ("CPU seconds a pack", ".2f"),
        ("idle seconds a pack", ".3f"),
    ):
        for count in ("one worker", "two workers"):
            row = (format(each[count][name], spec) for each in (local, remote))
            table.add_row(f"{name}, {count}", *row)
    for name in ("speedup", "efficiency"):
        table.add_row(f"{name} of two workers", *(f"{each[name]:.2f}" for each in (local, remote)))
    console.print(table)
    sizes, peak = result["bytes"], remote["two workers"]["peak bytes of a process"]
    console.print(f"a pack: {sizes['job']:,} bytes sent, {sizes['result']:,} returned")
    console.print(f"peak memory of a worker: {peak / 2**20:,.0f} MiB")
    costs = Table("cores", "hours", "core hours", title=f"{result['packs']:,} packs")
    for row in result["estimate"]:
        costs.add_row(f"{row['cores']}", f"{row['hours']:,.1f}", f"{row['core hours']:,.0f}")
    console.print(costs)
    console.print(
        f"{result['seconds a pack']:,.0f} s a pack ({result['seconds a pack are']}) and "
        f"{1000 * result['overhead a pack, seconds']:.0f} ms for its round trip, "
        f"efficiency {result['efficiency']:.2f} on more than one core"
    )


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--packs", type=int, default=6, help="number of packs to measure with")
    parser.add_argument("--steps", type=int, default=10, help="generations to measure with")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--generations", type=float, default=1000, help="mean number for a pack")
    parser.add_argument("--seconds-a-pack", type=float, help="known time of a pack on one core")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    settings = EvolutionSettings(generations=arguments.steps, patience=arguments.steps + 1)
    job = GenerationJob(library, arguments.packs, arguments.seed, settings=settings)
    packs = read_packs(dataset_file(STARTER_PACKS, None))

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    started = time.perf_counter()
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    node = cluster.add_node(num_cpus=2)
    result: dict[str, Any] = {
        "command": "python -m benchmarks.cluster",
        "seed": arguments.seed,
        "settings": settings.to_json(),
        "packs measured": arguments.packs,
        "library": library.digest,
        "machine": machine(),
        "versions": {name: version(name) for name in ("joblib", "numpy", "ray")},
        "starting a cluster, seconds": time.perf_counter() - started,
        "bytes": {
            "job": len(pickle.dumps(worker_jobs(job)[0])),
            "result": int(np.median([len(pickle.dumps((0, [pack]))) for pack in packs])),
        },
        "loky": measure("loky", None, job, packs[:1]),
        "ray": measure("ray", cluster.address, job, packs[:1]),
    }
    result["noticing a loss, seconds"] = loss_notice_time(cluster, node)
    cluster.shutdown()

    seconds, source = arguments.seconds_a_pack, "given"
    if seconds is None:
        with Workers(2) as workers:
            runs = [(library, arguments.seed + n, 2 * arguments.steps) for n in range(4)]
            rows = np.array(list(workers.as_done(generations_of_one, runs)))  # (packs, generations)
        later = rows[:, arguments.steps :].mean()
        seconds = rows.mean(0).sum() + later * (arguments.generations - 2 * arguments.steps)
        source = f"{later:.3f} s for each of {arguments.generations:g} generations"
    overhead = result["ray"]["round trips, ms"]["a pack's job and result"]["median"] / 1000
    efficiency = min(1.0, result["ray"]["efficiency"])
    result |= {
        "packs": PAPERS_PACKS,
        "seconds a pack": float(seconds),
        "seconds a pack are": source,
        "overhead a pack, seconds": overhead,
        "efficiency": efficiency,
        "estimate": [
            estimate(PAPERS_PACKS, cores, float(seconds), overhead, efficiency) for cores in CORES
        ],
    }
    show(Console(width=100), result)
    write_json(arguments.out / "cluster.json", result)


if __name__ == "__main__":
    main()
