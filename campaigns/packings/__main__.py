"""Pack random parts from files of all formats, and check the results by other code.

    .venv/bin/python -m campaigns.packings --packings 1000          (about an hour of one core)
    .venv/bin/python -m campaigns.packings --seed 17 --packings 1   (one case)
    .venv/bin/python -m campaigns.packings --table

The meshes, the writers of their files and the checker are the campaign's own. A packing that is
wrong keeps its folder, with the input files and the results, in --work. The finished ones are not
repeated there, so that the same command resumes. Writes `campaigns/results/packings.json`; --table
also writes the table of the page. Needs lib3mf, manifold3d and openpyxl.
"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, as_completed
from pathlib import Path
from typing import Any

from pebble import ProcessExpired, ProcessPool

from benchmarks.common import machine, write_json
from campaigns.common import ROOT, argument_parser, read_results, write_into_page
from campaigns.packings.table import NAME, table, totals
from campaigns.packings.trials import begin, lost, tried
from packit_sim.core.version import __version__

LONGEST = 900.0
"""Seconds after which a trial counts as wrong; the first one may have to compile the kernels."""

TRIALS = 50
"""Trials of one process."""


def run(seeds: Sequence[int], work: Path, jobs: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Try cases in processes, and yield each as it ends."""
    context = multiprocessing.get_context("spawn")
    with ProcessPool(jobs, max_tasks=TRIALS, initializer=begin, context=context) as pool:
        futures: dict[Future[dict[str, Any]], int] = {
            pool.schedule(tried, args=(seed, work), timeout=LONGEST): seed for seed in seeds
        }
        for future in as_completed(futures):
            seed = futures[future]
            try:
                yield seed, future.result()
            except (TimeoutError, ProcessExpired) as error:
                yield seed, lost(seed, work, f"{type(error).__name__}: {error}")


def campaign(first: int, count: int, work: Path, jobs: int, out: Path) -> None:
    """Try the cases that the work folder does not have yet, and write the results."""
    work.mkdir(parents=True, exist_ok=True)
    file = work / "trials.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    trials = {entry["seed"]: entry for entry in map(json.loads, lines)}
    asked = range(first, first + count)
    missing = [seed for seed in asked if seed not in trials]
    with file.open("a") as finished:
        for seed, trial in run(missing, work, jobs):
            trials[seed] = {"seed": seed, **trial}
            finished.write(json.dumps(trials[seed], ensure_ascii=False) + "\n")
            finished.flush()
            left = sum(one not in trials for one in asked)
            what = "".join(f"\n    {each['text']}" for each in trial["problems"])
            print(f"{seed}: {trial['seconds']} s, {left} left{what}", flush=True)
    own = {str(seed): trials[seed] for seed in asked}
    result = {
        "command": f"python -m campaigns.packings --seed {first} --packings {count}",
        "version": __version__,
        "machine": machine(),
        "seeds": f"{first} to {first + count - 1}",
        **totals(own),
    }
    write_json(out / f"{NAME}.json", result)


def main() -> None:
    """Run the campaign, or write its table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--packings", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--work", type=Path, default=ROOT / "build" / NAME)
    arguments = parser.parse_args()
    if arguments.table:
        write_into_page(NAME, table(read_results(NAME, arguments.out)))
        return
    campaign(arguments.seed, arguments.packings, arguments.work, arguments.jobs, arguments.out)
    print(table(read_results(NAME, arguments.out)))


if __name__ == "__main__":
    main()
