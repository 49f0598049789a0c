"""The nester: its packings are valid by independent checks, repeatable, and better over time."""

import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, pairwise
from typing import Any

import manifold3d
import numpy as np
import pytest
import trimesh
from trimesh import creation, transformations

from packit_sim import (
    BoxContainer,
    Item,
    ItemType,
    NestSettings,
    Packing,
    PackItError,
    ShapeLibrary,
    nest,
)
from packit_sim.core import parallel
from packit_sim.core.errors import ArgumentError, MeshError, PackFormatError
from packit_sim.core.parallel import WorkersError
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.nesting import bins, filling, knapsacks, rounds, strips
from packit_sim.parts.nesting import nest as nest_module
from packit_sim.parts.nesting.nest import NestingError
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.search import Attempt, NestSearch
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS, SearchSettings
from packit_sim.parts.nesting.tasks import CLOCKS, Poses, SearchBudget, SearchTask, Solution
from packit_sim.parts.packings.checked_items import tolerance
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import matrices

OPEN = math.inf


def of(mesh: trimesh.Trimesh, name: str = "item", **settings: Any) -> ItemType:
    return ItemType(name, mesh.vertices, mesh.faces, **settings)


@cache
def cube() -> trimesh.Trimesh:
    return creation.box((1, 1, 1))


@cache
def angle() -> trimesh.Trimesh:
    """An L of three unit cubes."""
    return trimesh.boolean.union(
        [creation.box((2, 1, 1)), creation.box((1, 2, 1)).apply_translation((-0.5, 0.5, 0))],
        engine="manifold",
    )


@cache
def bowl() -> trimesh.Trimesh:
    """A box with walls of 0.1, open above."""
    return trimesh.boolean.difference(
        [creation.box((2, 2, 1.2)), creation.box((1.8, 1.8, 1.2)).apply_translation((0, 0, 0.1))],
        engine="manifold",
    )


@cache
def hollow() -> trimesh.Trimesh:
    """A closed box with walls of 0.1 around an empty inside."""
    inner = creation.box((1.8, 1.8, 1.8))
    inner.invert()
    return trimesh.util.concatenate([creation.box((2, 2, 2)), inner])


def ball(radius: float = 0.5) -> trimesh.Trimesh:
    return creation.icosphere(subdivisions=1, radius=radius)


def few() -> list[ItemType]:
    return [of(angle(), "angle", demand=2), of(creation.box((0.4, 0.9, 1.7)), "box", demand=2)]


def mixed(rotations: str) -> list[ItemType]:
    return [
        of(angle(), "angle", demand=2, rotations=rotations),
        of(bowl(), "bowl", demand=1, rotations=rotations),
        of(ball(), "ball", demand=2, rotations=rotations),
        of(creation.box((0.4, 0.9, 1.7)), "box", demand=3, rotations=rotations),
    ]


def quick(iterations: int = 60, workers: int = 1) -> NestSettings:
    return NestSettings(workers=workers, iterations=iterations)


def placed(packing: Packing) -> list[tuple[int, trimesh.Trimesh]]:
    """The number of its box and the mesh of each item."""
    return [
        (p.box, trimesh.Trimesh(packing.vertices(p), packing.types[p.type].faces, process=False))
        for p in packing.placements
    ]


def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    body = manifold3d.Manifold(manifold3d.Mesh64(mesh.vertices, np.asarray(mesh.faces, np.uint64)))
    assert body.status() == manifold3d.Error.NoError
    return body


def check(packing: Packing) -> None:
    """Compare a packing with the definition, without the code that checked it before."""
    assert packing.problems() == []
    size = np.array(packing.container.size)
    bodies = placed(packing)
    slacks = [
        tolerance(packing.container.longest, float(packing.types[p.type].extents.max()))
        for p in packing.placements
    ]
    for (_, mesh), slack in zip(bodies, slacks, strict=True):
        assert (mesh.vertices >= -slack).all() and (mesh.vertices <= size + slack).all()
    for (one, slack), (other, less) in combinations(zip(bodies, slacks, strict=True), 2):
        if one[0] != other[0]:
            continue
        common = (solid(one[1]) ^ solid(other[1])).volume()
        assert common <= min(slack, less) * min(one[1].area, other[1].area)
    for placement in packing.placements:
        item_type = packing.types[placement.type]
        turns = matrices("cube" if item_type.rotations == "free" else item_type.rotations)
        if item_type.rotations != "free":
            assert np.abs(turns - placement.pose.rotation).max(axis=(1, 2)).min() < 1e-9


def text(packing: Packing) -> bytes:
    return b"".join(
        bytes(f"{p.type} {p.box} ", "ascii") + p.matrix.tobytes() for p in packing.placements
    )


@pytest.mark.slow
def test_something_better_comes_before_all_items_are_arranged(monkeypatch) -> None:
    """The search begins with the largest items, the others are then placed around them."""

    def stacked(problem: Problem, task: SearchTask, *_: Any) -> Poses:
        poses = task.unplaced
        poses.inside[:] = 1
        poses.places[:, :2] = 1.5
        poses.places[:, 2] = 3.0 * np.arange(task.count) + 1.5
        return poses

    monkeypatch.setattr(strips, "constructed", stacked)
    heights: list[float] = []
    items = [of(angle(), demand=16), of(ball(), "ball", demand=16)]
    settings = quick(12)
    packing = nest(
        items, (4, 4, OPEN), callback=lambda p, _: heights.append(p.height), settings=settings
    )
    check(packing)
    assert len(heights) > 1 and heights[-1] < heights[0] / 2


