"""Hostile files: coverage-guided fuzzing of all readers of files that may come from strangers.

Each file must be read, or refused with a `PackItError` whose message is one clean line, within
bounds of time and memory. What goes wrong otherwise is reduced and saved in `tests/hostile`, where
a test reads it again. A second run with another seed adds to the results. Needs the extra
`campaign`.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import time
from functools import partial
from pathlib import Path

import atheris

from benchmarks.common import machine, write_json
from campaigns.common import ROOT, argument_parser, read_results

for _file in sorted((ROOT / "packit_sim").rglob("*_kernels.py")):  # numba compiles them as they are
    importlib.import_module(".".join(_file.relative_to(ROOT).with_suffix("").parts))

_AGENTS = ROOT / "agents"
_KERNELS = [
    ".".join(file.relative_to(_AGENTS).with_suffix("").parts)
    for file in sorted(_AGENTS.rglob("*_kernels.py"))  # they import much else
]

INSTRUMENTED = ["packit_sim", "packit_agents", "trimesh", "minari", "tomllib", "zipfile"]
"""The packages whose code the fuzzer watches."""

with (
    contextlib.redirect_stderr(io.StringIO()),  # a line for each module
    atheris.instrument_imports(INSTRUMENTED, exclude=_KERNELS, enable_loader_override=False),
):
    from campaigns.fuzzing import batches, children
    from campaigns.fuzzing.reader import Reader
    from campaigns.fuzzing.readers import READERS
    from campaigns.fuzzing.reduction import reduce
    from campaigns.fuzzing.table import HOSTILE, NAME, write_table
    from campaigns.fuzzing.verdicts import MAX_ADDRESSES, MAX_MEMORY, Finding, judge
    from packit_sim.core.version import __version__

LONGEST_BATCH = 60
"""Seconds of a batch; a run of all readers takes them in turn."""


def main() -> None:
    """Fuzz, and write the results after each batch."""
    parser = argument_parser(__doc__)
    parser.add_argument("--reader", nargs="+", default=["all"], choices=("all", *READERS))
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "fuzzing")
    parser.add_argument("--found", type=Path, default=HOSTILE)
    arguments = parser.parse_args()
    if arguments.table:
        write_table()
        return
    names = READERS if "all" in arguments.reader else arguments.reader
    chosen = [READERS[name] for name in names]
    seconds = round(min(LONGEST_BATCH, max(2.0, arguments.minutes * 60 / len(chosen))))
    until = time.monotonic() + arguments.minutes * 60
    number = 0
    while time.monotonic() < until - 1:
        reader = chosen[number % len(chosen)]
        work = arguments.work / reader.name
        batch = batches.run(reader, seconds, hash((arguments.seed, number)), work)
        new = _saved(reader, work, arguments.found)
        _add(arguments.out, reader, batch, arguments.seed, new)
        rate = batch.inputs / batch.seconds
        print(
            f"{reader.name:20} {batch.inputs:8,} inputs {rate:6,.0f}/s {batch.edges:6,} edges "
            f"{new} findings",
            flush=True,
        )
        number += 1


def _saved(reader: Reader, work: Path, found: Path) -> int:
    """Reduce what a batch found, and save what was not found before; return its number."""
    new = 0
    for about in sorted((work / "found").glob("*.json")):
        file, target = about.with_suffix(".file"), found / reader.name / about.stem
        finding, data = Finding(**json.loads(about.read_text())), file.read_bytes()
        if not target.exists():
            new += 1
            print(f"{reader.name}: {finding.kind}: {finding.what} ({finding.where})", flush=True)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
            if finding.kind not in ("crash", "memory"):
                child = children.start(partial(_shorten, reader, finding, target))
                children.wait(child, batches.STUCK_SECONDS)
        about.unlink()
        file.unlink()
    return new


def _shorten(reader: Reader, finding: Finding, file: Path) -> None:
    data = file.read_bytes()
    if judge(reader, data) is not None:
        file.write_bytes(reduce(reader, data, finding))


def _add(folder: Path, reader: Reader, batch: batches.Batch, seed: int, new: int) -> None:
    """Add a batch to the results."""
    results = read_results(NAME, folder) or {"readers": {}}
    results["version"], results["machine"] = __version__, machine()
    results["bounds"] = {"memory": MAX_MEMORY, "addresses": MAX_ADDRESSES}
    row = results["readers"].setdefault(
        reader.name, {"inputs": 0, "seconds": 0.0, "edges": 0, "findings": 0, "seeds": []}
    )
    row["inputs"] += batch.inputs
    row["seconds"] = round(row["seconds"] + batch.seconds, 1)
    row["edges"] = max(row["edges"], batch.edges)
    row["findings"] += new
    row["limit"] = reader.seconds
    row["seeds"] = sorted({*row["seeds"], seed})
    write_json(folder / f"{NAME}.json", results)


if __name__ == "__main__":
    main()
