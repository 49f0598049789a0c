"""The problems: strips of the literature and of our own, tasks in a strip or box, library items."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from packit_sim import Box, BoxContainer, Item, ItemType, ShapeLibrary, load_tasks
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry import rotations as grid_rotations
from packit_sim.parts.packings.builtin_instances import builtin_instance
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES
from packit_sim.parts.packings.instances import read_instance
from packit_sim.placement import PlacedItem

DATASET, SPLIT = "everyday-v1", "test"

BOXES = 6
"""How many boxes two test tasks each make."""

BIN_ITEMS = 60

SCALES = 0.2, 0.6
"""Least and largest bounding-box diagonal of library shapes in a strip with the base 1 x 1."""

LIBRARY_SHAPES = 100

CLEARANCE = 0.01
"""As a share of the base's longer side."""

WITH_CLEARANCE = (
    "Egeblad et al. 2009/Merged3",
    "Liu et al. 2015/Experiment1",
    "Stoyan et al. 2005/Example3",
)
"""The literature's instances that are packed with a clearance."""

BUILTIN_WITH_CLEARANCE = ("gears-12", "polytopes-20")
"""The same of the built-in ones, where the literature's are missing."""

DATA_HELP = "folder of the literature's instances: `3d_irregular` of github.com/ESICUP/datasets"
"""The help of --data."""

OF_INSTANCES = ("literature", "clearance")
"""The kinds whose problems may be the literature's instances."""

MORE_ROTATIONS = "cube", "free"
"""Rotation sets with which others published nothing."""

SETS_OF_ITEMS = 10

UNIT_BOX = BoxContainer((1.0, 1.0, 1.0))

UNIT_STRIP = BoxContainer((1.0, 1.0, math.inf))


@dataclass(frozen=True, eq=False)
class Case:
    """A nesting problem with what others reached.

    Attributes
    ----------
    kind, name, rotations : str
        Which problem it is.
    types : tuple of ItemType
        The items.
    container : BoxContainer
        The box or strip.
    objective : str
        The objective of `nest`.
    others : dict of str to float
        The results of others, by their names.
    clearance : float
        The distance to keep between items.
    """

    kind: str
    name: str
    rotations: str
    types: tuple[ItemType, ...]
    container: BoxContainer
    objective: str
    others: dict[str, float] = field(default_factory=dict)
    clearance: float = 0.0


def published() -> dict[tuple[str, str], dict[str, float]]:
    """Read the heights that others published, by instance and rotation set."""
    found = {}
    for row in _rows("published.csv"):
        steps = row["rotations"]
        key = row["instance"].removesuffix(".json"), "fixed" if steps == "1" else f"axis-{steps}"
        found[key] = {
            "sparrow-3d, 60 s": float(row["sparrow3d_60s_2cores"] or math.nan),
            "sparrow-3d, 10 min": float(row["mean_10min"]),
            "sparrow-3d, best of 15": float(row["best_10min"]),
            "record before": float(row["record_before"]),
        }
    return found


def literature_names() -> list[str]:
    """List the instances that others published heights of."""
    return list(dict.fromkeys(name for name, _ in published()))


def needs_data(kind: str, name: str) -> bool:
    """Return whether a problem is an instance of the literature, which --data must provide."""
    return kind in OF_INSTANCES and name not in BUILTIN_NAMES


def literature(name: str, rotations: str, data: Path | None) -> Case:
    """Read an instance of the literature; for `cube` and `free`, others have `axis-n`."""
    types, container = _instance(name, rotations, data)
    others = heights_of_others(name, rotations)
    return Case("literature", name, rotations, types, container, "strip", others)


def heights_of_others(name: str, rotations: str) -> dict[str, float]:
    """Return the published heights of an instance by their names, if there are any."""
    known = {own: heights for (each, own), heights in published().items() if each == name}
    if known and rotations in MORE_ROTATIONS:
        return next(known[own] for own in ("axis-8", "axis-4", "fixed") if own in known)
    return known.get(rotations, {})


def builtin(name: str, rotations: str, data: Path | None) -> Case:
    """Build one of our own instances."""
    types, container, optimal = builtin_instance(name, rotations)
    others = {} if optimal is None else {"optimum": optimal.height}
    return Case("builtin", name, rotations, types, container, "strip", others)


def clearance(name: str, rotations: str, data: Path | None) -> Case:
    """Take an instance, with a clearance of 1% of the base's longer side."""
    types, container = _instance(name, rotations, data)
    distance = CLEARANCE * max(container.size[:2])
    return Case("clearance", name, rotations, types, container, "strip", clearance=distance)


def strips(name: str, rotations: str, data: Path | None) -> Case:
    """Put the items of two test tasks into a strip."""
    row = next(row for row in _rows("two-task-strips.csv") if row["box"] == name)
    others = {
        "sparrow-3d, 60 s": float(row["sparrow3d_density"]),
        "greedy": float(row["greedy_density"]),
    }
    types = _types(_two_tasks(int(name)), rotations)
    return Case("strips", name, rotations, types, UNIT_STRIP, "strip", others)


