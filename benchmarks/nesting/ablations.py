"""Measure what the parts of the search for strips give: the same searches without one of them.

    .venv/bin/python -m benchmarks.nesting.ablations --data ../shared/esicup

Without --data, the strips are built-in ones. Each variant runs in its own process, of which it may
replace functions. The results are written to `benchmarks/results/nesting_ablations.json` one by
one: what has a result is not searched again. `python -m benchmarks.nesting --table` puts them on
the page.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.common import argument_parser, machine, write_json
from benchmarks.nesting.cases import CASES, DATA_HELP
from benchmarks.nesting.runs import Search, run
from packit_sim import NestSettings, nest
from packit_sim.parts.nesting import strips
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.rounds import Problems
from packit_sim.parts.nesting.settings import SearchSettings
from packit_sim.parts.nesting.tasks import Poses, SearchTask

FILE = "nesting_ablations.json"

STRIPS = (
    ("literature", "Stoyan et al. 2005/Example3", "axis-4"),
    ("literature", "Egeblad et al. 2009/Merged3", "axis-4"),
    ("strips", "0", "cube"),
)
"""Kind, name and rotation set of the strips."""

BUILTIN_STRIPS = (
    ("builtin", "polytopes-20", "axis-4"),
    ("builtin", "brackets-24", "axis-4"),
    ("strips", "0", "cube"),
)
"""The same without the literature's instances."""

SECONDS = 30.0

SEEDS = (0, 1)

WARM_UP = 3
"""Short searches before those that are measured, which compile the kernels."""


def no_weights() -> SearchSettings:
    """Let the weights of pairs stay 1: not guided, only a local search."""
    return SearchSettings(weight_growth=(0.0, 0.0))


def no_sizes() -> SearchSettings:
    """Measure overlap by depth alone, whatever the sizes of the two items."""
    original = Problems.build

    def built(problems: Problems) -> Problem:
        problem = original(problems)
        problem.lookup.sizes[:] = 1.0
        return problem

    patch.object(Problems, "build", built).start()
    return SearchSettings()


def no_construction() -> SearchSettings:
    """Begin with the items on top of each other, as they are."""

    def stacked(problem: Problem, task: SearchTask, *_: Any) -> Poses:
        poses = task.unplaced
        poses.inside[:] = 1
        poses.turned[:] = problem.allowed[task.numbers, 0]
        boxes = problem.lookup.boxes[task.numbers, poses.turned]
        heights = boxes[:, 5] - boxes[:, 2] + 2 * problem.lookup.slack
        poses.places[:] = -boxes[:, :3]
        poses.places[:, 2] += np.cumsum(heights) - heights
        return poses

    patch.object(strips, "constructed", stacked).start()
    return SearchSettings()


def all_at_once() -> SearchSettings:
    """Search for all items from the start, not for the large ones first."""
    return SearchSettings(first_items=sys.maxsize)


def no_moves_at_the_end() -> SearchSettings:
    """Leave the lowest strip as the last separation left it."""
    return SearchSettings(finishing_moves=0, finishing=(0.0, 0.0, 0.0))


WHOLE = "as it is"

VARIANTS: dict[str, Callable[[], SearchSettings]] = {
    WHOLE: SearchSettings,
    "weights stay 1": no_weights,
    "overlap without sizes": no_sizes,
    "no construction": no_construction,
    "all items at once": all_at_once,
    "no moves of all items at the end": no_moves_at_the_end,
}
"""The settings of each variant; some also replace functions."""


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--only", choices=VARIANTS, help="one variant, in this process")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--data", type=Path, help=DATA_HELP)
    arguments = parser.parse_args()
    if arguments.only:
        measure(
            arguments.only,
            arguments.seconds,
            arguments.seeds,
            arguments.workers,
            arguments.out,
            arguments.data,
        )
        return
    for name in VARIANTS:
        module = "benchmarks.nesting.ablations"
        subprocess.run([sys.executable, "-m", module, *sys.argv[1:], "--only", name], check=True)


def measure(
    variant: str,
    seconds: float,
    seeds: list[int],
    workers: int,
    out: Path,
    data: Path | None = None,
) -> None:
    """Search all strips that have no result yet, as this process's variant does."""
    search = VARIANTS[variant]()
    chosen = STRIPS if data else BUILTIN_STRIPS
    todo = [
        Search(*strip, seed, seconds)
        for seed in seeds
        for strip in chosen
        if _key(variant, Search(*strip, seed, seconds)) not in read(out)
    ]
    for n in range(WARM_UP if todo else 0):
        for kind, name, rotations in chosen:
            case = CASES[kind](name, rotations, data)
            settings = NestSettings(workers=workers, clock="processor", search=search)
            nest(case.types, case.container, case.objective, 2.0, n, settings=settings)
    for each in todo:
        result, _ = run(each, workers, search, data)
        runs = read(out)
        runs[_key(variant, each)] = {
            "variant": variant,
            "name": f"{each.kind} {each.name}" if each.kind == "strips" else f"`{each.name}`",
            "rotations": each.rotations,
            "seed": each.seed,
            "seconds": seconds,
            **{field: result[field] for field in ("score", "density", "valid", "workers")},
        }
        content = {"command": "python -m benchmarks.nesting.ablations", "machine": machine()}
        write_json(out / FILE, {**content, "runs": runs})
        print(f"{_key(variant, each)}: {result['score']:.4f}", flush=True)


def _key(variant: str, search: Search) -> str:
    return f"{variant}: {search.key}"


def read(out: Path) -> dict[str, dict[str, Any]]:
    """Return the finished searches in a folder by their keys."""
    file = out / FILE
    if not file.exists():
        return {}
    runs: dict[str, dict[str, Any]] = json.loads(file.read_text())["runs"]
    return runs


if __name__ == "__main__":
    main()
