"""Nesting: packing meshes as densely as possible, off any grid."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.core.parallel import BackendName, Workers
from packit_sim.geometry.shapes import Item
from packit_sim.nesting import validity
from packit_sim.nesting.bins import BinsSearch
from packit_sim.nesting.containers import BoxContainer
from packit_sim.nesting.cost_kernels import box_of
from packit_sim.nesting.item_types import ItemType
from packit_sim.nesting.knapsacks import KnapsackSearch
from packit_sim.nesting.packing import OBJECTIVES, Packing
from packit_sim.nesting.placements import Placement
from packit_sim.nesting.problem import Problem, candidates
from packit_sim.nesting.rounds import Limits, Problems, rounds
from packit_sim.nesting.search import Search
from packit_sim.nesting.strips import StripSearch
from packit_sim.nesting.tasks import SearchSettings, Solution, Task

SEARCHES: dict[str, Callable[[Task, int], Search]] = {
    "strip": StripSearch,
    "knapsack": KnapsackSearch,
    "bins": BinsSearch,
}
"""The search for each objective."""


@dataclass(frozen=True)
class NestSettings:
    """How `nest` runs.

    Attributes
    ----------
    workers : int
        The number of processes; 0: one per core.
    backend : str
        Where they run: "loky" or "ray".
    address : str, optional
        The address of the Ray cluster's head.
    iterations : int, optional
        Passes over the items of each process, instead of the time: the same seed and number of
        processes then give the same packing.
    search : SearchSettings
        The settings of the search.
    """

    workers: int = 0
    backend: BackendName = "loky"
    address: str | None = None
    iterations: int | None = None
    search: SearchSettings = field(default_factory=SearchSettings)


def nest(
    items: Sequence[ItemType | Item | Path | str],
    container: BoxContainer | Sequence[float],
    objective: str = "strip",
    time: float = 60.0,
    seed: int = 0,
    clearance: float = 0.0,
    callback: Callable[[Packing, float], object] | None = None,
    settings: NestSettings = NestSettings(),
) -> Packing:
    """Pack meshes at any translation, in the rotations that each may take.

    Parameters
    ----------
    items : sequence of ItemType, Item, Path or str
        The items; an `Item` or a mesh file stands for one of it, in the 24 rotations.
    container : BoxContainer or sequence of float
        The box, or its sides; a strip's height is `math.inf`.
    objective : str
        "strip": all items, least height; "knapsack": most value in one box; "bins": all items,
        fewest boxes.
    time : float
        Seconds, from the call on. The first answer can take longer.
    seed : int
        The seed.
    clearance : float
        Smallest distance between the surfaces of two items.
    callback : callable, optional
        Called with each better packing and the seconds since the call.
    settings : NestSettings
        How it runs.

    Returns
    -------
    Packing
        The best packing that was found; it is valid by `Packing.problems`. Ctrl-C ends the search
        early.

    Raises
    ------
    ArgumentError
        If an argument is not possible, or an item does not fit into the container.
    MeshError
        If a mesh can't be used.
    WorkersError
        If the processes can't be started.
    """
    start = clock.perf_counter()
    types = tuple(_item_type(each) for each in items)
    if not isinstance(container, BoxContainer):
        container = BoxContainer(tuple(container))  # type: ignore[arg-type]
    _check(types, container, objective, time, clearance)
    problems = Problems(types, container.longest, clearance)
    count = np.array([each.demand for each in types])
    numbers = np.arange(len(types)).repeat(count)
    volumes = np.array([each.volume for each in types])[numbers]
    values = np.array([each.volume if each.value is None else each.value for each in types])
    task = Task(numbers, volumes, values[numbers], container.size, settings.search)
    best = Packing(types, container, (), clearance, objective)
    with Workers(settings.workers, settings.backend, settings.address) as workers:
        seeds = np.random.SeedSequence(seed).generate_state(workers.count, np.uint64)
        searches = [SEARCHES[objective](task, int(each)) for each in seeds]
        limits = Limits(start + time - clock.perf_counter(), settings.iterations)
        with suppress(KeyboardInterrupt):
            for solution in rounds(problems, searches, limits, workers):
                found = _packing(problems.get(), task, solution, best)
                if found.problems():
                    continue
                best = found
                if callback is not None:
                    callback(best, clock.perf_counter() - start)
    return best


def _item_type(item: ItemType | Item | Path | str) -> ItemType:
    if isinstance(item, ItemType):
        return item
    return ItemType.from_item(item) if isinstance(item, Item) else ItemType.from_file(item)


def _check(
    types: tuple[ItemType, ...],
    container: BoxContainer,
    objective: str,
    time: float,
    clearance: float,
) -> None:
    """Raise ArgumentError if an argument is not possible."""
    if not types:
        raise ArgumentError("there are no items to pack")
    if objective not in OBJECTIVES:
        raise ArgumentError(
            f"objective {objective!r} is not known: choose from {', '.join(OBJECTIVES)}"
        )
    if container.is_strip != (objective == "strip"):
        needs = "no height (math.inf)" if objective == "strip" else "a height"
        raise ArgumentError(f"objective {objective!r} needs a box with {needs}")
    check_range("time", time, Range(0, ends="()"))
    check_range("clearance", clearance, Range(0, ends="[)"))
    if objective != "knapsack":
        for each in types:
            if not _fits(each, container):
                raise ArgumentError(
                    f"item type {each.name!r} of {_size(each.extents)} does not fit into a "
                    f"container of {_size(container.size)} in any of its rotations "
                    f"({each.rotations})"
                )


def _fits(item_type: ItemType, container: BoxContainer) -> bool:
    """Return whether an item fits into the container in one of its rotations."""
    sides = (np.ptp(item_type.vertices @ turn.T, axis=0) for turn in candidates(item_type))
    slack = validity.tolerance(container.longest, float(item_type.extents.max())) / 2
    return any((each <= np.array(container.size) + slack).all() for each in sides)


def _size(sides: Iterable[float]) -> str:
    return " x ".join(f"{side:.6g}" for side in sides)


def _packing(problem: Problem, task: Task, solution: Solution, empty: Packing) -> Packing:
    """Return the packing of a solution."""
    poses, boxes = solution.poses, solution.boxes
    placements = []
    for i in np.flatnonzero(poses.inside):
        a = int(task.numbers[i])
        item_type = empty.types[a]
        box = box_of(boxes, poses.places[i, 0])
        pose = np.eye(4)
        pose[:3, :3] = problem.lookup.turns[poses.turned[i]]
        centre = (item_type.low + item_type.high) / 2
        pose[:3, 3] = poses.places[i] - pose[:3, :3] @ centre - (boxes[box, 0], 0, 0)
        placements.append(Placement(a, pose, int(box)))
    return replace(empty, placements=tuple(placements))
