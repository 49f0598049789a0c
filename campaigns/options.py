"""Pack with every pair of options of `packit pack`, and verify each packing.

    .venv/bin/python -m campaigns.options                  (about an hour of one core)
    .venv/bin/python -m campaigns.options --pairs 50       (50 random ones)
    .venv/bin/python -m campaigns.options --having=--balance
    .venv/bin/python -m campaigns.options --table

Two options must give a packing that `packit verify` accepts, or be refused by one line. Anything
else is wrong: another exit code, more lines, a packing that does not verify, or no end. Writes
`campaigns/results/options.json`, with the lines of all refusals; --table writes the table of the
page.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.common import machine, markdown_table, write_into_page, write_json
from campaigns.common import PAGES, argument_parser, read_results
from campaigns.packings.shapes import box, bracket, cup, extruded
from packit_sim.core.version import __version__

NAME = "options"

LONGEST = 300.0
"""Seconds after which a trial counts as wrong; the first one may have to compile kernels."""

PARTS = "list.csv"

BOX = "--box 60x50x40mm"

COMMON = f"{BOX} --iterations 3 --workers 1"
"""Options of each trial, unless it has others of the same names."""

CONTAINERS = ("--container", "--box")

OPTIONS = (
    *("--container cylinder:60x40mm", "--container case.stl", "--container prusa-mini"),
    *("--box A:60x50x40mm", "--box boxes.csv"),
    *(f"--objective {name}" for name in ("count", "value", "height", "boxes")),
    *("--clearance 1mm", "--clearance 1mm --clearance-z 2mm"),
    *("--wall-clearance 1mm", "--wall-clearance sides=1mm,floor=0.5mm,top=0"),
    *(f"--rotations {name}" for name in ("fixed", "upright", "axis-4", "free")),
    *("--max-tilt 20deg", "--down z-,z+", "--keep-out corner.stl", "--fixed block.stl"),
    *("--removable", "--insertable", "--separable", "--stable 2mm"),
    *("--door x+", "--order delivery", "--boxes 2"),
    *("--max-mass 20g", "--max-parts 5", "--balance 20%"),
    *(f"--groups {name}" for name in ("together", "apart", "kit")),
    *("--even", "--powder 0.45:20%", "--unit in", "--up y", "--separate", "--joined"),
    *("--accuracy 1mm", "--instructions", "--film", "--require-all", "--seed 3", "--time 1s"),
    *("cup.stl=max", "cup.stl=fill", "loads.csv"),
)
"""Options with values, and parts of their own kinds."""


ALL = "all pairs"

OUTCOMES = ("packed", "refused", "wrong")


def make_inputs(folder: Path) -> None:
    """Write some parts, their list, and the volumes that options name."""
    folder.mkdir(parents=True, exist_ok=True)
    shapes = {
        "plate": box((30, 20, 5)),
        "cup": cup(7, 5, 18, 2, 16),
        "wedge": extruded([(0, 0), (20, 0), (0, 12)], 15),
        "angle": bracket(24, 22, 6, 8),
        "corner": box((6, 6, 6)),
        "case": box((60, 50, 40)),
    }
    meshes = {name: trimesh.Trimesh(one.vertices, one.triangles) for name, one in shapes.items()}
    meshes["block"] = meshes["corner"].copy().apply_translation((52, 42, 1))
    for name, mesh in meshes.items():
        mesh.export(folder / f"{name}.stl")
    (folder / PARTS).write_text(
        "file,count,value,mass,group,stop,priority,unit\n"
        "plate.stl,2,5,6,a,1,0,mm\ncup.stl,3,1,1,a,1,0,mm\n"
        "wedge.stl,2,3,4,b,2,1,mm\nangle.stl,2,2,4,c,2,0,mm\n"
    )
    (folder / "loads.csv").write_text(
        "file,count,mass,no_stack,max_load,group,stop,unit\n"
        "corner.stl,2,1,yes,,b,1,mm\ncup.stl,1,1,no,2,c,2,mm\n"
    )
    (folder / "boxes.csv").write_text("box,name,count\n40x40x40mm,small,1\n60x50x40mm,large,1\n")


def command(pair: tuple[str, str]) -> list[str]:
    """Return the words that pack with two options."""
    options = [option for option in pair if option.startswith("--")]
    sources = [option for option in pair if not option.startswith("--")]
    given = {option.split()[0] for option in options}
    common = COMMON
    if given & set(CONTAINERS):
        common = common.removeprefix(BOX)
    if "--time" in given:
        common = common.replace("--iterations 3", "")
    return ["pack", PARTS, *sources, *common.split(), *" ".join(options).split(), "--out", "out"]


def tried(pair: tuple[str, str], inputs: Path) -> dict[str, Any]:
    """Pack with two options in a new folder, and verify the packing.

    Returns
    -------
    dict of str to object
        The options, the outcome ("packed", "refused" or "wrong"), what was said of it, and seconds.
    """
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="packit-options-") as name:
        folder = Path(name)
        shutil.copytree(inputs, folder, dirs_exist_ok=True)
        code, errors = _run(command(pair), folder)
        outcome, text = "packed", ""
        if code == 0 or (code == 1 and not errors and "--require-all" in pair):
            code, errors = _run(["verify", "out/packing.json"], folder)
            if code:
                said = (folder / "stdout.txt").read_text(errors="replace").strip()
                outcome, text = "wrong", f"does not verify: {errors or said}"
        elif code in (1, 2) and errors.startswith(("error: ", "warning: ")) and "\n" not in errors:
            outcome, text = "refused", errors
        else:
            outcome, text = "wrong", f"exit code {code}: {errors[-600:]}"
    seconds = round(time.monotonic() - started, 1)
    return {"options": pair, "outcome": outcome, "text": text, "seconds": seconds}


def _run(words: list[str], folder: Path) -> tuple[int | None, str]:
    """Run `packit` in a fork of this process; return its exit code, or None, and its errors."""
    child = multiprocessing.get_context("fork").Process(target=_packit, args=(words, folder))
    child.start()
    child.join(LONGEST)
    if child.exitcode is None:
        child.kill()
        child.join()
        return None, f"not done after {LONGEST:g} s"
    return child.exitcode, (folder / "stderr.txt").read_text(errors="replace").strip()


def _packit(words: list[str], folder: Path) -> None:
    from packit_sim.cli.app import main as packit

    os.chdir(folder)
    with open("stdout.txt", "w") as output, open("stderr.txt", "w") as errors:
        os.dup2(output.fileno(), 1)
        os.dup2(errors.fileno(), 2)
        sys.stdout, sys.stderr = output, errors
        sys.argv = ["packit", *words]
        try:
            packit()
        except Exception:
            traceback.print_exc()
            sys.exit(70)


def totals(trials: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Count the outcomes of each option, and of all pairs."""
    rows: dict[str, Counter[str]] = {option: Counter() for option in OPTIONS}
    for trial in trials:
        for option in trial["options"]:
            rows[option][trial["outcome"]] += 1
    rows[ALL] = Counter(trial["outcome"] for trial in trials)
    return {name: dict(row) for name, row in rows.items()}


