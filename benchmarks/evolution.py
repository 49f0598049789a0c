"""Measure the speed of evolution at the paper's settings, and where its time goes.

    .venv/bin/python -m benchmarks.evolution    (half an hour on two cores)

Pools of the "everyday" library's train split. Every evolution runs through all its generations, so
that one run measures both the cost of 1000 generations and the saving by early stopping. Prints
tables, and writes `benchmarks/results/evolution.json` after each part; --parts measures some parts
again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.accounts import time_shares
from benchmarks.common import argument_parser, machine, write_json
from packit_sim import EvolutionSettings, ShapeLibrary
from packit_sim.core import caches, typed_json
from packit_sim.core.counters import Counters, counters
from packit_sim.core.parallel import Workers
from packit_sim.game.generation.evolution import Evolution

AIM = 5
"""Largest number of minutes for a pack: 1000 generations, a pool of 50, two cores."""

PAPER = EvolutionSettings()

_T = TypeVar("_T")


class Meter(Workers):
    """Workers that count chromosomes, those given up, and the CPU seconds spent on them.

    With `whole`, every chromosome is packed to the end, even if it can't survive.
    """

    def __init__(self, count: int = 1, *, whole: bool = False) -> None:
        super().__init__(count)
        self.whole = whole
        self.chromosomes = self.given_up = 0
        self.cpu = 0.0

    def map(self, function: Callable[..., _T], arguments: Iterable[tuple[Any, ...]]) -> list[_T]:
        """Map batches of an evolution: recipe, chromosomes and threshold."""
        batches = [
            (function, recipe, chromosomes, 0.0 if self.whole else threshold)
            for recipe, chromosomes, threshold in arguments
        ]
        found, seconds = zip(*super().map(_timed, batches), strict=True)
        densities = np.concatenate([np.asarray(batch) for batch in found])
        self.chromosomes += len(densities)
        self.given_up += int((densities == 0).sum())
        self.cpu += sum(seconds)
        return list(found)


def _timed(function: Callable[..., _T], *arguments: Any) -> tuple[_T, float]:
    cpu = time.process_time()
    return function(*arguments), time.process_time() - cpu


def never_stopping(generations: int) -> EvolutionSettings:
    """Create the paper's settings without early stopping, for a number of generations."""
    return EvolutionSettings(generations=generations, patience=generations + 1)


def early_stop(densities: list[float], patience: int) -> int:
    """Find the generation after which early stopping ends an evolution, else the last."""
    improved = 0
    for number, density in enumerate(densities):
        if density > densities[improved]:
            improved = number
        elif number - improved >= patience:
            return number
    return len(densities) - 1


