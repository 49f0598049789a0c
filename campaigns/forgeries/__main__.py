"""Forge records of packings, and let an independent judge decide what is right about each.

    .venv/bin/python -m campaigns.forgeries --forgeries 100000      (an hour of one core)
    .venv/bin/python -m campaigns.forgeries --forgeries 100000 --resume
    .venv/bin/python -m campaigns.forgeries --seed 1 --forgeries 1000
    .venv/bin/python -m campaigns.forgeries --table

Writes `campaigns/results/forgeries.json`, also with each forgery that was verified, refused or
resumed wrongly; --resume continues a run of the same code that was interrupted, or that had fewer.
--table writes the table of the page.
"""

from __future__ import annotations

import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from benchmarks.common import machine, write_json
from campaigns.common import argument_parser, read_results, write_into_page
from campaigns.forgeries.table import NAME, counted, table
from campaigns.forgeries.trials import KINDS, trials
from packit_sim.core.version import __version__

BATCH = 800
"""Forgeries of one process, after which the results are written."""


def main() -> None:
    """Run the campaign, or write its table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--forgeries", type=int, default=100_000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--resume", action="store_true", help="continue an interrupted run")
    arguments = parser.parse_args()
    if arguments.table:
        write_into_page(NAME, table(read_results(NAME, arguments.out)))
        return
    result = {
        "version": __version__,
        "machine": machine(),
        "seed": arguments.seed,
        "tried": 0,
        "kinds": {kind: {} for kind in KINDS},
        "wrong": [],
    }
    if arguments.resume:
        earlier = read_results(NAME, arguments.out)
        if earlier.get("seed") != arguments.seed or "tried" not in earlier:
            parser.error(f"--resume: {arguments.out} has no results of seed {arguments.seed}")
        result |= {name: earlier[name] for name in ("tried", "kinds", "wrong")}
    numbers = range(result["tried"], arguments.forgeries)
    batches = [numbers[n : n + BATCH] for n in range(0, len(numbers), BATCH)]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for own, found in zip(
            batches, pool.map(partial(trials, seed=arguments.seed), batches), strict=True
        ):
            for kind, row in counted(found).items():
                result["kinds"][kind] = Counter(result["kinds"][kind]) + row
            new = [f"{n}: {one}" for n, one in zip(own, found, strict=True) if one.faults]
            result["wrong"] += new
            command = f"--seed {arguments.seed} --forgeries {own.stop}"
            result |= {"command": f"python -m campaigns.forgeries {command}", "tried": own.stop}
            print(f"{own.stop:,} of {arguments.forgeries:,}", *new, sep="\n    ", flush=True)
            write_json(arguments.out / f"{NAME}.json", result)
    print(table(read_results(NAME, arguments.out)))


if __name__ == "__main__":
    main()
