"""Finished searches: their numbers, and their packings in files."""

from __future__ import annotations

import gzip
import json
import re
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from benchmarks.common import machine, write_json
from benchmarks.nesting.cases import CASES, Case, needs_data
from packit_sim import NestSettings, Packing, nest
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS, SearchSettings
from packit_sim.parts.packings.placements import Placement


def file_stem(name: str) -> str:
    """Return a name in letters, digits and hyphens alone."""
    return re.sub(r"[^A-Za-z0-9-]+", "-", name)


@dataclass(frozen=True)
class Search:
    """What is searched, and for how long.

    Attributes
    ----------
    kind, name, rotations : str
        The problem (see `cases`).
    seed : int
        The seed.
    seconds : float
        The time: processor seconds of each worker.
    """

    kind: str
    name: str
    rotations: str
    seed: int
    seconds: float

    @classmethod
    def of(cls, run: dict[str, Any]) -> Search:
        """Return the search of a result."""
        return cls(**{name: run[name] for name in cls.__dataclass_fields__})

    @property
    def key(self) -> str:
        """The name of its result."""
        return f"{self.kind}, {self.name}, {self.rotations}, {self.seed}, {self.seconds:g} s"

    @property
    def file(self) -> str:
        """The name of the file of its packing."""
        return file_stem(self.key) + ".json.gz"


class Results:
    """The results in a folder; each is written at once.

    Parameters
    ----------
    folder : Path
        The folder.
    data : Path, optional
        The folder of the literature's instances, whose packings can't be read without it.
    """

    def __init__(self, folder: Path, data: Path | None = None) -> None:
        self.file = folder / "nesting.json"
        self.packings = folder / "nesting"
        self.data = data

    def read(self) -> dict[str, dict[str, Any]]:
        """Return the finished searches by their keys."""
        if not self.file.exists():
            return {}
        runs: dict[str, dict[str, Any]] = json.loads(self.file.read_text())["runs"]
        return runs

    def add(self, search: Search, result: dict[str, Any], packing: Packing) -> None:
        """Add a finished search and its packing."""
        self.packings.mkdir(parents=True, exist_ok=True)
        placements = [[p.type, p.box, *p.matrix[:3].ravel().tolist()] for p in packing.placements]
        text = json.dumps({"search": asdict(search), "placements": placements})
        (self.packings / search.file).write_bytes(gzip.compress(text.encode(), mtime=0))
        runs = {**self.read(), search.key: {**asdict(search), **result}}
        content = {"command": "python -m benchmarks.nesting", "machine": machine()}
        write_json(self.file, {**content, "runs": dict(sorted(runs.items()))})

    def verify(self) -> list[str]:
        """Check the readable packings again by their meshes; return a sentence for each problem."""
        found = []
        for key, run in self.read().items():
            if self.is_readable(Search.of(run)):
                found += [f"{key}: {problem}" for problem in self._problems(Search.of(run), run)]
        return found

    def is_readable(self, search: Search) -> bool:
        """Return whether the meshes of a search are there."""
        return self.data is not None or not needs_data(search.kind, search.name)

    def packing(self, search: Search) -> Packing:
        """Read the packing of a finished search; raise OSError if its file is missing."""
        content = json.loads(gzip.decompress((self.packings / search.file).read_bytes()))
        placements = []
        for item_type, box, *numbers in content["placements"]:
            pose = np.vstack((np.reshape(numbers, (3, 4)), (0, 0, 0, 1)))
            placements.append(Placement.from_matrix(item_type, pose, box))
        case = CASES[search.kind](search.name, search.rotations, self.data)
        return replace(_empty(case), placements=tuple(placements))

    def best_before(self, search: Search) -> Search:
        """Return the search of the same problem, and of less time, with the best result."""
        of = (search.kind, search.name, search.rotations)
        runs = [
            run
            for run in self.read().values()
            if (run["kind"], run["name"], run["rotations"]) == of
            and run["seconds"] < search.seconds
        ]
        if not runs:
            raise SystemExit(f"{search.key}: no search of less time has a result to resume from")
        sign = -1 if search.kind == "knapsacks" else 1
        return Search.of(min(runs, key=lambda run: sign * float(run["score"])))

    def _problems(self, search: Search, run: dict[str, Any]) -> list[str]:
        try:
            packing = self.packing(search)
        except FileNotFoundError as error:
            return [f"{error.filename} is missing"]
        found = _checked(packing)
        if abs(score(packing) - run["score"]) > 1e-9:
            found.append(f"the score is {score(packing)}, not {run['score']}")
        return found


