"""Mutation testing: whether the tests notice small changes of the code.

Draws mutants of the modules that decide what is feasible and what is stored in the game, or of
those that pack parts, runs for each the tests that execute the changed line, and writes what they
found after each mutant. A second run with the same seed continues; other seeds add to the totals.

    python -m campaigns.mutants --seed 1 --count 400
    python -m campaigns.mutants --of parts --seed 1 --count 400
    python -m campaigns.mutants --judge     # survivors with all other tests of their lines
    python -m campaigns.mutants --check     # survivors with the tests that kill them
    python -m campaigns.mutants --table     # write the table in docs/trust/mutants.md
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import platform
import random
import re
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from campaigns import mutant_runs
from campaigns.mutant_plans import SECONDS, TESTS, TESTS_OF_PARTS, plan
from campaigns.mutations import Mutation, mutations

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"

JUDGED = RESULTS / "mutants_judged.json"
"""Judgements of survivors, by the keys of `KINDS`: a reason, or for the last two a test."""

KINDS = {
    "equivalent": "equivalent",
    "search": "search only",
    "other": "other tests",
    "added": "tests added",
}
"""How a survivor may be judged, and the names in the table: nothing changes; a search looks at
other places or takes another time, and what it finds is checked as before; a test that was not run
kills it; or a new test does."""


_GEOMETRY = ("rotations", "voxels", "voxelization", "voxel_kernels", "voxelization_kernels")
_ENGINE = (
    *("feasibility", "screening", "screening_kernels", "collision", "collision_meshes"),
    *("nofit", "occupancy", "occupancy_kernels", "oracle", "containment", "containment_kernels"),
)
_OF_THE_GAME = (
    *(f"packit_sim/geometry/{name}.py" for name in (*_GEOMETRY, "word_kernels")),
    *(f"packit_sim/engine/{name}.py" for name in _ENGINE),
    "packit_sim/box.py",
    *(f"packit_sim/game/datasets/{name}.py" for name in ("packs", "pack_files", "pack_checks")),
    *(f"packit_sim/game/evaluation/{name}.py" for name in ("results", "results_store")),
    "packit_sim/rules.py",
)
"""`packit_sim/placement.py` only names others' functions."""

_OF_PARTS = tuple(
    file.relative_to(ROOT).as_posix()
    for file in sorted((ROOT / "packit_sim" / "parts").rglob("*.py"))
    if file.name != "__init__.py"
)


@dataclass(frozen=True)
class Group:
    """Modules that are mutated together.

    Attributes
    ----------
    name : str
        The name of the results file, and of the table in the page.
    modules : tuple of str
        The modules.
    tests : tuple of str
        The files of tests that are run.
    """

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]

    def source(self) -> str:
        """Return a digest of the modules, since mutants are drawn anew when these change."""
        texts = b"".join((ROOT / module).read_bytes() for module in self.modules)
        return hashlib.sha256(texts).hexdigest()[:16]


GROUPS = {
    "game": Group("mutants", _OF_THE_GAME, TESTS),
    "parts": Group("mutants-parts", _OF_PARTS, TESTS_OF_PARTS),
}

HEAD = (
    *("module", "mutants", "drawn", "killed at first", "by time limit", "survived"),
    *(*KINDS.values(), "left"),
)
"""The columns of the page's table."""

Record = dict[str, Any]


def draw(seed: int, count: int, modules: Sequence[str]) -> list[tuple[str, Mutation]]:
    """Draw mutants at random, without repetition; a larger count extends the list."""
    mutants = [
        (module, mutation)
        for module in modules
        for mutation in mutations((ROOT / module).read_text())
    ]
    random.Random(seed).shuffle(mutants)
    return mutants[:count]


