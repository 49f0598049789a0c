"""Nesting: packing meshes as densely as possible, off any grid."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from packit_sim.core.checks import as_integer, check_range
from packit_sim.core.choices import SearchBackend
from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.core.parallel import search_workers
from packit_sim.core.plain_text import plain_logger
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import ROTATION_SLACK, Motion
from packit_sim.geometry.shapes import Item
from packit_sim.parts.nesting.balance import Balance
from packit_sim.parts.nesting.bins import BinsSearch
from packit_sim.parts.nesting.build import SLACK, have_many_fields
from packit_sim.parts.nesting.cell_strips import CellStripSearch
from packit_sim.parts.nesting.copies import CopiesSearch
from packit_sim.parts.nesting.filling import repaired
from packit_sim.parts.nesting.knapsacks import KnapsackSearch
from packit_sim.parts.nesting.lattices import has_copies, lattice_poses
from packit_sim.parts.nesting.limits import ItemLimits
from packit_sim.parts.nesting.pose_kernels import box_of
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.rounds import Limits, Problems, rounds
from packit_sim.parts.nesting.search import NestSearch
from packit_sim.parts.nesting.search_frames import in_search_frame, search_frame, searched_rotations
from packit_sim.parts.nesting.settings import SearchSettings
from packit_sim.parts.nesting.strips import StripSearch
from packit_sim.parts.nesting.tasks import (
    CLOCKS,
    ClockName,
    Poses,
    SearchTask,
    Solution,
)
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.bounds import AMOUNTS, ITERATIONS, SECONDS, SEEDS
from packit_sim.parts.packings.complements import thickened
from packit_sim.parts.packings.containers import BoxContainer, Container
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement

_log = plain_logger("packit_sim.parts.nesting")

SEARCHES: dict[str, Callable[[SearchTask, int], NestSearch]] = {
    "strip": StripSearch,
    "knapsack": KnapsackSearch,
    "bins": BinsSearch,
}
"""The search for each objective."""

ROOM = 0.95
"""Share of the container's sides that items may have on a grid, which need not reach the walls."""

MOST_CLEARANCE = 4
"""Largest clearance, in longest sides of the median item: fields grow with its third power."""


class NestingError(PackItError, RuntimeError):
    """A search that found no valid packing."""


@dataclass(frozen=True)
class NestSettings:
    """Settings of `nest`: workers, limits and first packing.

    Attributes
    ----------
    workers : int
        The number of searches at a time; 0: one per core.
    backend : str
        Workers: "threads" of this process, or processes of a "ray" cluster.
    address : str, optional
        The address of the Ray cluster's head.
    iterations : int, optional
        Pass limit of each search, instead of the time limit: the same seed and number of workers
        then give the same packing.
    start : Packing, optional
        A packing of the same items to begin with, such as an earlier result, even for another
        container or clearance. Items that it lacks, that have a rotation outside their set, or
        that are in conflict, are placed again.
    stop : threading.Event, optional
        Ends the search early when another thread sets it, as Ctrl-C does; the first packing is
        still returned.
    limits : sequence of (sequence of float, float)
        For the objective "knapsack", limits on what the box holds, such as a mass: an amount for
        one of each item, and the largest sum of the amounts in the box.
    balance : Balance, optional
        For the objective "knapsack", a limit on where the centre of gravity in the box is.
    clock : str
        The clock of the time limit: "wall" time, or "processor" time of each search, which other
        work on the machine does not change.

    Examples
    --------
    >>> import math
    >>> import trimesh
    >>> from packit_sim import ItemType, NestSettings, nest
    >>> mesh = trimesh.creation.icosphere(subdivisions=1, radius=10)
    >>> balls = ItemType("ball", mesh.vertices, mesh.faces, demand=4, rotations="fixed")
    >>> settings = NestSettings(workers=1, iterations=3)  # the same packing at any speed
    >>> first, second = (nest([balls], (40, 40, math.inf), settings=settings) for _ in range(2))
    >>> first.height == second.height
    True
    """

    workers: int = 0
    backend: SearchBackend = "threads"
    address: str | None = None
    iterations: int | None = None
    search: SearchSettings = field(default_factory=SearchSettings)
    start: Packing | None = None
    stop: threading.Event | None = None
    clock: ClockName = "wall"
    limits: Sequence[tuple[Sequence[float], float]] = ()
    balance: Balance | None = None


