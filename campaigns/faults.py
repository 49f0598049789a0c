"""Disturb commands wherever they write, and see whether anything is lost.

    .venv/bin/python -m campaigns.faults               (some hours; some faults need root)
    .venv/bin/python -m campaigns.faults --commands evaluate --faults "kill -9"
    .venv/bin/python -m campaigns.faults --table

A trial disturbs a command, checks the promises on the page with what is then on the disk, and runs
the same command again. Results are added to `campaigns/results/faults.json`, by fault, command and
seed; --table writes them into the page.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.common import machine, markdown_table, write_json
from campaigns.common import argument_parser, read_results, write_into_page
from campaigns.disturbed import Command
from campaigns.fault_commands import COMMANDS, make_quick
from campaigns.fault_kinds import FAULTS, Fault
from campaigns.fault_trials import Bench
from packit_sim.core.version import __version__


def tried(
    bench: Bench, fault: Fault, seed: int, seconds: float = float("inf")
) -> tuple[int, list[str]]:
    """Try a fault on a command wherever it can strike, and return the trials and the problems."""
    rng = np.random.default_rng(seed)
    started, count, problems = time.monotonic(), 0, []
    for where, trial in fault.trials(bench, rng):
        if time.monotonic() - started > seconds:
            break
        bench.restore()
        found = list(trial())
        count += 1
        if found:
            problems.append(f"{where}: {'; '.join(found)}")
    return count, problems


def table(results: Mapping[str, Any]) -> str:
    """Tabulate results in Markdown: a row for each fault, trials by command, and what was lost."""
    rows: list[tuple[str, ...]] = []
    totals = [0] * (len(COMMANDS) + 1)
    for name, fault in FAULTS.items():
        trials = results["trials"].get(name, {})
        by_command = [trials.get(command, {}).values() for command in COMMANDS]
        counts = [sum(one["tried"] for one in runs) for runs in by_command]
        counts.append(sum(len(one["problems"]) for runs in by_command for one in runs))
        totals = [total + count for total, count in zip(totals, counts, strict=True)]
        if any(counts):
            rows.append(
                (name, fault.promise, *(str(n or "") for n in counts[:-1]), str(counts[-1]))
            )
    rows.append(("all", f"{sum(totals[:-1]):,} trials", *map(str, totals)))
    return markdown_table(("fault", "promise", *(f"`{name}`" for name in COMMANDS), "lost"), rows)


def run(
    commands: Sequence[Command], faults: Sequence[str], seed: int, minutes: float, out: Path
) -> None:
    """Try faults on commands, and add the trials to the results file as they come."""
    console = Console()
    results = read_results("faults", out) or {"trials": {}}
    results |= {"command": "python -m campaigns.faults", "version": __version__}
    results["machine"] = machine()
    home = Path.cwd()
    make_quick()
    for command in commands:
        with tempfile.TemporaryDirectory(prefix="packit-faults-") as workspace:
            os.chmod(workspace, 0o755)  # for other users
            bench = Bench(command, Path(workspace))
            for name in faults:
                started = time.monotonic()
                count, problems = tried(bench, FAULTS[name], seed, minutes * 60)
                if not count:
                    continue
                trials = results["trials"].setdefault(name, {}).setdefault(command.title, {})
                seconds = round(time.monotonic() - started, 1)
                trials[str(seed)] = {"tried": count, "problems": problems, "seconds": seconds}
                write_json(out / "faults.json", results)
                console.print(f"{command.title}, {name}: {count} tried, {len(problems)} lost")
                for problem in problems:
                    console.print(f"  {problem}", style="red", markup=False, highlight=False)
            os.chdir(home)


def main() -> None:
    """Run the campaign, or write its table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="for each fault of a command"
    )
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    if arguments.table:
        write_into_page("faults", table(read_results("faults", out)))
    else:
        commands = [COMMANDS[name] for name in arguments.commands]
        run(commands, arguments.faults, arguments.seed, arguments.minutes, out)
        print(table(read_results("faults", out)))


if __name__ == "__main__":
    main()