def campaign(options: argparse.Namespace) -> None:
    """Run the mutants that are not in the results file yet."""
    found: Record = json.loads(options.out.read_text()) if options.out.exists() else {"mutants": []}
    done: list[Record] = found["mutants"]
    group = GROUPS[options.of]
    if found.get("source", group.source()) != group.source():
        sys.exit(f"{options.out} has mutants of other source code: choose another file with --out")
    copy: Path = options.copy
    baseline = _baseline(options)
    kills: dict[str, Counter[str]] = {module: Counter() for module in group.modules}
    for record in done:
        kills[record["module"]][record["test"]] += 1
    ends = time.monotonic() + 60 * options.minutes
    for mutant, record in _left(options, done):
        module, mutation = mutant
        if time.monotonic() > ends:
            break
        started = time.monotonic()
        text = (copy / module).read_text()
        tests = plan(baseline, copy, mutant, kills[module])
        with mutant_runs.mutated(copy, module, mutation.apply(text)):
            outcome = mutant_runs.run(copy, tests, baseline.seconds)
        record |= asdict(outcome) | {"planned": len(tests)}
        record["seconds"] = round(time.monotonic() - started, 1)
        kills[module][outcome.test] += 1
        done.append(record)
        _write(options.out, _totals(found, group))
        print(f"{len(done)}", *(record[key] for key in _PRINTED), flush=True)


_PRINTED = ("module", "line", "old", "new", "outcome", "test", "tests", "seconds")


def _left(
    options: argparse.Namespace, done: list[Record]
) -> Iterator[tuple[tuple[str, Mutation], Record]]:
    """List the mutants to run, and what is known of them; those of kernels come last.

    A mutant of a kernel takes a minute to compile, ten times longer than another.
    """
    drawn = draw(options.seed, options.count, GROUPS[options.of].modules)
    drawn.sort(key=lambda mutant: mutant[0].endswith("_kernels.py"))
    known = {(record["seed"], *_place(record)) for record in done}
    for module, mutation in drawn:
        record = {
            "seed": options.seed,
            "module": module,
            "line": mutation.line,
            "column": mutation.column,
            "kind": mutation.kind,
            "old": mutation.original((ROOT / module).read_text()),
            "new": mutation.code,
        }
        if (options.seed, *_place(record)) not in known:
            yield (module, mutation), record


def _place(record: Record) -> tuple[Any, ...]:
    return record["module"], record["line"], record["column"], record["new"]


def judge(options: argparse.Namespace) -> None:
    """Run on each survivor all tests that execute its line; note those that kill it."""
    judged: list[Record] = json.loads(JUDGED.read_text())
    known = set(map(_place, judged))
    baseline = _baseline(options)
    ends = time.monotonic() + 60 * options.minutes
    for record in json.loads(options.out.read_text())["mutants"]:
        if record["outcome"] != "survived" or _place(record) in known or time.monotonic() > ends:
            continue
        text = (options.copy / record["module"]).read_text()
        mutant = record["module"], _nearest(text, record)
        first, tests = (
            plan(baseline, options.copy, mutant, Counter(), most) for most in (SECONDS, math.inf)
        )
        tests = [test for test in tests if test not in first]
        with mutant_runs.mutated(options.copy, mutant[0], mutant[1].apply(text)):
            outcome = mutant_runs.run(options.copy, tests, baseline.seconds)
        if outcome.test:
            place = {key: record[key] for key in ("module", "line", "column", "old", "new")}
            judged.append({**place, "other": outcome.test})
            _write(JUDGED, judged)
        print(*(record[key] for key in _PRINTED[:4]), outcome, len(tests), flush=True)


def _baseline(options: argparse.Namespace) -> mutant_runs.Baseline:
    """Copy the source, unless that was done, and return what its tests do without a mutant."""
    group = GROUPS[options.of]
    _make_copy(options.copy)
    found = mutant_runs.measure(options.copy, group.modules, group.tests)
    print(f"{len(found.seconds)} tests take {sum(found.seconds.values()):.0f} s", flush=True)
    mutant_runs.import_libraries(found.libraries)
    return found


def _make_copy(copy: Path) -> None:
    """Copy the source, unless that was done, and restore what a mutant left in it."""
    if not copy.exists():
        mutant_runs.copy_source(ROOT, copy)
    mutant_runs.restore(copy)