def table(result: dict[str, Any]) -> str:
    """Write the table of the page: a row for each option."""
    rows = []
    for name, row in result["outcomes"].items():
        label = f"**{name}**" if name == ALL else f"`{name}`"
        counts = [row.get(outcome, 0) for outcome in OUTCOMES]
        rows.append((label, sum(counts), *counts))
    return markdown_table(("option", "pairs", "packed, verified", "refused", "wrong"), rows)


def main() -> None:
    """Run the campaign, or write its table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--pairs", type=int, help="random pairs; default: all")
    parser.add_argument("--having", default="", help="only pairs with an option that begins so")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    if arguments.table:
        page = PAGES / "packings.md"
        write_into_page(page, table(read_results(NAME, arguments.out)), NAME)
        return
    pairs = [
        pair
        for pair in itertools.combinations(OPTIONS, 2)
        if any(option.startswith(arguments.having) for option in pair)
    ]
    if arguments.pairs is not None:
        chosen = np.random.default_rng(arguments.seed).permutation(len(pairs))[: arguments.pairs]
        pairs = [pairs[n] for n in sorted(chosen)]
    trials = []
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory(prefix="packit-options-") as folder,
        ProcessPoolExecutor(arguments.jobs, mp_context=context) as pool,
    ):
        inputs = Path(folder)
        make_inputs(inputs)
        for future in as_completed([pool.submit(tried, pair, inputs) for pair in pairs]):
            trials.append(future.result())
            if trials[-1]["outcome"] == "wrong":
                print(*trials[-1]["options"], trials[-1]["text"], sep="\n    ", flush=True)
            if len(trials) % 50 == 0:
                print(f"{len(trials)} of {len(pairs)}", flush=True)
    trials.sort(key=lambda trial: trial["options"])
    outcomes = totals(trials)
    result = {
        "version": __version__,
        "machine": machine(),
        "outcomes": outcomes,
        "said": [trial for trial in trials if trial["text"]],
    }
    write_json(arguments.out / f"{NAME}.json", result)
    print(outcomes[ALL])


if __name__ == "__main__":
    main()
