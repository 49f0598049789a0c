"""Trials: a forged record is verified, resumed, and judged."""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from random import Random
from typing import NamedTuple

from campaigns.forgeries.cases import Case, cases
from campaigns.forgeries.changes import BYTES, CHANGES, FILES, TREE, forged
from campaigns.forgeries.judge import Judge
from campaigns.forgeries.memory import remembered
from campaigns.forgeries.values import Wrong
from packit_sim.core.errors import PackItError
from packit_sim.parts.results.resuming import read_earlier
from packit_sim.parts.results.verification import REQUEST, verify_record

KINDS = (*CHANGES, TREE, BYTES)


class Trial(NamedTuple):
    """What became of a forgery.

    Attributes
    ----------
    outcome : str
        "verified", "refused", or "named": verified, but for what was named as not checked.
    judged : str
        "right", "wrong", "open", "unstated" or "absent", see `Verdict`.
    faults : tuple of str
        What was not right.
    resumed : int
        How many parts were resumed.
    """

    kind: str
    outcome: str
    judged: str
    faults: tuple[str, ...]
    resumed: int


def trials(numbers: Iterable[int], seed: int) -> list[Trial]:
    """Try forgeries, each kind in turn, and remember what is computed from the same meshes."""
    logging.getLogger("packit_sim").setLevel(logging.ERROR)  # each part that is not resumed
    with tempfile.TemporaryDirectory() as name, remembered():
        own = cases(Path(name) / "cases")
        work = Path(name) / "work"
        return [tried(KINDS[n % len(KINDS)], own, f"{seed}/{n}", work) for n in numbers]


def tried(kind: str, among: Sequence[Case], seed: str, work: Path) -> Trial:
    """Forge a record, verify and resume it, and judge both."""
    rng = Random(seed)
    case = rng.choice(among)
    folder = case.folder
    if kind in FILES:
        shutil.rmtree(work, ignore_errors=True)
        folder = work / "packing"
        shutil.copytree(case.folder, folder)
    data = forged(kind, case.record, folder, rng)
    file = folder / "packing.json"
    file.write_bytes(data)
    judge = Judge(folder, case.record)
    judged, why = judge.verdict(data)
    faults = []
    try:
        report = verify_record(file)
        outcome = "refused" if report.problems else "named" if report.unchecked else "verified"
        said = str(report.problems[0]) if report.problems else ""
        if outcome == "named" and judged in ("right", "absent") and REQUEST in report.unchecked:
            faults.append("what was asked for is not read")
    except PackItError as error:
        outcome, said = "refused", str(error)
    except Exception as error:
        outcome, said = "refused", ""
        faults.append(f"{type(error).__name__}: {error}")
    if outcome == "verified" and judged in ("wrong", "unstated", "absent"):
        faults.append(f"verified, but {why or judged}")
    if outcome == "named" and judged == "wrong":
        faults.append(f"not refused, but {why}")
    if outcome == "refused" and judged in ("right", "absent"):
        faults.append(f"refused: {said}")
    resumed, more = _resumed(case, file)
    return Trial(kind, outcome, judged, (*faults, *more), resumed)


def _resumed(case: Case, file: Path) -> tuple[int, list[str]]:
    """Resume, and judge what remains by what was asked for."""
    try:
        packed = read_earlier(file.parent, case.packed.task)
    except PackItError:
        return 0, []
    except Exception as error:
        return 0, [f"resuming: {type(error).__name__}: {error}"]
    if packed is None:
        return 0, []
    judge = Judge(case.folder, case.record)
    request = case.record["request"]
    meshes = {each["name"]: judge.mesh(each) for each in request["parts"] if each["mesh"]}
    items = [
        (packed.part(one).part.name, number, packed.pose(one))
        for number, packing in enumerate(packed.packings)
        for one in packing.placements
    ]
    names = [packing.container.name for packing in packed.packings]
    try:
        judge.places(request, items, names, meshes)
        judge.counts(request, [name for name, _, _ in items], names)
        placed = [(name, box, meshes[name].moved(pose)) for name, box, pose in items]
        judge.groups(request, placed)
        judge.deliveries(request, placed)
        judge.limits(request, names, placed, meshes)
    except Wrong as wrong:
        return len(items), [f"resumed, but {wrong}"]
    return len(items), []
