"""Mutation testing: whether the tests notice small changes of the code.

Draws mutants of the modules that decide what is feasible and what is stored, runs for each the
tests that execute the changed line, and writes what they found after each mutant. A second run with
the same seed continues; other seeds add to the totals.

    python -m campaigns.mutants --seed 1 --count 400
    python -m campaigns.mutants --again     # survivors once more, after tests were added
    python -m campaigns.mutants --table     # write the table in docs/trust/mutants.md
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import re
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from campaigns import mutant_runs
from campaigns.mutations import Mutation, mutations

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results" / "mutants.json"

_GEOMETRY = ("rotations", "voxels", "voxelization", "voxel_kernels", "voxelization_kernels")
_ENGINE = (
    *("feasibility", "screening", "screening_kernels", "collision", "nofit", "occupancy"),
    *("occupancy_kernels", "oracle", "containment", "containment_kernels"),
)
MODULES = (
    *(f"packit_sim/geometry/{name}.py" for name in (*_GEOMETRY, "word_kernels")),
    *(f"packit_sim/engine/{name}.py" for name in _ENGINE),
    "packit_sim/box.py",
    *(f"packit_sim/datasets/{name}.py" for name in ("packs", "pack_files", "pack_checks")),
    "packit_sim/evaluation/results.py",
    "packit_sim/rules.py",
)
"""The modules that are mutated. `packit_sim/placement.py` only names others' functions."""

_TESTS = (
    *("rotations", "voxels", "shapes", "poses", "placement", "containment", "nofit", "insertion"),
    *("off_grid", "witness", "compaction", "disassembly", "caches", "box", "unchanged", "episode"),
    *("packs", "old_format", "original", "verification", "rules", "evaluation", "manifests"),
    *("forged_results", "terminal"),
)
TESTS = tuple(f"tests/test_{name}.py" for name in _TESTS)
"""The files of tests that are run."""

_OWN = {
    "voxel": ("voxels",),
    "voxelization": ("voxels",),
    "word": ("voxels",),
    "oracle": ("placement", "containment"),
    "feasibility": ("placement", "nofit"),
    "screening": ("placement", "nofit"),
    "collision": ("placement", "containment"),
    "occupancy": ("off_grid", "box", "placement"),
    "pack_files": ("packs", "verification"),
    "pack_checks": ("verification",),
    "results": ("evaluation", "forged_results", "manifests"),
}
"""Names of test files for modules that have no file of the same name."""

SECONDS = 10.0
"""Processor time of the tests of one mutant, measured without it; the slowest are left out."""

Record = dict[str, Any]


def draw(seed: int, count: int, modules: Sequence[str] = MODULES) -> list[tuple[str, Mutation]]:
    """Draw mutants at random, without repetition; a larger count extends the list."""
    mutants = [
        (module, mutation)
        for module in modules
        for mutation in mutations((ROOT / module).read_text())
    ]
    random.Random(seed).shuffle(mutants)
    return mutants[:count]


def plan(
    baseline: mutant_runs.Baseline, copy: Path, mutant: tuple[str, Mutation], kills: Counter[str]
) -> list[str]:
    """Choose the tests of a mutant, in the order in which they are run.

    Parameters
    ----------
    baseline : Baseline
        What the tests do without a mutant.
    copy : Path
        The copy of the source.
    mutant : tuple
        Module and mutation.
    kills : Counter
        Numbers of mutants of the module that each test killed so far.

    Returns
    -------
    list of str
        Tests that execute the line; of a line that runs at the import, those that use the module;
        of a compiled line, which is not traced, those that use a module that calls it. The first
        are those that killed most, then those of the module's own files. Tests of a file stay
        together, since they share what they prepare.
    """
    module, mutation = mutant
    name = Path(module).stem.removesuffix("_kernels")
    tests: set[str] = set()
    if module.endswith("_kernels.py"):
        compiled = mutant_runs.kernel_modules(copy, module)
        for caller, lines in baseline.lines.items():
            if any(_imports(copy / caller, own) for own in compiled):
                tests |= set(lines[0])
    else:
        lines = baseline.lines[module]
        for line in range(mutation.line, mutation.end[0] + 1):
            tests |= set(lines.get(line, []))
        tests = tests or set(lines[0])
    own = tuple(f"tests/test_{file}.py" for file in (name, *_OWN.get(name, ())))
    seconds = baseline.seconds
    killers = [test for test, _ in kills.most_common(5) if test in tests]
    chosen = list(_affordable(sorted(tests, key=lambda t: seconds[t]), seconds))
    number = {test: n for n, test in enumerate(seconds)}
    of_file: defaultdict[str, float] = defaultdict(float)
    for test in chosen:
        of_file[_file(test)] += seconds[test]
    chosen.sort(key=lambda t: (_file(t) not in own, of_file[_file(t)], _file(t), number[t]))
    return list(dict.fromkeys([*killers, *chosen]))


