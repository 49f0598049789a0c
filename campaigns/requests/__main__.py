"""Send requests to a workbench from many connections at a time, and see whether a promise breaks.

    .venv/bin/python -m campaigns.requests --requests 10000    (about 20 minutes of one core)
    .venv/bin/python -m campaigns.requests --table

The workbench is a process with small limits, so that they are met. Threads send requests of random
kinds, each with a mark that its answer must have; a watcher looks at the folder all the time.
After each round the workbench is left alone, and what it then has and holds is checked. Writes
`campaigns/results/requests.json`; --table writes it into the page.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.common import machine, markdown_table, write_json
from campaigns.common import argument_parser, read_results, write_into_page
from campaigns.requests.bench import CLIENTS, LIMITS, Bench
from campaigns.requests.kinds import KINDS, Broken
from packit_sim.core.version import __version__

ROUND = 500
"""Requests between two moments of rest."""


def run_round(bench: Bench, count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Send requests from several threads, then let the workbench rest, and check it."""
    tried: Counter[str] = Counter()
    problems: list[str] = []
    shares = np.full(CLIENTS, count // CLIENTS)
    shares[: count % CLIENTS] += 1

    def send(number: int) -> None:
        rng = np.random.default_rng((seed, number))
        for mark in range(shares[number]):
            name = str(rng.choice(list(KINDS)))
            tried[name] += 1
            try:
                KINDS[name].send(bench, rng, f"m{seed}x{number}x{mark}")
            except Broken as broken:
                problems.append(f"{name}: {broken}")
            except (OSError, ValueError) as error:
                problems.append(f"{name}: {error!r}")

    threads = [threading.Thread(target=send, args=(number,)) for number in range(CLIENTS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    problems += [f"at all times: {problem}" for problem in bench.watched()]
    problems += [f"at rest: {problem}" for problem in bench.at_rest()]
    return tried, problems


def run(count: int, seed: int) -> dict[str, Any]:
    """Run the campaign, and return its results."""
    tried: Counter[str] = Counter()
    problems: list[str] = []
    with Bench() as bench:
        for number, first in enumerate(range(0, count, ROUND)):
            found, broken = run_round(bench, min(ROUND, count - first), seed * 1000 + number)
            tried += found
            problems += broken
            print(f"{tried.total():,} requests, {len(problems)} broken", *broken, sep="\n  ")
        tried["at all times"], tried["at rest"] = bench.looks, bench.rests
        tried["the end"] = 1
        problems += [f"the end: {problem}" for problem in bench.end()]
    return {
        "version": __version__,
        "command": f"python -m campaigns.requests --requests {count} --seed {seed}",
        "machine": machine(),
        "requests": count,
        "limits": LIMITS,
        "tried": tried,
        "problems": problems,
        "samples": bench.samples,
    }


def table(results: Mapping[str, Any]) -> str:
    """Tabulate results in Markdown: what was tried, what held, and what broke."""
    promises = {name: kind.promise for name, kind in KINDS.items()}
    promises |= {
        "at all times": "no more files, bytes or entries of the folder than allowed",
        "at rest": "it answers; results verify; files, threads and descriptors are back",
        "the end": "SIGTERM: exit code 143, and no folder is left",
    }
    broken = Counter(problem.partition(": ")[0] for problem in results["problems"])
    rows = [
        (name, promise, f"{tried:,}", f"{tried - broken[name]:,}", str(broken[name]))
        for name, promise in promises.items()
        if (tried := results["tried"].get(name, 0))
    ]
    total = sum(results["tried"][name] for name in KINDS if name in results["tried"])
    rows.append(("all requests", "", f"{total:,}", "", str(len(results["problems"]))))
    return markdown_table(("kind", "promise", "tried", "held", "broke"), rows)


def main() -> None:
    """Run the campaign, or write its table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--requests", type=int, default=10_000)
    arguments = parser.parse_args()
    if arguments.table:
        write_into_page("requests", table(read_results("requests", arguments.out)))
        return
    results = run(arguments.requests, arguments.seed)
    write_json(arguments.out / "requests.json", results)
    print(table(results))


if __name__ == "__main__":
    main()