def score(packing: Packing) -> float:
    """Return the number that counts: a strip's height, a knapsack's density, or the boxes."""
    if packing.objective == "strip":
        return packing.height
    return packing.density if packing.objective == "knapsack" else float(packing.boxes)


def run(
    search: Search,
    workers: int,
    settings: SearchSettings = DEFAULT_SETTINGS,
    data: Path | None = None,
    start: tuple[Packing, float] | None = None,
) -> tuple[dict[str, Any], Packing]:
    """Search.

    Parameters
    ----------
    search : Search
        What is searched.
    workers : int
        The number of processes.
    settings : SearchSettings
        The settings of the search.
    data : Path, optional
        The folder of the literature's instances.
    start : Packing and float, optional
        What the search resumes from, and of how many of its seconds that is the result.

    Returns
    -------
    result : dict
        Its numbers; `curve` has the seconds and the score of each better packing.
    packing : Packing
        The packing.
    """
    case = CASES[search.kind](search.name, search.rotations, data)
    curve: list[tuple[float, float]] = []
    first, spent = start or (None, 0.0)
    before = time.perf_counter()
    packing = nest(
        case.types,
        case.container,
        case.objective,
        search.seconds - spent,
        search.seed,
        case.clearance,
        callback=lambda found, seconds: curve.append((round(spent + seconds, 2), score(found))),
        settings=NestSettings(workers=workers, clock="processor", search=settings, start=first),
    )
    elapsed = time.perf_counter() - before
    result: dict[str, Any] = {
        "workers": workers,
        "score": score(packing),
        "density": packing.density,
        "items": len(packing.placements),
        "valid": not _checked(packing),
        "clock": "processor",
        "elapsed": elapsed,
        "curve": curve,
        "others": case.others,
    }
    if case.clearance:
        result |= {"clearance": case.clearance, "smallest distance": smallest_distance(packing)}
    return result, packing


def run_all(
    searches: Sequence[Search],
    results: Results,
    workers: int,
    beginnings: int | None = None,
    resumes: bool = False,
) -> None:
    """Search what has no result yet, and print each result.

    Parameters
    ----------
    beginnings : int, optional
        How often a long search for a strip begins at most.
    resumes : bool
        Whether each search resumes from the best packing of the same problem, whose search took
        less time.
    """
    settings = DEFAULT_SETTINGS
    noted: dict[str, Any] = {}
    if beginnings is not None:
        settings = replace(settings, most_beginnings=beginnings)
        noted["beginnings"] = beginnings
    for search in searches:
        if search.key in results.read():
            print(f"{search.key}: done before")
            continue
        start = None
        if resumes:
            before = results.best_before(search)
            start = results.packing(before), before.seconds
            noted["resumed from"] = before.key
        result, packing = run(search, workers, settings, results.data, start)
        result |= noted
        results.add(search, result, packing)
        others = ", ".join(f"{name} {value:g}" for name, value in result["others"].items())
        print(f"{search.key}: {result['score']:.4f} (density {result['density']:.3f}); {others}")


def smallest_distance(packing: Packing) -> float:
    """Measure the smallest distance between two items of one box with FCL, through trimesh."""
    manager = CollisionManager()
    for n, placement in enumerate(packing.placements):
        mesh = Trimesh(packing.vertices(placement), packing.types[placement.type].faces)
        manager.add_object(str(n), mesh)
    distance: float = manager.min_distance_internal()
    return distance


def _empty(case: Case) -> Packing:
    return Packing(case.types, case.container, (), case.clearance, case.objective)


def _checked(packing: Packing) -> list[str]:
    found = packing.problems()
    if packing.objective != "knapsack" and any(packing.left_out):
        found.append("not all items are placed")
    return found
