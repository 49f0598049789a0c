"""Measure `packit_sim.nest`: strips of the literature and our own, tasks in a strip or box, bins.

    .venv/bin/python -m benchmarks.nesting builtin --seconds 10
    .venv/bin/python -m benchmarks.nesting literature --data ../shared/esicup --rotations published
    .venv/bin/python -m benchmarks.nesting literature --data ../shared/esicup --resume --seconds 900
    .venv/bin/python -m benchmarks.nesting strips --rotations cube axis-4
    .venv/bin/python -m benchmarks.nesting knapsacks
    .venv/bin/python -m benchmarks.nesting bins
    .venv/bin/python -m benchmarks.nesting clearance --data ../shared/esicup --rotations axis
    .venv/bin/python -m benchmarks.nesting.ablations
    .venv/bin/python -m benchmarks.nesting --verify --data ../shared/esicup
    .venv/bin/python -m benchmarks.nesting --table --data ../shared/esicup

The literature's meshes are not part of the project: `--data` is a folder of them
(docs/reference/instances.md says where they are published). Without it, `clearance` takes our own
instances, and `--verify` leaves out the packings of the literature's.

Each result is written to `benchmarks/results/nesting.json` at once, and its packing to a file in
`benchmarks/results/nesting/`: what has a result is not searched again. `--rotations axis` stands
for the set that others used: axis-4, for Liu's instance axis-8; `--rotations published` for all for
which others published a height of an instance. `--resume` resumes from the best packing of the same
problem, and the seconds include those that it took. `--verify` checks all packings again by their
meshes. `--table` writes `docs/benchmarks/nesting.md` and its picture.
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.common import argument_parser
from benchmarks.nesting.cases import CASES, DATA_HELP, names, needs_data, published
from benchmarks.nesting.report import write_report
from benchmarks.nesting.runs import Results, Search, run_all

AXIS = "axis"
"""Stands for the `axis-n` of the literature."""

PUBLISHED = "published"
"""Stands for all rotation sets for which others published a height of an instance."""


def main() -> None:
    parser = argument_parser(__doc__, "JSON, packings and, unless it is the default, the page")
    parser.add_argument("kind", nargs="?", choices=CASES, help="what is searched")
    parser.add_argument("--instances", nargs="+", help="their names; by default all")
    parser.add_argument("--rotations", nargs="+", default=["cube"], help="rotation sets")
    parser.add_argument("--seconds", nargs="+", type=float, default=[60.0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--beginnings", type=int, help="how often a long search begins at most")
    parser.add_argument("--resume", action="store_true", help="resume from the row's best packing")
    parser.add_argument("--data", type=Path, help=DATA_HELP)
    parser.add_argument("--verify", action="store_true", help="check all packings again")
    parser.add_argument("--table", action="store_true", help="write the page and its picture")
    arguments = parser.parse_args()
    if not (arguments.kind or arguments.verify or arguments.table):
        parser.error("choose what is searched, --verify or --table")
    results = Results(arguments.out, arguments.data)
    if arguments.kind:
        known = names(arguments.kind, arguments.data)
        chosen = arguments.instances or known
        if unknown := sorted(set(chosen) - set(known)):
            parser.error(f"no instances {', '.join(unknown)}: choose from {', '.join(known)}")
        if arguments.data is None and any(needs_data(arguments.kind, name) for name in chosen):
            parser.error(f"{arguments.kind} needs --data: {DATA_HELP}")
        searches = [
            Search(arguments.kind, name, rotations, seed, seconds)
            for seconds in arguments.seconds
            for asked in arguments.rotations
            for seed in arguments.seeds
            for name in chosen
            for rotations in _rotation_sets(name, asked)
        ]
        run_all(searches, results, arguments.workers, arguments.beginnings, arguments.resume)
    if arguments.verify:
        searches = [Search.of(result) for result in results.read().values()]
        readable = sum(map(results.is_readable, searches))
        problems = results.verify()
        for problem in problems:
            print(problem)
        print(f"{readable} packings, {len(problems)} problems")
        if readable < len(searches):
            print(f"{len(searches) - readable} packings not verified: give --data, {DATA_HELP}")
        if problems:
            sys.exit(1)
    if arguments.table:
        write_report(results.read(), arguments.out, arguments.data)


def _rotation_sets(name: str, asked: str) -> list[str]:
    """Return the rotation sets that are asked for by name."""
    if asked == PUBLISHED:
        return [rotations for each, rotations in published() if each == name]
    if asked == AXIS:
        return ["axis-8" if name.startswith("Liu") else "axis-4"]
    return [asked]


if __name__ == "__main__":
    main()