def knapsacks(name: str, rotations: str, data: Path | None) -> Case:
    """Put the items of two test tasks into the unit box."""
    types = _types(_two_tasks(int(name)), rotations)
    return Case("knapsacks", name, rotations, types, UNIT_BOX, "knapsack")


def bins(name: str, rotations: str, data: Path | None) -> Case:
    """Draw items of the test tasks for unit boxes; the greedy rule packs them as well."""
    items = [item for task in _tasks() for item in task]
    drawn = np.random.default_rng(int(name)).choice(len(items), BIN_ITEMS, replace=False)
    chosen = [items[n] for n in drawn]
    others = {"greedy": float(first_fit_decreasing(chosen))}
    return Case("bins", name, rotations, _types(chosen, rotations), UNIT_BOX, "bins", others)


def library(name: str, rotations: str, data: Path | None) -> Case:
    """Draw shapes of the built-in library, as many as the name says, of different sizes."""
    known = ShapeLibrary.open("everyday")
    rng = np.random.default_rng(0)
    drawn = rng.choice(list(known.ids), int(name), replace=False).tolist()
    items = [Item(known[each], float(rng.uniform(*SCALES))) for each in drawn]
    return Case("library", name, rotations, _types(items, rotations), UNIT_STRIP, "strip")


CASES: dict[str, Callable[[str, str, Path | None], Case]] = {
    "literature": literature,
    "builtin": builtin,
    "strips": strips,
    "knapsacks": knapsacks,
    "bins": bins,
    "clearance": clearance,
    "library": library,
}
"""The function for each kind of problem: of its name, rotation set and the folder of --data."""


def names(kind: str, data: Path | None) -> list[str]:
    """List the problems of a kind; without the literature's data, our own instances."""
    if kind == "literature":
        return literature_names()
    if kind == "builtin":
        return list(BUILTIN_NAMES)
    if kind == "clearance":
        return list(WITH_CLEARANCE if data else BUILTIN_WITH_CLEARANCE)
    if kind == "library":
        return [str(LIBRARY_SHAPES)]
    return [str(n) for n in range(SETS_OF_ITEMS if kind == "bins" else BOXES)]


def first_fit_decreasing(items: Sequence[Item]) -> int:
    """Count the boxes that a greedy rule needs.

    The largest item comes first, into the first box that has a place for it, in the rotation with
    the lowest top at its BLBF location.
    """
    boxes: list[Box] = []
    for item in sorted(items, key=lambda each: -each.volume):
        if not place_lowest(boxes, item):
            boxes.append(Box())
            is_placed = place_lowest(boxes[-1:], item)
            assert is_placed, f"{item} does not fit into an empty box"
    return len(boxes)


def place_lowest(boxes: Sequence[Box], item: Item) -> bool:
    """Put an item at the lowest place of the first box that has one; return whether there is one.

    The place is that which the rotation policy `lowest` chooses.
    """
    for box in boxes:
        if found := lowest_placement(box, item):
            box.place(*found)
            return True
    return False


def lowest_placement(box: Box, item: Item) -> tuple[Item, tuple[int, int, int]] | None:
    """Return the item in its rotation and the location of the lowest placement in a box."""
    best, lowest = None, box.cells[2] + 1
    for rotation in grid_rotations.by_alignment(item.extents):
        turned = item.turned(rotation)
        if turned.cells[2] >= lowest:
            continue
        location = box.blbf(turned)
        if location is not None and (top := PlacedItem(turned, location).stop[2]) < lowest:
            best, lowest = (turned, location), top
    return best


def _instance(
    name: str, rotations: str, data: Path | None
) -> tuple[tuple[ItemType, ...], BoxContainer]:
    if name in BUILTIN_NAMES:
        return builtin_instance(name, rotations)[:2]
    if data is None:
        raise ArgumentError(
            f"the meshes of {name!r} are not part of this project: give --data with the {DATA_HELP}"
        )
    return read_instance(data / f"{name}.json", rotations)


@cache
def _tasks() -> tuple[tuple[Item, ...], ...]:
    library = ShapeLibrary.open("everyday")
    return tuple(tuple(task.items) for task in load_tasks(DATASET, library, SPLIT))


def _two_tasks(number: int) -> list[Item]:
    tasks = _tasks()
    return [*tasks[2 * number], *tasks[2 * number + 1]]


def _types(items: Sequence[Item], rotations: str) -> tuple[ItemType, ...]:
    return tuple(ItemType.from_item(item, rotations=rotations) for item in items)


def _rows(file: str) -> list[dict[str, str]]:
    with Path(__file__).with_name(file).open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))