def check(options: argparse.Namespace) -> bool:
    """Run the tests that are said to kill survivors; return whether each does."""
    _make_copy(options.copy)
    killed = []
    for judged in json.loads(JUDGED.read_text()):
        if test := judged.get("added") or judged.get("other"):
            text = (options.copy / judged["module"]).read_text()
            mutation = _nearest(text, judged)
            with mutant_runs.mutated(options.copy, judged["module"], mutation.apply(text)):
                outcome = mutant_runs.run(options.copy, [test], defaultdict(float))
            killed.append(outcome.outcome == "killed" and outcome.tests == 1)
            print("killed" if killed[-1] else "SURVIVED", test, flush=True)
    return all(killed)


def _nearest(text: str, judged: Record) -> Mutation:
    """Find a mutation in a module that may have changed since."""
    change = (judged["old"], judged["new"])
    same = [m for m in mutations(text) if (m.original(text), m.code) == change]
    place = judged["line"], judged["column"]
    return min(same, key=lambda m: (abs(m.line - place[0]), abs(m.column - place[1])))


def _totals(found: Record, group: Group) -> Record:
    """Return a results file with its totals, which come first."""
    done = found["mutants"]
    outcomes = Counter(record["outcome"] for record in done)
    return {
        "version": _version(),
        "source": group.source(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "sizes": {module: len(draw(0, 10**9, [module])) for module in group.modules},
        "seeds": sorted({record["seed"] for record in done}),
        "seconds": round(sum(record["seconds"] for record in done)),
        "outcomes": dict(outcomes),
        "mutants": done,
    }


def _version() -> str:
    """Read the version of the package, which this process must not import."""
    text = (ROOT / "packit_sim" / "core" / "version.py").read_text()
    return re.findall('__version__ = "(.*)"', text)[0]


def table(found: Record) -> str:
    """Write the table of the page: a row for each module, and one for all."""
    from benchmarks.common import markdown_table  # imports ours, which children must not inherit

    judged = {_place(record): record for record in json.loads(JUDGED.read_text())}
    records = [record | judged.get(_place(record), {}) for record in found["mutants"]]
    rows = {
        "all": records,
        **{module: [r for r in records if r["module"] == module] for module in found["sizes"]},
    }
    sizes = found["sizes"]
    whole = sum(sizes.values())
    return markdown_table(
        HEAD, [_row(name, sizes.get(name, whole), own) for name, own in rows.items() if own]
    )


def _row(name: str, size: int, records: list[Record]) -> tuple[object, ...]:
    survived = [record for record in records if record["outcome"] == "survived"]
    killed = len(records) - len(survived)
    timeouts = sum(record["outcome"] == "timeout" for record in records)
    judged = [sum(key in record for record in survived) for key in KINDS]
    share = f"{killed} ({killed / len(records):.0%})"
    counts = (size, len(records), share, timeouts, len(survived))
    label = f"`{name}`" if name != "all" else name
    return label, *counts, *judged, len(survived) - sum(judged)


def _write(file: Path, result: Record | list[Record]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(result, indent=1) + "\n")
    os.replace(part, file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", choices=GROUPS, default="game", help="what to mutate")
    parser.add_argument("--seed", type=int, default=1, help="what to draw the mutants from")
    parser.add_argument("--count", type=int, default=400, help="mutants of this seed")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after that")
    parser.add_argument("--judge", action="store_true", help="run all tests on the survivors")
    parser.add_argument("--check", action="store_true", help="only run the survivors' tests")
    parser.add_argument("--table", action="store_true", help="only write the table of the page")
    parser.add_argument("--out", type=Path, help="results file")
    parser.add_argument(
        "--copy", type=Path, help="folder of the copied source; reused if it exists"
    )
    options = parser.parse_args()
    name = GROUPS[options.of].name
    options.out = options.out or RESULTS / f"{name}.json"
    if options.table:
        from benchmarks.common import write_into_page

        page = ROOT / "docs" / "trust" / "mutants.md"
        write_into_page(page, table(json.loads(options.out.read_text())), name)
        return
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        options.copy = options.copy or Path(folder) / "copy"
        if options.judge:
            judge(options)
        elif not options.check:
            campaign(options)
        elif not check(options):
            sys.exit("a test does not kill its mutant")


if __name__ == "__main__":
    main()
