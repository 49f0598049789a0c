"""Forge records of packings, and let an independent judge decide what is right about each.

    .venv/bin/python -m campaigns.forgeries --forgeries 100000      (some hours of one core)
    .venv/bin/python -m campaigns.forgeries --seed 1 --forgeries 1000
    .venv/bin/python -m campaigns.forgeries --table

Writes `campaigns/results/forgeries.json`, also with each forgery that was verified, refused or
resumed wrongly; --table writes the table of the page.
"""

from __future__ import annotations

import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed

from benchmarks.common import machine, write_json
from campaigns.common import argument_parser, read_results, write_into_page
from campaigns.forgeries.table import NAME, counted, table
from campaigns.forgeries.trials import KINDS, trials
from packit_sim.core.version import __version__

BATCH = 160
"""Forgeries of one process."""


def main() -> None:
    """Run the campaign, or write its table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--forgeries", type=int, default=100_000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    if arguments.table:
        write_into_page(NAME, table(read_results(NAME, arguments.out)))
        return
    numbers = range(arguments.forgeries)
    batches = [numbers[n : n + BATCH] for n in range(0, len(numbers), BATCH)]
    kinds: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    wrong: list[str] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        futures = {pool.submit(trials, own, arguments.seed): own for own in batches}
        for done, future in enumerate(as_completed(futures), 1):
            own, found = futures[future], future.result()
            for kind, row in counted(found).items():
                kinds[kind].update(row)
            new = [f"{n}: {one}" for n, one in zip(own, found, strict=True) if one.faults]
            wrong += new
            print(f"{done} of {len(batches)} batches", *new, sep="\n    ", flush=True)
            command = f"--seed {arguments.seed} --forgeries {arguments.forgeries}"
            result = {
                "command": f"python -m campaigns.forgeries {command}",
                "version": __version__,
                "machine": machine(),
                "seed": arguments.seed,
                "kinds": kinds,
                "wrong": wrong,
            }
            write_json(arguments.out / f"{NAME}.json", result)
    print(table(read_results(NAME, arguments.out)))


if __name__ == "__main__":
    main()