@pytest.mark.parametrize(
    "rotations", ["fixed", pytest.param("yaw-8", marks=pytest.mark.slow), "free"]
)
def test_strips_are_valid_complete_and_improve(rotations) -> None:
    heights: list[float] = []
    packing = nest(
        mixed(rotations),
        (3, 3, OPEN),
        callback=lambda found, _: heights.append(found.height),
        settings=quick(40),
    )
    check(packing)
    assert packing.left_out == (0, 0, 0, 0)
    assert all(later < earlier for earlier, later in pairwise(heights))
    assert heights[-1] == packing.height and (len(heights) > 1 or rotations == "fixed")


def tilted(mesh: trimesh.Trimesh, seed: int) -> trimesh.Trimesh:
    turn = transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    return mesh.copy().apply_transform(turn)


@pytest.mark.slow
def test_free_rotations_bring_smallest_boxes_parallel_to_the_walls() -> None:
    box = creation.box((1, 2, 0.5))
    types = [of(tilted(box, n), rotations="free", demand=2) for n in range(2)]
    packing = nest(types, (2, 2, OPEN), settings=quick(100))
    check(packing)
    assert packing.height == pytest.approx(1, abs=1e-3)
    again = nest(types, (2, 2, OPEN), settings=replace(quick(1), start=packing))
    assert again.height == pytest.approx(packing.height, abs=1e-6)
    check(again)
    stiff = [each.changed(rotations="cube") for each in types]
    with pytest.raises(ArgumentError, match="does not fit into a container"):
        nest(stiff, (1.1, 2.1, 0.6), "bins", settings=quick(1))
    assert nest(types, (1.1, 2.1, 0.6), "bins", settings=quick(1)).boxes == 4


@pytest.mark.parametrize("thickness", [0, 1e-6])
def test_a_tilted_plate_is_searched_as_it_is(thickness) -> None:
    """In the frame of its smallest box it would be too flat."""
    plate = of(tilted(creation.box((1, 1, thickness)), 0), rotations="free")
    packing = nest([plate, of(ball(), rotations="free")], (3, 3, OPEN), settings=quick(3))
    check(packing)
    assert np.isin(np.abs(packing.placements[0].pose.rotation).round(12), (0, 1)).all()


def test_knapsacks_are_valid_and_gain_value() -> None:
    values: list[float] = []
    packing = nest(
        mixed("axis-3"),
        (2.5, 2.5, 2.5),
        "knapsack",
        callback=lambda found, _: values.append(found.volume),
        settings=quick(20),
    )
    check(packing)
    assert values == sorted(set(values)) and values[-1] == packing.volume
    assert packing.density == pytest.approx(packing.volume / 2.5**3)
    assert sum(packing.left_out) + len(packing.placements) == 8


def test_a_knapsack_prefers_value_and_leaves_out_what_does_not_fit() -> None:
    items = [
        of(cube(), "cheap", demand=3, value=1),
        of(creation.box((1, 1, 1.001)), "dear", demand=1, value=10),
        of(creation.box((5, 5, 5)), "huge", value=1000),
    ]
    packing = nest(items, (1.1, 1.1, 1.1), "knapsack", settings=quick(300))
    check(packing)
    assert packing.left_out == (3, 0, 1)


def test_a_knapsack_begins_again_until_half_of_the_time_is_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[float] = []
    constructed = knapsacks.KnapsackSearch._constructed

    def noted(search: knapsacks.KnapsackSearch, problem: Problem) -> Solution:
        assert search._budget is not None
        begun.append(search._budget.progress)
        return constructed(search, problem)

    monkeypatch.setattr(knapsacks.KnapsackSearch, "_constructed", noted)
    parts = [of(creation.box((1, 0.9 + n / 40, 0.8)), str(n), demand=3) for n in range(5)]
    volumes: list[float] = []
    packing = nest(
        parts,
        (2.2, 2.2, 2.2),
        "knapsack",
        callback=lambda found, _: volumes.append(found.volume),
        settings=replace(quick(600), search=SearchSettings(max_failures=3)),
    )
    check(packing)
    assert len(begun) > 2
    assert begun == sorted(begun)
    assert begun[-1] < DEFAULT_SETTINGS.beginning
    assert packing.volume == max(volumes)


def test_a_strip_begins_again_each_minute_or_after_a_second_for_each_item() -> None:
    task = SearchTask(np.zeros(40, np.int64), np.ones(40), np.ones(40), ((1.0, 1.0, math.inf),))
    planned = [nest_module._beginnings(task, t) for t in (1, 60, 119, 120, 299)]
    assert [times for times, _ in planned] == [1, 1, 1, 2, 4]
    assert all(settings == DEFAULT_SETTINGS for _, settings in planned)
    of_many = replace(task, volumes=np.ones(150))
    assert nest_module._beginnings(of_many, 300) == (2, DEFAULT_SETTINGS)


def test_a_long_search_for_a_strip_perseveres_and_resumes() -> None:
    task = SearchTask(np.zeros(40, np.int64), np.ones(40), np.ones(40), ((1.0, 1.0, math.inf),))
    planned = [nest_module._beginnings(task, t) for t in (300, 449, 451, 600, 9000)]
    assert [times for times, _ in planned] == [1, 1, 2, 2, 10]
    for _, settings in planned:
        assert settings.patience == DEFAULT_SETTINGS.most_patience
        assert settings.restart_probability == 0
        assert settings.resumes


def test_a_short_search_for_a_strip_that_has_a_packing_begins_with_it_alone() -> None:
    task = SearchTask(np.zeros(40, np.int64), np.ones(40), np.ones(40), ((1.0, 1.0, math.inf),))
    task.start = task.unplaced
    planned = [nest_module._beginnings(task, t) for t in (120, 299, 300, 600)]
    assert [times for times, _ in planned] == [1, 1, 1, 2]
    assert [settings.resumes for _, settings in planned] == [False, False, True, True]


