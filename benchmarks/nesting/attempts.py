"""Measure where the search for a strip spends its time: attempts that succeed and that fail.

    .venv/bin/python -m benchmarks.nesting.attempts --data ../shared/esicup
    .venv/bin/python -m benchmarks.nesting.attempts --data ../shared/esicup --every

One search in one thread, in processor seconds. An attempt is a separation at a height. Prints a row
for each strip: when all items were searched for, the attempts with all of them, the share that
succeeded, the time of those that failed as a share of all, the median step down of both, and the
time of the last gain. --every prints each attempt.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from benchmarks.common import argument_parser, markdown_table
from benchmarks.nesting.cases import DATA_HELP, literature, literature_names
from packit_sim import NestSettings, nest
from packit_sim.parts.nesting.strips import StripSearch

LARGER = (
    "Egeblad et al. 2009/Merged2",
    "Egeblad et al. 2009/Merged4",
    "Stoyan et al. 2004/Example4",
    "Stoyan et al. 2004/Example5",
)


class Attempt(NamedTuple):
    """An attempt to reach a height."""

    has_all: bool
    step: float
    is_apart: bool
    begin: float
    end: float
    height: float


def attempts(name: str, rotations: str, seconds: float, seed: int, data: Path) -> list[Attempt]:
    """Search for a strip, and return the attempts in their order."""
    case = literature(name, rotations, data)
    found: list[Attempt] = []
    begun: list[float] = []
    started = time.process_time()
    begin, end = StripSearch._begun, StripSearch._end

    def begun_at(search: StripSearch, *arguments: Any) -> Any:
        begun.append(time.process_time() - started)
        return begin(search, *arguments)

    def ended(search: StripSearch, problem: Any, best: Any, attempt: Any, is_apart: bool) -> None:
        has_all, step = search._has_all, 1 - search._target / search._height
        end(search, problem, best, attempt, is_apart)
        now = time.process_time() - started
        found.append(Attempt(has_all, step, is_apart, begun[-1], now, search._height))

    settings = NestSettings(workers=1, clock="processor")
    with patch.object(StripSearch, "_begun", begun_at), patch.object(StripSearch, "_end", ended):
        nest(case.types, case.container, "strip", seconds, seed, settings=settings)
    return found


def row(own: list[Attempt]) -> list[str]:
    """Return what a table says of the attempts with all items."""
    late = [one for one in own if one.has_all]
    lower = [one for one in late if one.is_apart]
    failed = [one for one in late if not one.is_apart]
    spent = sum(one.end - one.begin for one in failed) / sum(one.end - one.begin for one in late)

    def median(some: list[Attempt]) -> str:
        steps = [one.step for one in some if one.step > 0]  # not those with more space than before
        return f"{statistics.median(steps):.2%}" if steps else "-"

    return [
        f"{late[0].begin:.1f}",
        str(len(late)),
        f"{len(lower) / len(late):.0%}",
        f"{spent:.0%}",
        median(lower),
        median(failed),
        f"{lower[-1].end:.1f}" if lower else "-",
        f"{late[-1].height:.2f}",
    ]


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--data", type=Path, required=True, help=DATA_HELP)
    parser.add_argument("--instances", nargs="+", default=LARGER, choices=literature_names())
    parser.add_argument("--rotations", nargs="+", default=["fixed", "axis-4"])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", action="store_true", help="print each attempt")
    options = parser.parse_args()
    rows = []
    for name in options.instances:
        for rotations in options.rotations:
            own = attempts(name, rotations, options.seconds, options.seed, options.data)
            for one in own if options.every else ():
                print(one, flush=True)
            rows.append([name, rotations, *row(own)])
    head = (
        "instance, rotations, all items from, attempts, apart, time of failures, step down, "
        "step of failures, last gain, height"
    )
    print(markdown_table(head.split(", "), rows))


if __name__ == "__main__":
    main()