def _file(test: str) -> str:
    return test.split("::")[0]


def _affordable(tests: Sequence[str], seconds: dict[str, float]) -> Iterator[str]:
    left = SECONDS
    for test in tests:
        left -= seconds[test]
        if left > 0:
            yield test


def _imports(file: Path, module: str) -> bool:
    name = Path(module).stem
    text = file.read_text()
    return f".{name} import " in text or f" import {name}\n" in text


def campaign(options: argparse.Namespace) -> None:
    """Run the mutants that are not in the results file yet."""
    found: Record = json.loads(options.out.read_text()) if options.out.exists() else {"mutants": []}
    done: list[Record] = found["mutants"]
    copy: Path = options.copy
    if not copy.exists():
        mutant_runs.copy_source(ROOT, copy)
    mutant_runs.restore(copy)
    baseline = mutant_runs.measure(copy, MODULES, TESTS)
    print(f"{len(baseline.seconds)} tests take {sum(baseline.seconds.values()):.0f} s", flush=True)
    mutant_runs.import_libraries(baseline.libraries)
    kills: dict[str, Counter[str]] = {module: Counter() for module in MODULES}
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
        if record not in done:
            done.append(record)
        _write(options.out, _totals(found))
        print(f"{len(done)}", *(record[key] for key in _PRINTED), flush=True)


_PRINTED = ("module", "line", "old", "new", "outcome", "test", "tests", "seconds")


def _left(
    options: argparse.Namespace, done: list[Record]
) -> Iterator[tuple[tuple[str, Mutation], Record]]:
    """List the mutants to run, and what is known of them."""
    drawn = draw(options.seed, options.count)
    known = {(r["seed"], r["module"], r["line"], r["column"], r["new"]): r for r in done}
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
        key = (options.seed, module, mutation.line, mutation.column, mutation.code)
        if key not in known:
            yield (module, mutation), record
        elif options.again and known[key]["outcome"] == "survived":
            known[key]["first"] = "survived"
            yield (module, mutation), known[key]


def _totals(found: Record) -> Record:
    """Return a results file with its totals, which come first."""
    done = found["mutants"]
    outcomes = Counter(record["outcome"] for record in done)
    return {
        "version": _version(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "mutants_of_the_modules": len(draw(0, 10**9)),
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
    records = found["mutants"]
    rows = {
        "all": records,
        **{module: [r for r in records if r["module"] == module] for module in MODULES},
    }
    sizes = {module: len(draw(0, 10**9, [module])) for module in MODULES}
    lines = [
        "| module | mutants | drawn | killed at first | by time limit | survived | equivalent "
        "| tests added | left |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, own in rows.items():
        if own:
            lines.append(_row(name, sizes.get(name, sum(sizes.values())), own))
    return "\n".join(lines) + "\n"


def _row(name: str, size: int, records: list[Record]) -> str:
    first = [r for r in records if r["outcome"] != "survived" and "first" not in r]
    timeouts = sum(r["outcome"] == "timeout" for r in first)
    survived = len(records) - len(first)
    closed = sum("first" in r and r["outcome"] != "survived" for r in records)
    equivalent = sum("reason" in r and r["outcome"] == "survived" for r in records)
    killed = f"{len(first)} ({len(first) / len(records):.0%})"
    counts = (size, len(records), killed, timeouts, survived, equivalent, closed)
    cells = [f"`{name}`" if name != "all" else name, *counts, survived - equivalent - closed]
    return f"| {' | '.join(map(str, cells))} |"


def _write(file: Path, result: Record) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(result, indent=1) + "\n")
    os.replace(part, file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1, help="what to draw the mutants from")
    parser.add_argument("--count", type=int, default=400, help="mutants of this seed")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after that")
    parser.add_argument("--again", action="store_true", help="run survivors again")
    parser.add_argument("--table", action="store_true", help="only write the table of the page")
    parser.add_argument("--out", type=Path, default=RESULTS, help="results file")
    parser.add_argument(
        "--copy", type=Path, help="folder of the copied source; reused if it exists"
    )
    options = parser.parse_args()
    if options.table:
        from campaigns.common import (
            write_into_page,
        )  # imports ours, which children must not inherit

        write_into_page("mutants", table(json.loads(options.out.read_text())))
        return
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        options.copy = options.copy or Path(folder) / "copy"
        campaign(options)


if __name__ == "__main__":
    main()