def one_pack(library: ShapeLibrary, seed: int, generations: int, workers: int) -> dict[str, Any]:
    """Measure the evolution of a pack, in this process or with its children on some workers.

    If there are fewer generations than the paper's, each missing one is assumed to take the median
    time of the last quarter.
    """
    caches.clear()
    before, meter = counters(), Meter(workers)
    evolution = Evolution(library, seed, never_stopping(generations))
    seconds: list[float] = []
    with meter:
        while not evolution.is_over:
            started = time.perf_counter()
            evolution.step(meter)
            seconds.append(time.perf_counter() - started)
    stopped = early_stop(evolution.densities, PAPER.patience)
    missing = PAPER.generations - generations
    rest = missing * float(np.median(seconds[-max(generations // 4, 1) :])) if missing > 0 else 0.0
    return {
        "seed": seed,
        "size": evolution.size,
        "items": len(evolution.best.items),
        "density": evolution.best.density,
        "generations": generations,
        "chromosomes": meter.chromosomes,
        "share given up": meter.given_up / meter.chromosomes,
        "seconds": sum(seconds),
        "CPU seconds of chromosomes": meter.cpu,
        "seconds of each 100 generations": np.add.reduceat(
            seconds[1:], np.arange(0, max(generations, 1), 100)
        ).tolist(),
        "seconds for 1000": sum(seconds) + rest,
        "extrapolated": missing > 0,
        "stopped at": stopped,
        "seconds until stopped": sum(seconds[: stopped + 1]),
        "density when stopped": evolution.densities[stopped],
        "counts": counts(counters().since(before)) if workers == 1 else None,
    }


def counts(counted: Counters) -> dict[str, Any]:
    """Summarise the counters of this process: queries, mesh comparisons and hit rates of caches."""
    return {
        "BLBF queries": counted.searches,
        "locations a query": counted.locations / max(counted.searches, 1),
        "open locations a query": counted.undecided / max(counted.searches, 1),
        "mesh comparisons a query": counted.mesh_comparisons_per_query,
        "hit rates": {
            name: use.hits / (use.hits + use.misses)
            for name, use in counted.caches.items()
            if use.hits + use.misses
        },
    }


def lockstep(library: ShapeLibrary, seeds: list[int], generations: int) -> dict[str, Any]:
    """Run the same evolutions on one worker and on two, alternating between generations.

    Generations 0 to 4, which fill the caches, are not timed.
    """
    times: dict[int, list[float]] = {1: [], 2: []}
    chromosomes = PAPER.children
    one, two = Meter(1), Meter(2)
    with one, two:
        for seed in seeds:
            caches.clear()
            pairs = {
                meter.count: (Evolution(library, seed, never_stopping(generations)), meter)
                for meter in (one, two)
            }
            for number in range(generations + 1):
                for count in (1, 2) if number % 2 else (2, 1):
                    evolution, meter = pairs[count]
                    started = time.perf_counter()
                    evolution.step(meter)
                    if number > 4:
                        times[count].append(time.perf_counter() - started)
            assert pairs[1][0].state == pairs[2][0].state
    ratios = np.array(times[1]) / np.array(times[2])
    median = {count: float(np.median(seconds)) for count, seconds in times.items()}
    return {
        "seeds": seeds,
        "generations": generations,
        "generations a second": {count: 1 / seconds for count, seconds in median.items()},
        "chromosomes a second": {count: chromosomes / seconds for count, seconds in median.items()},
        "two workers, times one": {
            "median": float(np.median(ratios)),
            "of the sums": sum(times[1]) / sum(times[2]),
        },
    }


def _giving_up(library: ShapeLibrary, seed: int, generations: int, whole: bool) -> dict[str, Any]:
    """Run an evolution that gives chromosomes up early, or packs all of them whole."""
    caches.clear()
    evolution = Evolution(library, seed, never_stopping(generations))
    meter = Meter(whole=whole)
    while not evolution.is_over:
        evolution.step(meter)
    state = typed_json.builtins(evolution.state)
    state["search"].pop("densities")  # unknown for chromosomes that are given up
    return {
        "CPU seconds": meter.cpu,
        "share given up": meter.given_up / meter.chromosomes,
        "outcome": state,
    }


def giving_up(library: ShapeLibrary, seeds: list[int], generations: int) -> list[dict[str, Any]]:
    """Measure the saving by giving up: with and without it at once, in a process each."""
    rows = []
    with Workers(2) as workers:
        for seed in seeds:
            jobs = [(library, seed, generations, whole) for whole in (False, True)]
            early, whole = workers.map(_giving_up, jobs)
            rows.append(
                {
                    "seed": seed,
                    "generations": generations,
                    "share given up": early["share given up"],
                    "CPU seconds": early["CPU seconds"],
                    "CPU seconds, all packed whole": whole["CPU seconds"],
                    "times as fast": whole["CPU seconds"] / early["CPU seconds"],
                    "same outcome": early["outcome"] == whole["outcome"],
                }
            )
    return rows


def check_aim(result: dict[str, Any]) -> dict[str, Any]:
    """Compare a run with the aim: median minutes for a pack of 1000 generations."""
    alone, shared = result["a pack a process"], result["a pack on two workers"]

    def median(rows: list[dict[str, Any]], name: str) -> float:
        return float(np.median([row[name] for row in rows])) / 60

    return {
        "minutes a pack, a process each": median(alone, "seconds for 1000"),
        "minutes a pack, children on two workers": median(shared, "seconds for 1000"),
        "minutes a pack with early stopping, a process each": median(
            alone, "seconds until stopped"
        ),
        "extrapolated": any(row["extrapolated"] for row in (*alone, *shared)),
        "aim": f"<= {AIM}",
        "met": min(median(rows, "seconds for 1000") for rows in (alone, shared)) <= AIM,
    }


def show(console: Console, result: dict[str, Any]) -> None:
    for way in ("a pack a process", "a pack on two workers"):
        table = Table(
            "seed", "size", "items", "density", "given up", "min", "stopped at", "density", "min",
            title=f"{way}: 1000 generations, and until early stopping",
        )  # fmt: skip
        for row in result[way]:
            table.add_row(
                f"{row['seed']}",
                f"{row['size']:.2f}",
                f"{row['items']}",
                f"{row['density']:.3f}",
                f"{row['share given up']:.0%}",
                f"{row['seconds for 1000'] / 60:.2f}{' (extrapolated)' * row['extrapolated']}",
                f"{row['stopped at']}",
                f"{row['density when stopped']:.3f}",
                f"{row['seconds until stopped'] / 60:.2f}",
            )
        console.print(table)
    for name, value in result["bar"].items():
        console.print(f"{name}: {value if isinstance(value, bool | str) else f'{value:.2f}'}")
    speed = result["speed"]
    table = Table("workers", "generations/s", "chromosomes/s", title="medians, alternating")
    for count, rate in speed["generations a second"].items():
        table.add_row(f"{count}", f"{rate:.2f}", f"{speed['chromosomes a second'][count]:.0f}")
    console.print(table)
    console.print(f"two workers are {speed['two workers, times one']['median']:.2f} times one")
    table = Table("account", "share", title="where the time goes")
    for name, share in result["shares"]["shares"].items():
        table.add_row(name, f"{share:.1%}")
    table.add_row("of which timers", f"{result['shares']['share of the timers']:.1%}")
    console.print(table)
    hits: dict[str, list[float]] = {}
    for row in result["a pack a process"]:
        for name, rate in row["counts"]["hit rates"].items():
            hits.setdefault(name, []).append(rate)
    table = Table("cache", "answered, median", title="caches, a pack a process")
    for name, rates in hits.items():
        table.add_row(name, f"{np.median(rates):.1%}")
    console.print(table)
    table = Table("seed", "given up", "times as fast", "same outcome", title="giving up early")
    for row in result["giving up"]:
        same = "yes" if row["same outcome"] else "NO"
        share, faster = row["share given up"], row["times as fast"]
        table.add_row(f"{row['seed']}", f"{share:.0%}", f"{faster:.2f}", same)
    console.print(table)


PARTS = ("speed", "giving up", "shares", "a pack a process", "a pack on two workers")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--seeds", type=int, default=4, help="number of packs that are evolved whole"
    )
    parser.add_argument("--seed", type=int, default=0, help="the first of their seeds")
    parser.add_argument("--generations", type=int, default=PAPER.generations)
    parser.add_argument(
        "--at-once", type=int, default=2, help="packs at once, for those with a process each"
    )
    parser.add_argument(
        "--short", type=int, default=150, help="generations of the first three parts"
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, metavar="PART")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday").split("train")
    seeds = list(range(arguments.seed, arguments.seed + arguments.seeds))
    few, short = seeds[:2], min(arguments.short, arguments.generations)
    console = Console(width=100)
    file = arguments.out / "evolution.json"
    result: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    result |= {
        "command": "python -m benchmarks.evolution",
        "library": {"name": library.name, "split": "train", "digest": library.digest},
        "settings": PAPER.to_json(),
        "machine": machine(),
    }

    def save(part: str, found: Any) -> None:
        result[part] = found
        write_json(file, result)
        console.print(f"{part}: written to {file}")

    def save_pack(part: str, row: dict[str, Any]) -> None:
        others = [other for other in result.get(part, []) if other["seed"] != row["seed"]]
        save(part, sorted([*others, row], key=lambda row: row["seed"]))

    if "speed" in arguments.parts:
        save("speed", lockstep(library, few, short))
    if "giving up" in arguments.parts:
        save("giving up", giving_up(library, few, short))
    if "shares" in arguments.parts:
        save("shares", time_shares(library, few, never_stopping(short)))
    if "a pack a process" in arguments.parts:
        jobs = [(library, seed, arguments.generations, 1) for seed in seeds]
        for row in Workers(arguments.at_once).as_done(one_pack, jobs):
            save_pack("a pack a process", row | {"at once": arguments.at_once})
    if "a pack on two workers" in arguments.parts:
        for seed in seeds:
            save_pack("a pack on two workers", one_pack(library, seed, arguments.generations, 2))
    if all(part in result for part in PARTS):
        save("bar", check_aim(result))
        show(console, result)


if __name__ == "__main__":
    main()
