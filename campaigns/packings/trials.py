"""A trial: a case is made, packed and checked."""

from __future__ import annotations

import json
import shutil
import sys
import time
import traceback
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

from campaigns.packings.cases import Case, make
from campaigns.packings.checker import check
from campaigns.packings.truth import Problem
from packit_sim import PackSettings, pack
from packit_sim.core.errors import PackItError
from packit_sim.parts.filling import box_nesting
from packit_sim.parts.nesting.nest import NestSettings
from packit_sim.parts.nesting.settings import SearchSettings
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.results import exports, pictures

ITERATIONS = 5
"""Passes over the parts of each search."""

SECONDS = 2.0
"""Time limit of each search, in seconds."""

BY_CELLS = SearchSettings(most_fields=0)
"""Settings of a search by cells, however few different parts there are."""


def begin() -> None:
    """Leave out the pictures of packings, which take most of the time and are not checked."""
    drawn = pictures.draw

    def blank(_: object, path: Path, *__: object) -> None:
        path.write_bytes(b"")

    for module in (exports, *sys.modules.values()):
        if getattr(module, "draw", None) is drawn:
            setattr(module, "draw", blank)  # noqa: B010


def packed(case: Case, seed: int, out: Path) -> None:
    """Pack a case by the product."""
    settings = PackSettings(
        **case.settings, workers=1, iterations=ITERATIONS, reading=ReadSettings(**case.reading)
    )
    objective: Any = case.objective
    nest_settings = partial(NestSettings, search=BY_CELLS if case.by_cells else SearchSettings())
    with patch.object(box_nesting, "NestSettings", nest_settings):
        pack(case.sources, case.boxes, objective, SECONDS, seed, out, settings=settings)


def tried(seed: int, work: Path) -> dict[str, Any]:
    """Make, pack and check a case; its folder is kept if anything is wrong.

    Returns
    -------
    dict of str to object
        The number of parts of each format, and the problems, for the results file.
    """
    folder, started = work / str(seed), time.perf_counter()
    shutil.rmtree(folder, ignore_errors=True)
    case, count = make(seed, folder), 0
    try:
        packed(case, seed, folder / "out")
        problems = check(case.truth, folder / "out")
        refused = verify_packing(folder / "out" / "packing.json").problems
        problems += [Problem(f"packit verify: {text}") for text in refused[:3]]
        count = len(json.loads((folder / "out" / "packing.json").read_text())["items"])
    except PackItError as error:
        text = f"{type(error).__name__}: {error}".replace(str(folder), "")
        has_no_space = case.truth.keep_out is not None and "nothing is packed" in text
        problems = [] if has_no_space else [Problem(text)]
    except Exception:
        problems = [Problem(traceback.format_exc().replace(str(folder), "")[-600:])]
    if not problems:
        shutil.rmtree(folder)
    return _trial(case, time.perf_counter() - started, count, problems)


def lost(seed: int, work: Path, text: str) -> dict[str, Any]:
    """Return the trial of a case whose process has ended or takes too long."""
    return _trial(make(seed, work / str(seed)), 0.0, 0, [Problem(text)])


def _trial(case: Case, seconds: float, count: int, problems: list[Problem]) -> dict[str, Any]:
    return {
        "seconds": round(seconds, 1),
        "list": case.truth.list_kind,
        "by cells": case.by_cells,
        "of bricks": case.of_bricks,
        "around a keep-out": case.truth.keep_out is not None,
        "separable": case.settings["separable"],
        "parts": dict(Counter(part.kind for part in case.truth.parts)),
        "packed": count,
        "problems": [vars(each) for each in problems],
    }
