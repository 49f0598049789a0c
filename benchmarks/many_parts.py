"""Measure strips of many different parts: density against seconds, memory and how both grow.

    .venv/bin/python -m benchmarks.many_parts --parts 100 300 628 --seeds 1 2 3
    .venv/bin/python -m benchmarks.many_parts --parts 100 --seeds 1 2 3 --cluster
    .venv/bin/python -m benchmarks.many_parts --parts 100 --seeds 1 2 3 --ablations
    .venv/bin/python -m benchmarks.many_parts --parts 25 100 300 --profile
    .venv/bin/python -m benchmarks.many_parts --table

The parts are shapes of `everyday`, drawn without repetition as long as there are enough, with a
longest side of 20 to 60 mm. The base is a square whose side is the third root of their volume at a
density of 0.35. Each search is a separate process with two workers and the seconds of `SECONDS`,
and its packing is checked by the meshes. Each result is written to
`benchmarks/results/many_parts.json` at once, and what has a result is not searched again. `--table`
writes the table of `docs/benchmarks/nesting-many.md` and fits the exponents of growth. `--cluster`
searches twice, for equal processor time of each worker: with threads, and on two machines of a Ray
cluster on this computer. `--ablations` searches with one worker for these seconds of processor
time, each time without one part of the search. `--profile` measures for one minute where the time
of such a search goes, as it is and with fields of pairs instead of cells.
"""

from __future__ import annotations

