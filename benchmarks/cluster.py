"""What a Ray cluster costs beside this machine's own processes, and what the paper's packs would.

    .venv/bin/python -m benchmarks.cluster    (about five minutes on 2 cores)

A head that does no work and a machine of two cores, both of them here. Measured are starting it,
the way of a pack there and back, and packs a second on one worker and on two. The estimate is of
the paper's 2,009 packs; give what a pack takes (--seconds-a-pack), or how many generations, and a
few are packed to see. Prints tables, and writes `benchmarks/results/cluster.json`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pickle
import platform
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

from packit_sim import EvolutionSettings, ShapeLibrary
from packit_sim.core import caches
from packit_sim.core.parallel import Workers
from packit_sim.datasets.pack_files import STARTER_PACKS, dataset_file, read_packs
from packit_sim.datasets.packs import Pack
from packit_sim.generation import jobs
from packit_sim.generation.evolution import Evolution
from packit_sim.generation.jobs import GenerationJob

RESULTS = Path(__file__).parent / "results"

PAPERS_PACKS = 2009

CORES = (1, 8, 64)
"""Of the estimate."""

ROUND_TRIPS = 50

Job = tuple[GenerationJob, jobs.JobRecord, Path, int, int]
"""What `generation` sends to a worker."""


def nothing(number: int) -> int:
    return number


def there_and_back(job: Job, packs: list[Pack]) -> tuple[int, list[Pack]]:
    """A job that opens its library and sends packs, but makes none."""
    return job[3], packs


def one_pack(*job: Any) -> tuple[float, float, int]:
    """Makes a pack: seconds, those of the processor, and peak memory of the process in bytes."""
    caches.clear()
    started, cpu = time.perf_counter(), time.process_time()
    jobs._evolve(*job)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return time.perf_counter() - started, time.process_time() - cpu, peak


def generations_of_one(library: ShapeLibrary, seed: int, generations: int) -> list[float]:
    """Seconds of the processor that each generation takes, the first one first."""
    caches.clear()
    settings = EvolutionSettings(generations=generations, patience=generations + 1)
    evolution = Evolution(library, seed, settings)
    found = []
    while not evolution.is_over:
        started = time.process_time()
        evolution.step()
        found.append(time.process_time() - started)
    return found


def jobs_of(order: GenerationJob) -> list[Job]:
    """As `generation` sends them, but for a folder of checkpoints."""
    return [(order, order.record, Path("/none"), n, 0) for n in range(order.packs)]


def round_trips(workers: Workers, job: Job, packs: list[Pack]) -> dict[str, dict[str, float]]:
    """Milliseconds of jobs one by one: those that do nothing, and those that carry a pack."""
    times: dict[str, list[float]] = {"nothing": [], "a pack's job and result": []}
    for n in range(ROUND_TRIPS):
        for name, function, arguments in (
            ("nothing", nothing, (n,)),
            ("a pack's job and result", there_and_back, (job, packs)),
        ):
            started = time.perf_counter()
            workers.map(function, [arguments])
            times[name].append((time.perf_counter() - started) * 1000)
    return {name: summary(values) for name, values in times.items()}


def packing(workers: Workers, order: GenerationJob) -> dict[str, float]:
    """Packs a second, and of each pack what the workers did not spend on making it."""
    started = time.perf_counter()
    rows = list(workers.as_done(one_pack, jobs_of(order)))
    whole = time.perf_counter() - started
    seconds, cpu, peaks = zip(*rows, strict=True)
    return {
        "packs/s": len(rows) / whole,
        "seconds a pack": fmean(seconds),
        "CPU seconds a pack": fmean(cpu),
        "idle seconds a pack": workers.count * whole / len(rows) - fmean(seconds),
        "peak bytes of a process": max(peaks),
    }


def measured(
    backend: Any, address: str | None, order: GenerationJob, packs: list[Pack]
) -> dict[str, Any]:
    """Joining, first jobs, round trips, and packing with one worker and with two.

    speedup: of packs a second; where other work runs beside it, it tells of that. efficiency: by
    processor seconds a pack, which tell only what two of them cost each other.
    """
    found: dict[str, Any] = {}
    for count in (1, 2):
        started = time.perf_counter()
        # loky's single worker is this process: a cluster's is not, nor one of two
        with Workers(count, backend, address) as workers:
            joined = time.perf_counter()
            list(workers.as_done(nothing, [(n,) for n in range(count)]))
            begun = time.perf_counter()
            list(workers.as_done(one_pack, jobs_of(order)[:count]))  # loads all that is loaded once
            if count == 2:
                found["joining, seconds"] = joined - started
                found["first jobs, seconds"] = begun - joined
                found["round trips, ms"] = round_trips(workers, jobs_of(order)[0], packs)
            found[("one worker", "two workers")[count - 1]] = packing(workers, order)
    one, two = found["one worker"], found["two workers"]
    found["speedup"] = two["packs/s"] / one["packs/s"]
    found["efficiency"] = one["CPU seconds a pack"] / two["CPU seconds a pack"]
    return found


def noticing(cluster: Cluster, machine: Any) -> float:
    """Seconds until a cluster knows that a machine is gone."""
    with Workers(1, "ray", cluster.address):
        cluster.remove_node(machine, allow_graceful=False)
        started = time.perf_counter()
        while "CPU" in ray.cluster_resources():
            time.sleep(0.1)
        return time.perf_counter() - started


def estimate(
    packs: int, cores: int, seconds: float, overhead: float, efficiency: float
) -> dict[str, float]:
    """Hours for so many packs of so many seconds each, and what sending one takes.

    The packs all take the same, and the cores are as fast as the one that was measured.
    """
    rounds = math.ceil(packs / cores)
    hours = rounds * (seconds / (efficiency if cores > 1 else 1) + overhead) / 3600
    return {"cores": cores, "hours": hours, "core hours": hours * cores}


def summary(values: list[float]) -> dict[str, float]:
    low, median, high = np.percentile(values, (10, 50, 90)).tolist()
    return {"p10": low, "median": median, "p90": high, "n": len(values)}


def show(console: Console, result: dict[str, Any]) -> None:
    table = Table("", "processes here", "Ray cluster", title="What a cluster costs")
    local, there = result["loky"], result["ray"]
    for name in ("starting a cluster, seconds", "noticing a loss, seconds"):
        table.add_row(name, "", f"{result[name]:.1f}")
    for name in ("joining, seconds", "first jobs, seconds"):
        table.add_row(name, f"{local[name]:.2f}", f"{there[name]:.2f}")
    for name in local["round trips, ms"]:
        both = (each["round trips, ms"][name] for each in (local, there))
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
            row = (format(each[count][name], spec) for each in (local, there))
            table.add_row(f"{name}, {count}", *row)
    for name in ("speedup", "efficiency"):
        table.add_row(f"{name} of two workers", *(f"{each[name]:.2f}" for each in (local, there)))
    console.print(table)
    sizes, peak = result["bytes"], there["two workers"]["peak bytes of a process"]
    console.print(f"a pack: {sizes['job']:,} bytes there, {sizes['result']:,} back")
    console.print(f"peak memory of a worker: {peak / 2**20:,.0f} MiB")
    costs = Table("cores", "hours", "core hours", title=f"{result['packs']:,} packs")
    for row in result["estimate"]:
        costs.add_row(f"{row['cores']}", f"{row['hours']:,.1f}", f"{row['core hours']:,.0f}")
    console.print(costs)
    console.print(
        f"{result['seconds a pack']:,.0f} s a pack ({result['seconds a pack are']}) and "
        f"{1000 * result['overhead a pack, seconds']:.0f} ms for its way, "
        f"efficiency {result['efficiency']:.2f} on more than one core"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packs", type=int, default=6, help="to measure with")
    parser.add_argument("--steps", type=int, default=10, help="generations to measure with")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--generations", type=float, default=1000, help="that a pack takes (mean)")
    parser.add_argument("--seconds-a-pack", type=float, help="on one core, if known")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    settings = EvolutionSettings(generations=arguments.steps, patience=arguments.steps + 1)
    order = GenerationJob(library, arguments.packs, arguments.seed, settings=settings)
    packs = read_packs(dataset_file(STARTER_PACKS, None))

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    started = time.perf_counter()
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    machine = cluster.add_node(num_cpus=2)
    result: dict[str, Any] = {
        "command": "python -m benchmarks.cluster",
        "seed": arguments.seed,
        "settings": settings.to_json(),
        "packs measured": arguments.packs,
        "library": library.digest,
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
        "versions": {name: version(name) for name in ("joblib", "numpy", "ray")},
        "starting a cluster, seconds": time.perf_counter() - started,
        "bytes": {
            "job": len(pickle.dumps(jobs_of(order)[0])),
            "result": int(np.median([len(pickle.dumps((0, [pack]))) for pack in packs])),
        },
        "loky": measured("loky", None, order, packs[:1]),
        "ray": measured("ray", cluster.address, order, packs[:1]),
    }
    result["noticing a loss, seconds"] = noticing(cluster, machine)
    cluster.shutdown()

    seconds, source = arguments.seconds_a_pack, "given"
    if seconds is None:
        with Workers(2) as workers:
            runs = [(library, arguments.seed + n, 2 * arguments.steps) for n in range(4)]
            rows = np.array(list(workers.as_done(generations_of_one, runs)))  # (packs, generations)
        later = rows[:, arguments.steps :].mean()
        seconds = rows.mean(0).sum() + later * (arguments.generations - 2 * arguments.steps)
        source = f"{later:.3f} s for each of {arguments.generations:g} generations"
    way = result["ray"]["round trips, ms"]["a pack's job and result"]["median"] / 1000
    efficiency = min(1.0, result["ray"]["efficiency"])
    result |= {
        "packs": PAPERS_PACKS,
        "seconds a pack": float(seconds),
        "seconds a pack are": source,
        "overhead a pack, seconds": way,
        "efficiency": efficiency,
        "estimate": [
            estimate(PAPERS_PACKS, cores, float(seconds), way, efficiency) for cores in CORES
        ],
    }
    show(Console(width=100), result)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "cluster.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