@pytest.mark.parametrize("has_start", [False, True])
@pytest.mark.parametrize("rotations", ["cube", "fixed"])
def test_a_long_search_resumes_from_its_lowest_strip(
    rotations: str, has_start: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[tuple[float, SearchSettings, bool]] = []
    constructed = strips.StripSearch._constructed

    def noted(search: strips.StripSearch, problem: Problem) -> Solution:
        solution = constructed(search, problem)
        begun.append((solution.score[0], search._task.settings, search._task.start is not None))
        return solution

    items, heights = mixed(rotations), list[float]()
    first_packing = nest(items, (3.1, 2.9, OPEN), settings=quick(1))  # and prepare the search
    start = first_packing if has_start else None
    monkeypatch.setattr(strips.StripSearch, "_constructed", noted)
    search = SearchSettings(beginning_seconds=(0.2, 0.0))
    packing = nest(
        *(items, (3.1, 2.9, OPEN)),
        time=2.0,
        settings=NestSettings(workers=1, search=search, start=start, clock="processor"),
        callback=lambda found, _: heights.append(found.height),
    )
    check(packing)
    (first, _, _), (second, _, _) = begun
    assert [starts for *_, starts in begun] == [has_start, True]
    assert start is None or first == pytest.approx(start.height)
    assert second <= first and any(second == pytest.approx(each) for each in heights)
    assert all(settings.patience == search.most_patience for _, settings, _ in begun)


class Scripted(NestSearch):
    """A search that finds one score, and notes what it began with."""

    def __init__(self, task: SearchTask, score: float) -> None:
        super().__init__(task, 0)
        self.score = score
        self.began_with: float | None = None

    def begin_with(self, solution: Solution) -> None:
        self.began_with = solution.score[0]

    def advance(self, problem: Problem, budget: SearchBudget) -> None:
        self.best = Solution((self.score,), self._task.unplaced, np.empty((0, 4)))

    def _constructed(self, problem: Problem) -> Solution:
        raise AssertionError

    def _begun(self, problem: Problem, best: Solution) -> Attempt:
        raise AssertionError

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        raise AssertionError


@pytest.mark.parametrize(
    ("resumes", "has_start", "expected"),
    [
        (True, False, [None, 5, 4, None, None, 3]),
        (True, True, [None, 5, 4, 4, 4, 3]),
        (False, False, [None] * 6),
        (False, True, [None] * 6),
    ],
)
def test_a_search_resumes_from_the_best_if_the_one_before_found_it_or_has_a_start(
    resumes: bool, has_start: bool, expected: list[float | None]
) -> None:
    items = mixed("fixed")
    found = nest(items, (3.1, 2.9, OPEN), settings=quick(1))
    task = SearchTask(np.zeros(1, np.int64), np.ones(1), np.ones(1), ((1.0, 1.0, math.inf),))
    task.start = task.unplaced if has_start else None
    searches = [Scripted(task, score) for score in (5, 4, 4.5, 4, 3, 2)]
    limits = rounds.Limits(60.0, 1, threading.Event(), "wall")
    settings = replace(DEFAULT_SETTINGS, resumes=resumes)
    with parallel.Threads(1) as workers:
        problems = rounds.Problems(items, 2.9, 0.0)
        own = [[each] for each in searches]
        better = list(rounds.rounds(problems, own, limits, workers, lambda _: found, settings))
    assert len(better) == 4
    assert [each.began_with for each in searches] == expected


def test_a_strip_gets_lower_at_the_end_by_moves_of_all_its_items() -> None:
    def height(moves: int) -> float:
        search = SearchSettings(finishing_moves=moves, finishing_shakes=0)
        settings = replace(quick(100), search=search)
        packing = nest(mixed("cube"), (3.1, 2.9, OPEN), settings=settings)
        check(packing)
        return packing.height

    before = height(0)
    assert height(1) < before - 1e-4
    assert height(10) < height(1)


@pytest.mark.parametrize(("passes", "moves"), [(1, 1), (20, 2), (60, 6), (100, 10), (200, 10)])
def test_a_limit_of_passes_limits_the_moves_at_the_end_of_a_strip_too(
    passes: int, moves: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def noted(
        problem: Problem, task: SearchTask, poses: Poses, boxes: Floats, moves: int, *_: object
    ) -> Poses:
        asked.append(moves)
        return poses

    monkeypatch.setattr(strips, "compacted", noted)
    check(nest(mixed("cube"), (3.1, 2.9, OPEN), settings=quick(passes)))
    shakes = math.ceil(DEFAULT_SETTINGS.finishing[0] * passes) - moves
    assert asked == [moves] * (1 + shakes)


def test_an_interruption_at_the_end_of_a_strip_stops_all_and_keeps_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(strips.StripSearch, "finished", interrupted)
    stop = threading.Event()
    packing = nest(mixed("cube"), (3.1, 2.9, OPEN), settings=replace(quick(20), stop=stop))
    check(packing)
    assert stop.is_set()


def test_time_is_left_for_the_end_of_a_strip() -> None:
    task = SearchTask(np.zeros(1, np.int64), np.ones(1), np.ones(1), ((1.0, 1.0, math.inf),))
    searches = [strips.StripSearch(task, 0)], [knapsacks.KnapsackSearch(task, 0)]
    left = [rounds._left_over(each, 10.0, DEFAULT_SETTINGS) for each in searches]
    assert left == [pytest.approx(1.0), 0]
    assert rounds._left_over(searches[0], 60.0, DEFAULT_SETTINGS) == 1.5
    assert rounds._left_over(searches[0], 600.0, DEFAULT_SETTINGS) == pytest.approx(6.0)


@pytest.mark.parametrize("kind", ["strip", "knapsack"])
def test_time_is_left_for_the_last_check(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, problems, checked = [0.0], Packing.problems, []

    def now() -> float:
        clock[0] += 0.1
        return clock[0]

    def slow_at_first(packing: Packing) -> list[str]:
        clock[0] += 0.0 if checked else 5.0
        checked.append(packing)
        return problems(packing)

    monkeypatch.setitem(CLOCKS, "wall", now)
    monkeypatch.setattr(Packing, "problems", slow_at_first)
    size = 3.1, 2.9, OPEN if kind == "strip" else 1.5
    nest(mixed("cube"), size, kind, time=100.0, settings=NestSettings(workers=1))
    assert len(checked) > 1 and 94 < clock[0] < 98


def test_moves_at_the_end_do_not_count_if_the_strip_is_not_valid_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def sunk(problem: Problem, task: SearchTask, poses: Poses, *_: object) -> Poses:
        return replace(poses, places=poses.places * (1, 1, 0.5))

    settings = replace(quick(100), search=SearchSettings(finishing_moves=0))
    as_it_was = nest(mixed("cube"), (3.1, 2.9, OPEN), settings=settings)
    monkeypatch.setattr(strips, "compacted", sunk)
    packing = nest(mixed("cube"), (3.1, 2.9, OPEN), settings=settings)
    check(packing)
    assert packing.height == as_it_was.height


def test_each_beginning_of_a_strip_has_its_own_construction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[strips.StripSearch] = []
    constructed = strips.StripSearch._constructed

    def noted(search: strips.StripSearch, problem: Problem) -> Solution:
        assert search.best is None
        begun.append(search)
        return constructed(search, problem)

    monkeypatch.setattr(strips.StripSearch, "_constructed", noted)
    items, heights = mixed("cube"), list[float]()
    nest(items, (3.1, 2.9, OPEN), time=9000, settings=quick(1))  # also compiles
    assert len(begun) == 1
    search = SearchSettings(beginning_seconds=(0.5, 0.0), persevering=100)
    often = NestSettings(workers=1, search=search, clock="processor")
    best = nest(
        *(items, (3.1, 2.9, OPEN)),
        time=2,
        settings=often,
        callback=lambda found, _: heights.append(found.height),
    )
    assert 3 <= len(begun) <= 5
    assert heights == sorted(set(heights), reverse=True) and heights[-1] == best.height
    check(best)


def test_a_knapsack_may_stay_empty() -> None:
    packing = nest([of(cube())], (0.5, 0.5, 0.5), "knapsack", settings=quick())
    assert packing.placements == () and packing.left_out == (1,)


def test_bins_are_valid_complete_and_never_more() -> None:
    used: list[int] = []
    packing = nest(
        mixed("yaw-4"),
        (2.2, 2.2, 2.2),
        "bins",
        callback=lambda found, _: used.append(found.boxes),
        settings=quick(25),
    )
    check(packing)
    assert packing.left_out == (0, 0, 0, 0)
    assert used == sorted(used, reverse=True) and used[-1] == packing.boxes
    assert {p.box for p in packing.placements} == set(range(packing.boxes))


@pytest.mark.parametrize("seed", range(2))
def test_cubes_fill_a_strip_and_boxes(seed) -> None:
    cubes = [of(cube(), demand=8)]
    strip = nest(cubes, (2, 2, OPEN), seed=seed, settings=quick(3000))
    check(strip)
    assert strip.height == pytest.approx(2, abs=1e-3) and len(strip.placements) == 8
    knapsack = nest(cubes, (2, 2, 1.5), "knapsack", seed=seed, settings=quick(300))
    check(knapsack)
    assert len(knapsack.placements) == 4
    bins = nest(cubes, (2, 1, 1), "bins", seed=seed, settings=quick(3000))
    check(bins)
    assert bins.boxes == 4 and bins.density == pytest.approx(1)


def test_a_packing_to_begin_with_may_have_items_that_do_not_fit_any_more() -> None:
    bar = of(creation.box((0.5, 0.5, 3)), "bar", rotations="yaw-4")
    high = nest([bar, of(cube())], (2, 2, 4), "knapsack", settings=quick(20))
    assert len(high.placements) == 2
    settings = replace(quick(20), start=high)
    low = nest([bar, of(cube())], (2, 2, 2), "knapsack", settings=settings)
    assert low.problems() == [] and [each.type for each in low.placements] == [1]


def test_bins_of_several_sizes_are_few_and_small(tmp_path) -> None:
    """Ten cubes fill one box of eight and one of two, which is found from two boxes of eight."""
    sizes = [BoxContainer(size) for size in ((2, 1, 1), (2, 2, 2), (1, 1, 3))]
    score = lambda found: (found.boxes, -found.density)  # noqa: E731
    scores = []
    packing = nest(
        [of(creation.box((0.9, 0.9, 0.9)), demand=10)],
        sizes,
        "bins",
        callback=lambda found, _: scores.append(score(found)),
        settings=quick(400),
    )
    assert packing.problems() == [] and packing.left_out == (0,)
    assert [each.size for each in packing.containers] in (
        [(2.0, 2.0, 2.0), (2.0, 1.0, 1.0)],
        [(2.0, 1.0, 1.0), (2.0, 2.0, 2.0)],
    )
    assert packing.density == pytest.approx(0.9**3) and len(scores) > 1
    assert scores == sorted(set(scores), reverse=True)
    packing.write(tmp_path / "packing.json")
    report = verify_packing(tmp_path / "packing.json")
    assert report.is_valid and report.density == pytest.approx(packing.density)


def test_bins_of_several_sizes_hold_what_fits_only_into_one(tmp_path) -> None:
    bar = creation.box((0.5, 0.5, 5))
    sizes = [BoxContainer(size) for size in ((2, 2, 2), (0.6, 0.7, 5.1))]
    packing = nest(
        [of(bar, "bar", demand=2), of(cube(), demand=3)], sizes, "bins", settings=quick()
    )
    assert packing.problems() == [] and not any(packing.left_out)
    used = [packing.container_of(each.box).size for each in packing.placements if each.type == 0]
    assert used == [sizes[1].size] * 2 and packing.boxes == 3


@pytest.mark.parametrize("objective", ["strip", pytest.param("bins", marks=pytest.mark.slow)])
def test_a_clearance_holds(objective) -> None:
    clearance = 0.07
    size = (3, 3, OPEN) if objective == "strip" else (2.4, 2.4, 2.4)
    items = [*few(), of(bowl(), "bowl"), of(ball(), "ball", demand=2)]
    packing = nest(items, size, objective, clearance=clearance, settings=quick(15))
    check(packing)
    bodies = placed(packing)
    least = math.inf
    for (box, one), (other_box, other) in combinations(bodies, 2):
        if box == other_box:
            least = min(least, solid(one).min_gap(solid(other), 1.0))
    assert clearance <= least < 2 * clearance


def wall(*extents: float, at: tuple[float, float, float], name: str = "wall") -> ItemType:
    """A box whose lower corner is at a place in the container."""
    box = creation.box(extents)
    return of(box.apply_translation(np.array(at) + np.array(extents) / 2), name)


@pytest.mark.parametrize(
    ("objective", "size", "clearance"),
    [("strip", (3, 3, OPEN), 0.0), ("knapsack", (2.6, 2.6, 2.6), 0.05)],
)
def test_items_keep_clear_of_obstacles(objective, size, clearance, tmp_path) -> None:
    """One obstacle stands inside, one reaches through a wall; neither counts as packed."""
    obstacles = [wall(0.5, 0.5, 1.5, at=(1.1, 1.2, 0)), wall(2, 0.7, 9, at=(-1, -0.5, -3))]
    packing = nest(
        mixed("cube"),
        BoxContainer(size, tuple(obstacles)),
        objective,
        clearance=clearance,
        settings=quick(60, workers=2),
    )
    check(packing)
    assert len(packing.placements) == 8 if objective == "strip" else packing.placements
    assert packing.height < 4
    slack = tolerance(packing.container.longest, 1.0)
    for _, mesh in placed(packing):
        for each in obstacles:
            gap = solid(mesh).min_gap(solid(trimesh.Trimesh(each.vertices, each.faces)), 1.0)
            common = solid(mesh) ^ solid(trimesh.Trimesh(each.vertices, each.faces))
            assert gap >= clearance and common.volume() <= slack * mesh.area
    packing.write(tmp_path / "packing.json")
    report = verify_packing(tmp_path / "packing.json")
    assert report.is_valid and report.volume == pytest.approx(packing.volume)


def test_an_obstacle_that_is_no_item_type_is_an_error() -> None:
    with pytest.raises(ArgumentError, match=r"obstacles\[0\] is of type int: choose an ItemType"):
        BoxContainer((2, 2, 2), (3,))  # type: ignore[arg-type]


def test_an_item_in_an_obstacle_is_found(tmp_path) -> None:
    packing = nest([of(cube(), "cube")], (3, 3, OPEN), settings=quick(1))
    for obstacle, problem in (
        (wall(3, 3, 0.5, at=(0, 0, 0), name="plate"), "crosses plate"),
        (wall(9, 9, 9, at=(-3, -3, -3), name="block"), "lies, in part or whole, inside block"),
    ):
        blocked = replace(packing, container=BoxContainer((3, 3, OPEN), (obstacle,)))
        (sentence,) = blocked.problems()
        assert sentence == f"item 0 ('cube') {problem}"
        blocked.write(tmp_path / "packing.json")
        assert not verify_packing(tmp_path / "packing.json").is_valid
    above = BoxContainer((3, 3, OPEN), (wall(3, 3, 3, at=(0, 0, 1.1)),))
    assert replace(packing, container=above).problems() == []


def test_an_obstacle_outside_the_folder_is_not_read(tmp_path) -> None:
    plate = wall(1, 1, 0.5, at=(0, 0, 2))
    packing = nest([of(cube())], BoxContainer((3, 3, OPEN), (plate,)), settings=quick(1))
    packing.write(tmp_path / "packing.json")
    text = (tmp_path / "packing.json").read_text()
    (mesh,) = {each["mesh"] for each in json.loads(text)["obstacles"]}
    (tmp_path / "packing.json").write_text(text.replace(mesh, "../plate.obj"))
    with pytest.raises(PackFormatError, match=r"obstacles\[0\].mesh.*inside the packing's folder"):
        verify_packing(tmp_path / "packing.json")


def test_an_obstacle_that_fills_the_box_leaves_no_room() -> None:
    full = (wall(2, 2, 2, at=(0, 0, 0)),)
    packing = nest([of(cube())], BoxContainer((2, 2, 2), full), "knapsack", settings=quick())
    assert packing.left_out == (1,)
    above = nest([of(cube())], BoxContainer((2, 2, OPEN), full), settings=quick())
    assert above.problems() == [] and above.height == pytest.approx(3, abs=1e-3)


@pytest.mark.parametrize(
    ("objective", "size"),
    [("strip", (3, 3, OPEN)), ("knapsack", (2.5, 2.5, 2.5)), ("bins", (2.2, 2.2, 2.2))],
)
def test_a_search_begins_with_a_former_packing(objective, size) -> None:
    former = nest(mixed("cube"), size, objective, settings=quick(60))
    first: list[Packing] = []
    again = nest(
        mixed("cube"),
        size,
        objective,
        seed=7,
        callback=lambda found, _: first.append(found),
        settings=replace(quick(1), start=former),
    )
    check(again)
    assert {p.matrix.round(9).tobytes() for p in first[0].placements} >= {
        p.matrix.round(9).tobytes() for p in former.placements
    }
    if objective == "bins":
        return
    obstacle = wall(1, 1, 1, at=(0.8, 0.8, 0.8))
    moved = nest(
        mixed("cube"),
        BoxContainer(size, (obstacle,)),
        objective,
        settings=replace(quick(1), start=former, search=SearchSettings(finishing_moves=0)),
    )
    check(moved)
    kept = {p.matrix.tobytes() for p in moved.placements} & {
        p.matrix.tobytes() for p in first[0].placements
    }
    assert kept and len(kept) < len(former.placements)


@pytest.mark.parametrize(
    ("objective", "size"),
    [("strip", (3, 3, OPEN)), ("knapsack", (2.5, 2.5, 2.5)), ("bins", (2.2, 2.2, 2.2))],
)
@pytest.mark.parametrize("sinks", [False, True])
def test_a_valid_packing_to_begin_with_stays_whole(
    objective, size, sinks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For the search, its items may be in conflict; those of an invalid one are placed again."""
    former = nest(mixed("cube"), size, objective, settings=quick(60))
    if sinks:
        first, *others = former.placements
        moved = Placement.from_matrix(first.type, others[0].matrix, others[0].box)
        former = replace(former, placements=(moved, *others))
    asked: list[tuple[Poses, Poses]] = []

    def without_first(problem: Problem, task: SearchTask, poses: Poses, boxes: Floats) -> Poses:
        left = poses.changed(np.flatnonzero(poses.inside)[:1], 0)
        asked.append((poses, left))
        return left

    starts: list[Poses | None] = []
    constructed = filling.constructed

    def noted(problem: Problem, task: SearchTask, *others: Any, **named: Any) -> Poses:
        starts.append(task.start)
        return constructed(problem, task, *others, **named)

    monkeypatch.setattr(nest_module, "repaired", without_first)
    for module in (strips, knapsacks, bins):
        monkeypatch.setattr(module, "constructed", noted)
    check(nest(mixed("cube"), size, objective, settings=replace(quick(1), start=former)))
    whole, left = asked[0]
    assert starts[0] is (left if sinks else whole)


def test_nothing_is_put_into_a_closed_body_but_into_an_open_one() -> None:
    """The small boxes fit into either body; only the strip with bowls gets as low as that."""
    small = of(creation.box((0.8, 0.8, 0.8)), "small", demand=4)
    shut = nest([of(hollow(), "hollow"), small], (2.01, 2.01, OPEN), settings=quick(100))
    assert shut.problems() == [] and shut.height >= 2.8 - 1e-3
    into = nest(
        [of(bowl(), "bowl", rotations="fixed"), small], (2.01, 2.01, OPEN), settings=quick(700)
    )
    check(into)
    assert into.height < 1.25


def test_the_same_seed_gives_the_same_packing_in_every_process() -> None:
    code = (
        "from tests.test_nest import few, quick, text\n"
        "import hashlib, math, packit_sim\n"
        "found = packit_sim.nest(few(), (2.5, 2.5, math.inf), seed=5, settings=quick(60))\n"
        "print(hashlib.sha256(text(found)).hexdigest())"
    )
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    process = subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True
    )
    run = partial(nest, few(), (2.5, 2.5, OPEN), settings=quick(60))
    found = text(run(seed=5))
    assert text(run(seed=5)) == found  # with the fields of the run before
    assert text(run(seed=6)) != found
    output, _ = process.communicate(timeout=300)
    assert output.strip() == hashlib.sha256(found).hexdigest()


@pytest.mark.parametrize(
    ("objective", "size"),
    [("strip", (2, 2, OPEN)), ("knapsack", (1.7, 1.7, 1.7)), ("bins", (1.7, 1.7, 1.7))],
)
def test_two_workers_pack_items_of_many_sizes(objective, size) -> None:
    """So many items that the largest are searched for alone at first."""
    sides = {1.0: 2, 0.6: 4, 0.4: 6, 0.25: 8}
    cubes = [of(creation.box((side,) * 3), str(side), demand=n) for side, n in sides.items()]
    scores: list[float] = []
    score = {
        "strip": lambda p: p.height,
        "knapsack": lambda p: -p.volume,
        "bins": lambda p: p.boxes,
    }
    packing = nest(
        cubes,
        size,
        objective,
        callback=lambda found, _: scores.append(score[objective](found)),
        settings=quick(300, workers=2),
    )
    check(packing)
    assert scores == sorted(scores, reverse=True)
    if objective == "knapsack":
        assert packing.volume > 0.45 * packing.container.volume
    else:
        assert packing.left_out == (0, 0, 0, 0)
        assert packing.height < 2 if objective == "strip" else packing.boxes == 2


@pytest.mark.slow
def test_two_workers_exchange_the_best_and_are_repeatable() -> None:
    def run() -> Packing:
        return nest(mixed("axis-4"), (3, 3, OPEN), seed=1, settings=quick(250, workers=2))

    packing = run()
    check(packing)
    assert text(run()) == text(packing)
    first: list[float] = []
    nest(
        mixed("axis-4"),
        (3, 3, OPEN),
        seed=1,
        callback=lambda found, _: first.append(found.height),
        settings=quick(1),
    )
    assert packing.height < first[0]


def test_a_short_time_gives_a_constructed_packing_without_other_processes(monkeypatch) -> None:
    monkeypatch.setattr(parallel.Workers, "map", pytest.fail)
    found = []
    settings = NestSettings(workers=2)
    packing = nest(
        mixed("cube"),
        (3, 3, OPEN),
        time=1e-9,
        callback=lambda each, seconds: found.append((each, seconds)),
        settings=settings,
    )
    check(packing)
    ((first, seconds),) = found
    assert first is packing and seconds > 0
    done = nest([of(cube(), demand=8)], (2, 2, OPEN), time=60, settings=settings)
    assert done.height == pytest.approx(2, abs=1e-3)


def test_the_processor_clock_counts_what_the_workers_compute_and_nothing_else() -> None:
    budget = SearchBudget(0.05, clock="processor")
    time.sleep(0.1)
    assert not budget.is_spent
    while not budget.is_spent:
        pass
    assert budget.progress >= 1
    settings = NestSettings(workers=2, clock="processor")
    before = time.process_time()
    ends: list[float] = []
    nest(mixed("cube"), (3, 3, OPEN), time=1.5, settings=settings,
         callback=lambda _, seconds: ends.append(seconds))  # fmt: skip
    assert ends == sorted(ends) and ends[-1] <= time.process_time() - before


def interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def test_an_interrupt_returns_the_best_so_far() -> None:
    packing = nest(mixed("cube"), (3, 3, OPEN), callback=interrupt, settings=quick())
    check(packing)
    assert packing.left_out == (0, 0, 0, 0)


def test_an_interrupt_before_the_first_packing_is_one(monkeypatch) -> None:
    monkeypatch.setattr(nest_module.Problems, "get", interrupt)
    with pytest.raises(KeyboardInterrupt):
        nest([of(cube())], (3, 3, OPEN), settings=quick())


def test_another_thread_ends_the_search() -> None:
    stop = threading.Event()
    timer = threading.Timer(0.5, stop.set)
    timer.start()
    packing = nest(
        mixed("cube"), (3, 3, OPEN), time=3600, settings=NestSettings(workers=2, stop=stop)
    )
    assert packing.problems() == [] and packing.left_out == (0, 0, 0, 0)


@pytest.mark.slow
def test_ctrl_c_ends_the_workers_and_returns_the_best() -> None:
    code = (
        "from tests.test_nest import mixed, text\n"
        "import math, packit_sim\n"
        "settings = packit_sim.NestSettings(workers=2)\n"
        "print('ready', flush=True)\n"
        "found = packit_sim.nest(mixed('cube'), (3, 3, math.inf), time=300, settings=settings)\n"
        "print(found.problems(), len(found.placements))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    time.sleep(10)
    os.killpg(process.pid, signal.SIGINT)
    sent = time.monotonic()
    output, _ = process.communicate(timeout=60)
    assert output == "[] 8\n" and process.returncode == 0
    assert time.monotonic() - sent < 5


def test_a_packing_that_is_not_valid_is_dropped(monkeypatch) -> None:
    """Every second packing fails the check: only those that passed are reported and returned."""
    passed: list[float] = []
    real = Packing.problems

    def sometimes(packing: Packing) -> list[str]:
        sometimes.calls += 1  # type: ignore[attr-defined]
        return real(packing) if sometimes.calls % 2 == 0 else ["wrong"]  # type: ignore[attr-defined]

    sometimes.calls = 0  # type: ignore[attr-defined]
    monkeypatch.setattr(Packing, "problems", sometimes)
    packing = nest(
        few(),
        (2.5, 2.5, OPEN),
        callback=lambda found, _: passed.append(found.height),
        settings=quick(150),
    )
    assert passed == sorted(set(passed), reverse=True) and passed[-1] == packing.height
    monkeypatch.setattr(Packing, "problems", lambda packing: ["wrong"])
    with pytest.raises(NestingError, match="no valid packing"):
        nest(few(), (3, 3, OPEN), settings=quick(20))


def test_items_can_be_mesh_files_and_items_of_libraries(tmp_path) -> None:
    cube().export(tmp_path / "cube.stl")
    library = ShapeLibrary.open("everyday")
    item = Item(library[next(iter(library))], 0.1)
    packing = nest(
        [tmp_path / "cube.stl", str(tmp_path / "cube.stl"), item], (2, 2, OPEN), settings=quick(3)
    )
    assert packing.problems() == [] and len(packing.placements) == 3
    packing.write(tmp_path / "packing.json")


NAN = np.where(np.arange(24).reshape(8, 3) == 5, np.nan, cube().vertices)

WRONG: list[tuple[Callable[[], object], type[PackItError], str]] = [
    (lambda: nest([], (1, 1, OPEN)), ArgumentError, "items is empty"),
    (lambda: nest("cube.stl", (1, 1, OPEN)), ArgumentError, "'cube.stl'.*sequence"),
    (lambda: nest([cube()], (2, 2, OPEN)), ArgumentError, r"items\[0\] is of type Trimesh.*Item"),  # type: ignore[list-item]
    (
        lambda: nest([of(creation.box((3, 3, 1)), "plate")], (2, 2, OPEN)),
        ArgumentError,
        "'plate' of 3 x 3 x 1 does not fit.* 2 x 2 x inf in any of its rotations .cube",
    ),
    (
        lambda: nest([of(creation.box((1, 1, 3)), "rod", rotations="yaw-4")], (2, 2, 2), "bins"),
        ArgumentError,
        "'rod' of 1 x 1 x 3 does not fit.* 2 x 2 x 2",
    ),
    (lambda: of(cube(), demand=0), ArgumentError, "demand of 0.*at least 1"),
    (lambda: of(cube(), rotations="some"), ArgumentError, "'some'.*fixed, yaw-N.*cube, free"),
    (lambda: of(cube(), value=-1), ArgumentError, "value of -1.*at least 0"),
    (lambda: of(trimesh.Trimesh()), MeshError, "no triangles|empty"),
    (lambda: ItemType("nan", NAN, cube().faces), MeshError, "finite"),
]

ARGUMENTS: list[tuple[dict[str, Any], type[PackItError], str]] = [
    ({"clearance": -0.1}, ArgumentError, "clearance -0.1.*at least 0"),
    ({"clearance": math.nan}, ArgumentError, "clearance nan"),
    ({"clearance": 4.01}, ArgumentError, "clearance 4.01.*at most 4, 4 times the longest side"),
    ({"time": 0}, ArgumentError, "time 0.*above 0"),
    ({"time": -3.0}, ArgumentError, "time -3.0"),
    ({"time": math.nan}, ArgumentError, "time nan"),
    ({"time": math.inf}, ArgumentError, "time inf.*at most 1000000000"),
    ({"seed": -1}, ArgumentError, "seed -1.*0 to "),
    ({"seed": 0.5}, ArgumentError, "seed 0.5.*integer"),
    ({"objective": "tower"}, ArgumentError, "'tower'.*strip, knapsack, bins"),
    ({"container": (2, 2, 2)}, ArgumentError, "'strip' needs a box with no height.*2 x 2 x 2"),
    ({"objective": "knapsack"}, ArgumentError, "'knapsack' needs a box with a height"),
    ({"objective": "bins"}, ArgumentError, "'bins' needs a box with a height"),
    ({"container": (2, 2)}, ArgumentError, r"\(2, 2\).*three numbers"),
    ({"container": 2}, ArgumentError, "2 is not possible.*three numbers"),
    ({"container": (0, 2, OPEN)}, ArgumentError, "side 0.0 along x"),
    (
        {"container": BoxContainer((2, 2, 2), (of(cube()),)), "objective": "bins"},
        ArgumentError,
        "obstacles are not possible.*bins",
    ),
    (
        {"container": [BoxContainer((2, 2, 2)), (3, 3, 3)], "objective": "bins"},
        ArgumentError,
        r"container\[1\] \(3, 3, 3\) is not possible",
    ),
    (
        {"container": [BoxContainer((2, 2, OPEN)), BoxContainer((3, 2, OPEN))]},
        ArgumentError,
        "objective 'strip' needs one container, not 2",
    ),
    (
        {
            "items": [of(cube(), "dice"), of(creation.box((3, 3, 3)), "block")],
            "container": [BoxContainer((2, 2, 2)), BoxContainer((9, 1, 1))],
            "objective": "bins",
        },
        ArgumentError,
        "'block' of 3 x 3 x 3 does not fit into a container of 9 x 1 x 1 or 2 x 2 x 2",
    ),
    (
        {"settings": NestSettings(start=Packing((of(ball()),), BoxContainer((2, 2, OPEN)), ()))},
        ArgumentError,
        "other items",
    ),
    ({"settings": NestSettings(iterations=0)}, ArgumentError, "iterations 0.*1 to 1000000000"),
    ({"settings": NestSettings(iterations=-2)}, ArgumentError, "iterations -2"),
    ({"settings": NestSettings(iterations=1.5)}, ArgumentError, "iterations 1.5.*integer"),  # type: ignore[arg-type]
    ({"settings": NestSettings(clock="sun")}, ArgumentError, "clock 'sun'.*wall or processor"),  # type: ignore[arg-type]
    ({"settings": NestSettings(workers=-1)}, WorkersError, "-1 workers.*0 for one per core"),
    ({"settings": NestSettings(backend="ssh")}, WorkersError, "'ssh'.*threads, ray"),  # type: ignore[arg-type]
]


@pytest.mark.parametrize(("call", "kind", "message"), WRONG, ids=[each[-1] for each in WRONG])
def test_items_that_are_not_possible_are_one_error(call, kind, message) -> None:
    with pytest.raises(kind, match=message) as raised:
        call()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("changed", "kind", "message"), ARGUMENTS, ids=[each[-1] for each in ARGUMENTS]
)
def test_arguments_that_are_not_possible_are_one_error(changed, kind, message) -> None:
    arguments = {"items": [of(cube())], "container": BoxContainer((2, 2, OPEN)), **changed}
    with pytest.raises(kind, match=message) as raised:
        nest(**arguments)
    assert "\n" not in str(raised.value)


def cup() -> trimesh.Trimesh:
    """A cone with a wall of 0.4 along z, open above; in another one, it is 0.4 higher."""
    profile = [(0, 0), (1.5, 0), (3, 4), (3, 4.4), (1.5, 0.4), (0, 0.4)]
    return creation.revolve(profile, sections=48)


@pytest.mark.parametrize(
    ("work", "most"),
    [(SearchSettings().refined_work, 1.1), pytest.param(0, 1.4, marks=pytest.mark.slow)],
)
def test_equal_cups_are_stacked(work: int, most: float) -> None:
    """Close by exact fields; if there were too many of them, still inside each other."""
    settings = replace(quick(150), search=SearchSettings(refined_work=work))
    cups = of(cup(), "cup", demand=5, rotations="axis-4")
    packing = nest([cups], (6.01, 6.01, OPEN), settings=settings)
    assert packing.height < most * (4.4 + 4 * 0.4)