import json
import math
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.common import (
    RESULTS,
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from packit_sim import Item, ItemType, NestSettings, Packing, ShapeLibrary, nest
from packit_sim.parts.nesting import (
    cell_filling,
    cell_separation,
    cell_strips,
    cells,
    filling,
    rounds,
    separation,
)
from packit_sim.parts.nesting.cells import Space
from packit_sim.parts.nesting.nest import NestingError
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS
from packit_sim.parts.results.pictures import draw

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "nesting-many.md"

BLOCK = "many parts"
"""Between these comments the page has the table."""

ABLATIONS_BLOCK = "many ablations"
"""Between these comments the page has the table of `--ablations`."""

PROFILE_BLOCK = "many profile"
"""Between these comments the page has the table of `--profile`."""

FILE = "many_parts.json"

SECONDS = {25: 60, 50: 60, 100: 60, 300: 120, 628: 300, 1000: 300, 5000: 1800}
"""The time for each number of parts."""

BY_CELLS = 50
"""The fewest of these parts that are packed as cells."""

LONGEST = 20.0, 60.0
"""The least and the largest longest side of a part, in mm."""

DENSITY = 0.35
"""The density at which the strip is a cube."""

CLEARANCE = 0.01
"""The clearance of `--clearance`, as a share of the base's side."""


FIELDS = "cells: fields of pairs"
"""The ablation without cells."""

WITHOUT: dict[str, dict[str, Any]] = {
    "nothing": {},
    FIELDS: {"most_fields": 10**9, "most_hollow_fields": 10**9},
    "hardest items alone": {"first_construction": 0.0},
    "separations": {"first_construction": 0.0, "constructing": 1.0},
    "settling": {"settling_steps": (0.0, 0.04)},
    "moves of all items at once": {"compacting_moves": 0},
}
"""Settings of the ablations, by the part of the search that each goes without."""


PROFILED = 60.0
"""Seconds of processor time of a search whose steps are measured."""

STEPS: dict[str, tuple[tuple[Any, str], ...]] = {
    "preparation": ((rounds, "build"), (rounds, "add_fields"), (cells, "_computed")),
    "lowest places": ((Space, "lowest"), (Space, "put")),
    "samples of a construction": ((filling, "construct"),),
    "separation": ((cell_separation, "separate_cells"), (separation, "separate")),
    "settling": ((cell_filling, "settle"),),
    "moves of all items at once": ((cell_strips, "compacted"),),
}
"""The functions in which the time goes, by what they do."""


def parts(count: int, seed: int) -> tuple[list[ItemType], float]:
    """Return different parts, and the side of their base."""
    library = ShapeLibrary.open("everyday")
    names = sorted(library)
    rng = np.random.default_rng(seed)
    rng.shuffle(names)
    types = []
    for n in range(count):
        name = names[n % len(names)]
        mesh = library[name].mesh
        scale = float(rng.uniform(*LONGEST)) / float(max(mesh.extents))
        types.append(ItemType(f"{n} {name}".replace("/", "_"), mesh.vertices * scale, mesh.faces))
    return types, (sum(each.volume for each in types) / DENSITY) ** (1 / 3)


def items_of(types: Sequence[ItemType], unit: float) -> list[Item]:
    """Return parts as items of a box whose unit has this length."""
    return [Item(one.shape, (float(np.linalg.norm(one.extents)) / unit) ** 3) for one in types]


def search(
    count: int, seed: int, has_clearance: bool, settings: NestSettings
) -> tuple[dict[str, Any], Packing]:
    """Pack one set of parts; return densities by seconds, memory and problems, and the packing."""
    types, side = parts(count, seed)
    volume = sum(each.volume for each in types)
    history: list[tuple[float, float]] = []
    started = time.perf_counter()

    def note(packing: Packing, _: float) -> None:
        density = volume / (side * side * packing.height)
        history.append((round(time.perf_counter() - started, 1), round(density, 4)))

    packing = nest(
        types,
        (side, side, math.inf),
        time=SECONDS[count],
        clearance=CLEARANCE * side if has_clearance else 0.0,
        callback=note,
        settings=settings,
    )
    seconds = round(time.perf_counter() - started, 1)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    found = {"history": history, "seconds": seconds, "memory": memory}
    return {**found, "problems": packing.problems()}, packing


@contextmanager
def cluster() -> Iterator[str]:
    """Start a Ray cluster of a head without work and two machines; yield the head's address."""
    from ray.cluster_utils import Cluster

    started = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    for _ in range(2):
        started.add_node(num_cpus=1)
    try:
        yield started.address
    finally:
        started.shutdown()


def compared(count: int, seed: int) -> dict[str, Any]:
    """Return the last densities of the same search with threads and in a cluster."""
    with cluster() as address:
        alone = NestSettings(workers=2, clock="processor")
        spread = replace(alone, backend="ray", address=address)
        runs = {
            "threads": search(count, seed, False, alone)[0],
            "cluster": search(count, seed, False, spread)[0],
        }
    return {name: (run["history"][-1][1], len(run["problems"])) for name, run in runs.items()}


def ablated(count: int, seed: int, without: str) -> dict[str, Any]:
    """Search without one of the parts of the search in `WITHOUT`."""
    settings = replace(DEFAULT_SETTINGS, **WITHOUT[without])
    try:
        run, _ = search(
            count, seed, False, NestSettings(workers=1, clock="processor", search=settings)
        )
    except NestingError:  # no packing was found in time
        return {"parts": count, "density": None, "problems": []}
    return {"parts": count, "density": run["history"][-1][1], "problems": run["problems"]}


def profiled(count: int, seed: int, without: str) -> dict[str, float]:
    """Return the seconds of each step of a search, and the density that it reaches."""
    seconds = dict.fromkeys(STEPS, 0.0)

    def timed(step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*given: Any, **named: Any) -> Any:
            started = time.thread_time()
            try:
                return function(*given, **named)
            finally:
                seconds[step] += time.thread_time() - started

        return run

    own_settings = replace(DEFAULT_SETTINGS, **WITHOUT[without])
    settings = NestSettings(workers=1, clock="processor", search=own_settings)
    types, side = parts(count, seed)
    started = time.process_time()
    with ExitStack() as stack:
        for step, functions in STEPS.items():
            for owner, name in functions:
                own = timed(step, getattr(owner, name))
                stack.enter_context(patch.object(owner, name, own))
        packing = nest(types, (side, side, math.inf), time=PROFILED, settings=settings)
    whole = time.process_time() - started
    return {**seconds, "others": whole - sum(seconds.values()), "density": packing.density}


def profile_table(runs: Mapping[str, Mapping[str, float]]) -> str:
    """Tabulate the shares of the steps in the time of each search."""
    rows = []
    for name, own in runs.items():
        seconds = [own[step] for step in (*STEPS, "others")]
        shares = [f"{each / sum(seconds):.0%}" for each in seconds]
        rows.append((name, *shares, f"{own['density']:.3f}"))
    return markdown_table(("parts", *STEPS, "others", "density"), rows)


def ablation_table(runs: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Tabulate the densities without each part of the search, of sets that were packed with all."""
    whole = runs["nothing"]
    rows = []
    for without, own in runs.items():
        names = [name for name in whole if name in own]
        found = [own[name]["density"] for name in names]
        problems = sum(len(each["problems"]) for each in own.values())
        if None in found:
            rows.append((without, len(found), "no packing in time", "", problems))
            continue
        changes = [own[name]["density"] - whole[name]["density"] for name in names]
        change = _spread(changes, "+.3f") if without != "nothing" else ""
        rows.append((without, len(found), _spread(found, ".3f"), change, problems))
    return markdown_table(("without", "sets", "density", "change", "problems"), rows)


def measure(
    count: int, seed: int, has_clearance: bool, pictures: Path | None = None
) -> dict[str, Any]:
    """Run a search in a new process, since memory is that of a process."""
    options = ["--one", str(count), str(seed)] + ["--clearance"] * has_clearance
    options += ["--pictures", str(pictures)] if pictures else []
    command = [sys.executable, "-m", "benchmarks.many_parts", *options]
    result = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])  # before the picture
    return {"parts": count, "seed": seed, "clearance": has_clearance, **found}


def table(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """Tabulate the runs in Markdown, and the exponents with which time and memory grow."""
    rows = []
    groups: dict[tuple[int, bool], list[Mapping[str, Any]]] = {}
    for run in runs.values():
        groups.setdefault((run["parts"], run["clearance"]), []).append(run)
    for (count, has_clearance), own in sorted(groups.items()):
        first = [run["history"][0] for run in own]
        last = [run["history"][-1][1] for run in own]
        rows.append(
            (
                f"{count:,}",
                "1% of the base" if has_clearance else "none",
                len(own),
                _spread([seconds for seconds, _ in first], ".1f"),
                _spread([density for _, density in first], ".3f"),
                SECONDS[count],
                _spread(last, ".3f"),
                f"{max(run['memory'] for run in own) / 2**30:.1f}",
                sum(len(run["problems"]) for run in own),
            )
        )
    head = (
        "parts",
        "clearance",
        "sets",
        "first after, s",
        "its density",
        "time, s",
        "density at the end",
        "GiB",
        "problems",
    )
    return markdown_table(head, rows) + "\n" + _growth(groups)


def _spread(values: list[float], form: str) -> str:
    mean, least, most = np.mean(values), min(values), max(values)
    return (
        f"{mean:{form}} ({least:{form}} to {most:{form}})" if len(values) > 1 else f"{mean:{form}}"
    )


def _growth(groups: Mapping[tuple[int, bool], list[Mapping[str, Any]]]) -> str:
    """Return the sentence with the exponents, fitted where items are cells."""
    own = {
        count: runs
        for (count, has_clearance), runs in groups.items()
        if not has_clearance and count >= BY_CELLS
    }
    if len(own) < 2:
        return ""
    counts = np.log(sorted(own))
    firsts = [np.mean([run["history"][0][0] for run in own[n]]) for n in sorted(own)]
    memory = [np.mean([run["memory"] for run in own[n]]) for n in sorted(own)]
    powers = [float(np.polyfit(counts, np.log(values), 1)[0]) for values in (firsts, memory)]
    return (
        f"From {BY_CELLS} parts on, the time to the first packing grows as their number to the "
        f"power of {powers[0]:.2f}, memory as {powers[1]:.2f}.\n"
    )


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--parts", nargs="+", type=int, choices=SECONDS, default=[])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--clearance", action="store_true", help="of 1%% of the base's side")
    parser.add_argument("--cluster", action="store_true", help="compare threads with a cluster")
    parser.add_argument("--ablations", action="store_true", help="search without parts of it")
    parser.add_argument("--profile", action="store_true", help="measure the steps of a search")
    parser.add_argument("--pictures", type=Path, help="a folder in which packings are drawn")
    parser.add_argument("--one", nargs=2, type=int, help="print one search: parts and seed")
    parser.add_argument("--table", action="store_true", help="write the table into the page")
    arguments = parser.parse_args()
    if arguments.one:
        count, seed = arguments.one
        result, packing = search(count, seed, arguments.clearance, NestSettings(workers=2))
        print(json.dumps(result), flush=True)
        if arguments.pictures:
            draw(packing, arguments.pictures / f"many-parts-{count}.png")
        return
    file = arguments.out / FILE
    before = json.loads(file.read_text()) if file.exists() else {}
    found = {key: before.get(key, {}) for key in ("runs", "clusters", "ablations", "profiles")}

    def note(where: dict[str, Any], name: str, measured: Callable[[], Any]) -> None:
        """Measure what has no result yet, and write it."""
        if name not in where:
            where[name] = measured()
            print(name, where[name], flush=True)
            head = {"command": "python -m benchmarks.many_parts", "machine": machine()}
            write_json(file, {**head, **found})

    for given in product(arguments.parts, arguments.seeds):
        name = "{} parts, seed {}".format(*given) + ", clearance" * arguments.clearance
        if arguments.cluster:
            note(found["clusters"], name, partial(compared, *given))
        elif arguments.ablations:
            for without in WITHOUT:
                own = found["ablations"].setdefault(without, {})
                note(own, name, partial(ablated, *given, without))
        elif arguments.profile:
            for own, without in (("", "nothing"), (", fields of pairs", FIELDS)):
                note(found["profiles"], f"{given[0]}{own}", partial(profiled, *given, without))
        else:
            run = partial(measure, *given, arguments.clearance, arguments.pictures)
            note(found["runs"], name, run)
    if arguments.table and arguments.out == RESULTS:
        write_into_page(PAGE, table(found["runs"]), BLOCK)
        write_into_page(PAGE, ablation_table(found["ablations"]), ABLATIONS_BLOCK)
        write_into_page(PAGE, profile_table(found["profiles"]), PROFILE_BLOCK)


if __name__ == "__main__":
    main()