def nest(
    items: Sequence[ItemType | Item | Path | str],
    container: Container | Sequence[float] | Sequence[BoxContainer],
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
    container : BoxContainer, CylinderContainer, MeshContainer or sequence of float
        The container, or the sides of a box; the height of a strip is `math.inf`. For the objective
        "bins" it is a box without obstacles, and may be several: the sizes that there are, as many
        of each as needed. One that is no box is for the objective "knapsack".
    objective : str
        "strip": all items, least height; "knapsack": most value in one box; "bins": all items,
        fewest boxes, and then the smallest of several sizes.
    time : float
        Seconds, from the call on (see `NestSettings.clock`). The first packing may take longer.
    clearance : float
        Smallest distance between the surfaces of two items, and of items and obstacles; here the
        contact tolerance is not taken off. Types may have a larger one of their own.
    callback : callable, optional
        Called with each better packing and the seconds since the call.
    settings : NestSettings
        Workers, limits and first packing.

    Returns
    -------
    Packing
        The best packing that was found; it has no `Packing.problems`. Ctrl-C ends the search early.

    Raises
    ------
    ArgumentError
        If an argument is not possible, or an item does not fit into the container.
    MeshError
        If a mesh can't be used.
    WorkersError
        If the processes can't be started.
    NestingError
        If no packing that was found is valid.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import ItemType, NestSettings, nest
    >>> mesh = trimesh.creation.icosphere(subdivisions=1, radius=10)
    >>> balls = ItemType("ball", mesh.vertices, mesh.faces, demand=8, rotations="fixed")
    >>> settings = NestSettings(workers=1, iterations=5)
    >>> packing = nest([balls], (44, 44, 44), "knapsack", settings=settings)
    >>> len(packing.placements), packing.left_out
    (8, (0,))
    >>> packing.problems()  # by an independent check
    []
    """
    check_range(
        "clock", settings.clock, (settings.clock in CLOCKS, f"choose {' or '.join(CLOCKS)}")
    )
    now = CLOCKS[settings.clock]
    began = now()
    types = _item_types(items)
    containers = _containers(container)
    check_range("time", time, SECONDS)
    check_range("seed", as_integer("seed", seed), SEEDS)
    if settings.iterations is not None:
        check_range("iterations", as_integer("iterations", settings.iterations), ITERATIONS)
    empty = Packing(types, containers[0], (), clearance, objective)
    _check(empty, containers)
    units = [each.longest for each in containers]
    tolerance = checked_items.tolerance(max(units), math.inf)
    searched = tuple(map(in_search_frame, types))
    all_items = (*searched, *containers[0].obstacles)
    least = min(max(clearance, each.clearance or 0.0) for each in all_items)
    gap = least and least + tolerance
    obstacles = (*containers[0].obstacles, *containers[0].walls(0.0, gap))
    # Obstacles are large, and most of their fields are never used: those are not worth the wait.
    shares_fields = settings.iterations is None and not obstacles
    all_types = (*searched, *obstacles)
    is_large = have_many_fields(all_types, objective == "strip", settings.search)
    by_cells = objective != "bins" and is_large and _suit_cells(searched, containers[0])
    has_fields = not by_cells or objective != "strip"
    bodies = tuple(
        _body(each, max(clearance, each.clearance or 0.0) - least, tolerance) for each in all_items
    )
    is_plain = all(body is each for body, each in zip(bodies, all_items, strict=True))
    problems = Problems(
        *(all_types, min(units), gap, shares_fields, settings.search, by_cells, has_fields),
        () if is_plain else (*bodies, *all_types[len(bodies) :]),
    )
    kept = clearance and clearance + tolerance
    checked_types = tuple(
        each.changed(clearance=each.clearance + tolerance) if each.clearance else each
        for each in types
    )
    kind = SEARCHES[objective] if has_fields else CellStripSearch
    task = _task(empty, containers, obstacles, settings.search)
    task.limits = _limits(settings.limits, empty)
    if settings.balance is not None:
        if objective != "knapsack":
            raise ArgumentError(f"a balance is for the objective 'knapsack', not {objective!r}")
        turns, own = problems.get().lookup.turns, task.numbers[: task.count]
        task.balance = settings.balance.of_items(types, turns, own, task.size)

    def problems_of(packing: Packing) -> list[str]:
        return replace(packing, types=checked_types, clearance=kept).problems()

    if settings.start is not None:
        poses, boxes = _poses(settings.start, problems.get(), task, empty)
        task.start = repaired(problems.get(), task, poses, boxes)
        # Items that touch may be in conflict for the search although the check allows them.
        if task.start.inside.sum() < poses.inside.sum():
            first = _packing(problems.get(), task, Solution((), poses, boxes), empty)
            task.start = task.start if problems_of(first) else poses
    elif objective != "bins" and (lattice := lattice_poses(problems.get(), task)) is not None:
        task.start = repaired(problems.get(), task, lattice, boxes_of([task.size]))
    if kind is KnapsackSearch and has_copies(task) and not task.is_limited:
        kind = CopiesSearch

    def checked(solution: Solution) -> Packing | None:
        packing = _packing(problems.get(), task, solution, empty)
        found = problems_of(packing)
        if objective != "knapsack" and any(packing.left_out):
            found.append("not all items are placed")
        if found:
            _log.info("a packing is dropped, since it is not valid: %s", "; ".join(found))
        return None if found else packing

    best: Packing | None = None
    with search_workers(settings.workers, settings.backend, settings.address) as workers:
        times = 1
        if kind is StripSearch and settings.iterations is None:
            times, task.settings = _beginnings(task, time)
        seeds = np.random.SeedSequence(seed).generate_state(times * workers.count, np.uint64)
        beginnings = [
            [kind(task, int(each)) for each in own] for own in seeds.reshape(times, workers.count)
        ]
        before = now() - began
        stop = settings.stop or threading.Event()
        limits = Limits(time - before, settings.iterations, stop, settings.clock)
        try:
            for best, seconds in rounds(
                problems, beginnings, limits, workers, checked, task.settings
            ):
                if callback is not None:
                    callback(best, before + seconds)
        except KeyboardInterrupt:
            if best is None:
                raise
    if best is None:
        raise NestingError(f"no valid packing was found in {time:g} s: allow more time")
    return best


def _beginnings(task: SearchTask, seconds: float) -> tuple[int, SearchSettings]:
    """Return how often the search for a strip begins in so many seconds, and its settings then."""
    settings = task.settings
    least, for_item = settings.beginning_seconds
    times = seconds / max(least, for_item * task.count)
    if times >= settings.persevering:
        times = round(times / settings.persevering)
        patience = settings.most_patience
        settings = replace(settings, patience=patience, restart_probability=0.0, resumes=True)
    elif task.start is not None:
        times = 1
    return int(min(max(times, 1), settings.most_beginnings)), settings


def _body(item_type: ItemType, distance: float, tolerance: float) -> ItemType:
    """Return the body of all that is nearer to an item than a distance, if that is above 0."""
    if distance <= 0:
        return item_type
    vertices, faces = thickened(item_type.vertices, item_type.faces, distance + 2 * tolerance)
    body = ItemType(item_type.name, vertices, faces, item_type.demand, item_type.rotations)
    return body.changed(turning=item_type.turning, turns=item_type.turns)


def _suit_cells(types: Sequence[ItemType], container: Container) -> bool:
    """Return whether all items fit on a grid of cells."""
    most = ROOM * np.array(container.size)
    sides = ((np.ptp(t.vertices @ m.T, axis=0) for m in searched_rotations(t)) for t in types)
    return all(any((side <= most).all() for side in each) for each in sides)


def _containers(given: Any) -> tuple[Container, ...]:
    """Return the containers, the largest first."""
    if isinstance(given, Container):
        return (given,)
    several = isinstance(given, Sequence) and any(isinstance(each, Container) for each in given)
    if not several:
        return (BoxContainer(given),)
    for number, each in enumerate(given):
        if not isinstance(each, BoxContainer):
            raise ArgumentError(f"container[{number}] {each!r} is not possible: a BoxContainer")
    return tuple(sorted(dict.fromkeys(given), key=lambda each: -each.volume))


def _task(
    empty: Packing,
    containers: Sequence[Container],
    obstacles: Sequence[ItemType],
    settings: SearchSettings,
) -> SearchTask:
    """Return the task of filling an empty packing."""
    types = empty.types
    numbers = np.arange(len(types)).repeat([each.demand for each in types])
    volumes = np.array([each.volume for each in types])
    values = np.array([each.volume if each.value is None else each.value for each in types])
    return SearchTask(
        np.concatenate((numbers, np.arange(len(types), len(types) + len(obstacles)))),
        volumes[numbers],
        values[numbers],
        tuple(each.size for each in containers),
        settings,
        np.array([(each.low + each.high) / 2 for each in obstacles]).reshape(-1, 3),
    )


def _limits(given: Sequence[tuple[Sequence[float], float]], empty: Packing) -> ItemLimits:
    """Return limits on items from those on types."""
    if given and empty.objective != "knapsack":
        raise ArgumentError(f"limits are for the objective 'knapsack', not {empty.objective!r}")
    types = empty.types
    for amounts, most in given:
        if len(amounts) != len(types):
            raise ArgumentError(f"a limit has {len(amounts)} amounts for {len(types)} items")
        for each in amounts:
            check_range("an amount of a limit", each, AMOUNTS)
        check_range("a limit", most, AMOUNTS)
    table = np.array([amounts for amounts, _ in given], float).reshape(len(given), len(types))
    demands = [each.demand for each in types]
    return ItemLimits(table.repeat(demands, axis=1), np.array([most for _, most in given], float))


def _poses(
    start: Packing, problem: Problem, task: SearchTask, empty: Packing
) -> tuple[Poses, Floats]:
    """Return the poses of an earlier packing, and its boxes (see `boxes_of`).

    Items that can't have their poses are not inside.
    """
    if len(task.sizes) > 1:
        raise ArgumentError("a packing to begin with is not possible with boxes of several sizes")
    names = [each.digest for each in empty.types]
    if [each.digest for each in start.types] != names:
        raise ArgumentError("the packing to begin with is of other items, or in another order")
    poses = task.unplaced
    boxes = boxes_of([task.size] * (1 + max((p.box for p in start.placements), default=0)))
    for placement in start.placements:
        a = placement.type
        free = np.flatnonzero((task.numbers[: task.count] == a) & (poses.inside[: task.count] == 0))
        own = problem.allowed[a, : problem.allowed_counts[a]]
        turns = problem.lookup.turns[own] @ search_frame(empty.types[a])
        errors = np.abs(turns - placement.pose.rotation * placement.scale).max(axis=(1, 2))
        if len(free) == 0 or errors.min() > ROTATION_SLACK:
            continue
        i = int(free[0])
        centre = _centre(empty.types[a])
        poses.turned[i] = own[errors.argmin()]
        poses.places[i] = placement.apply(centre)
        poses.places[i, 0] += boxes[placement.box, 0]
        poses.inside[i] = 1
    return poses, boxes


def _item_types(items: Sequence[ItemType | Item | Path | str]) -> tuple[ItemType, ...]:
    if isinstance(items, (str, Path, Item, ItemType)):
        raise ArgumentError(f"items {items!r} is not possible: it must be a sequence of items")
    types = tuple(_item_type(n, each) for n, each in enumerate(items))
    if not types:
        raise ArgumentError("items is empty: there must be at least one item to pack")
    return types


def _item_type(number: int, item: ItemType | Item | Path | str) -> ItemType:
    if isinstance(item, ItemType):
        return item
    if isinstance(item, Item):
        return ItemType.from_item(item)
    if isinstance(item, (str, Path)):
        return ItemType.from_file(item)
    raise ArgumentError(
        f"items[{number}] is of type {type(item).__name__}: "
        "choose an ItemType, an Item or the path of a mesh file"
    )


def _check(packing: Packing, containers: Sequence[Container]) -> None:
    """Raise ArgumentError if the containers don't suit the objective, the items or the distance."""
    types, objective = packing.types, packing.objective
    longest = [float(each.extents.max()) for each in types]
    most = MOST_CLEARANCE * float(np.median(longest))
    valid = f"at most {most:.6g}, {MOST_CLEARANCE} times the longest side of the median item"
    check_range("clearance", packing.clearance, (packing.clearance <= most, valid))
    if objective != "bins" and len(containers) > 1:
        raise ArgumentError(f"objective {objective!r} needs one container, not {len(containers)}")
    for container in containers:
        if container.is_strip != (objective == "strip"):
            needs = "no height (math.inf)" if objective == "strip" else "a height"
            size = _size(container.size)
            raise ArgumentError(
                f"objective {objective!r} needs a box with {needs}, not one of {size}"
            )
        if objective != "knapsack" and not isinstance(container, BoxContainer):
            raise ArgumentError(
                f"objective {objective!r} needs a box, not {container.name!r}: choose knapsack"
            )
        if objective == "bins" and container.obstacles:
            raise ArgumentError('obstacles are not possible with the objective "bins"')
    if objective == "knapsack":
        return
    sizes = np.array([each.size for each in containers])
    unit = min(each.longest for each in containers)
    slack = SLACK * min(checked_items.tolerance(unit, each) for each in longest)
    for each in types:
        sides = (np.ptp(each.vertices @ turn.T, axis=0) for turn in searched_rotations(each))
        if not any((side <= sizes + slack).all(axis=1).any() for side in sides):
            known = " or ".join(_size(size) for size in sizes)
            raise ArgumentError(
                f"item type {each.name!r} of {_size(each.extents)} does not fit into a "
                f"container of {known} in any of its rotations ({each.rotations})"
            )


def _size(sides: Iterable[float]) -> str:
    return " x ".join(f"{side:.6g}" for side in sides)


def _packing(problem: Problem, task: SearchTask, solution: Solution, empty: Packing) -> Packing:
    """Return the packing of a solution."""
    poses, boxes = solution.poses, solution.boxes
    placements = []
    for i in np.flatnonzero(poses.inside[: task.count]):
        a = int(task.numbers[i])
        item_type = empty.types[a]
        box = box_of(boxes, poses.places[i, 0])
        turned = Motion(problem.lookup.turns[poses.turned[i]] @ search_frame(item_type))
        shift = poses.places[i] - turned.direction(_centre(item_type)) - (boxes[box, 0], 0, 0)
        placements.append(Placement(a, turned.at(shift), int(box)))
    containers = [BoxContainer(tuple(sides)) for sides in boxes[:, 1:].tolist()]
    several = tuple(containers) if len(task.sizes) > 1 else ()
    return replace(empty, placements=tuple(placements), containers=several)


def _centre(item_type: ItemType) -> Floats:
    """Return the centre (3,), in the mesh's frame, of the bounding box in the search's frame."""
    searched = in_search_frame(item_type)
    return np.asarray((searched.low + searched.high) / 2 @ search_frame(item_type))
