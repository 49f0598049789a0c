"""Items as cells: places are the lowest of all, shared cells are counted, packings are valid."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim import BoxContainer, ItemType, NestSettings, nest
from packit_sim.parts.nesting import cell_strips, filling, finer_sides, knapsacks
from packit_sim.parts.nesting import cells as cells_module
from packit_sim.parts.nesting.build import build, have_many_fields
from packit_sim.parts.nesting.cell_filling import cell_side, filled_cells
from packit_sim.parts.nesting.cell_orders import hardest_first, most_valuable_first
from packit_sim.parts.nesting.cell_separation import CellSeparation
from packit_sim.parts.nesting.cell_separation_kernels import CellState, put_on_grid
from packit_sim.parts.nesting.cell_strips import CellStripSearch
from packit_sim.parts.nesting.cells import Cells, Space, cells_of, least_side
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.limits import ItemLimits
from packit_sim.parts.nesting.placement_kernels import SIDES, cover, inner_cubes, update_windows
from packit_sim.parts.nesting.problem import Problem, boxes_of, state_of
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS
from packit_sim.parts.nesting.settling_kernels import count_conflicts
from packit_sim.parts.nesting.tasks import CLOCKS, Poses, SearchBudget, SearchTask, Solution
from packit_sim.parts.nesting.voxel_sets import placed_voxels, voxelized

SIDE = 0.21
"""The side of cells, which no size of an item is a multiple of."""

BY_CELLS = replace(DEFAULT_SETTINGS, most_fields=0, cell_patience=20, finest_cells=44)


def shapes(count: int, rotations: str = "cube") -> list[ItemType]:
    """Return different rings, cones and plates."""
    rng = np.random.default_rng(1)
    found = []
    for n in range(count):
        a, b, c = rng.uniform(0.6, 1.6, 3)
        if n % 3 == 0:
            mesh = creation.annulus(r_min=0.6 * a, r_max=a, height=b, sections=12)
        elif n % 3 == 1:
            mesh = creation.cone(radius=a, height=2 * b, sections=10)
        else:
            mesh = creation.box((2 * a, b, 0.3 * c))
        found.append(ItemType(f"item {n}", mesh.vertices, mesh.faces, rotations=rotations))
    return found


def solid(cells: Cells, t: int, o: int) -> Any:
    """Return the cells of a type in a rotation, from its words."""
    start, _, plane, words, x, y, z = cells.forms[t, o]
    planes = cells.bits[start : start + words * plane].reshape(words, x, y)
    octets = np.ascontiguousarray(planes.transpose(1, 2, 0)).astype("<u8").view(np.uint8)
    return np.unpackbits(octets, axis=2, bitorder="little")[:, :, :z].astype(bool)


def lowest_by_trial(taken: Any, own: Any) -> int | None:
    """Return the lowest top of an item in a grid, by trying every position."""
    x, y, z = own.shape
    for k in range(taken.shape[2] - z + 1):
        for i in range(taken.shape[0] - x + 1):
            for j in range(taken.shape[1] - y + 1):
                if not (taken[i : i + x, j : j + y, k : k + z] & own).any():
                    return k + z
    return None


@pytest.mark.parametrize(
    ("rotations", "floor"), [("cube", 0), ("cube", 1), ("cube", 2), ("cube", 3), ("axis-6", 0)]
)
def test_items_go_to_the_lowest_of_all_places(rotations: str, floor: int) -> None:
    """Four cells in height share a word, hence four heights of the floor."""
    types = shapes(9, rotations)
    problem = build(types, 4.4, 0.0, by_cells=True, has_fields=False)
    cells = cells_of(problem, SIDE)
    space = Space(cells, boxes_of([(4.4, 4.0, math.inf)])[0])
    taken = np.zeros((20, 19, 120), bool)
    if floor:
        taken[:, :, :floor] = True
        plate = creation.box(bounds=((-1, -1, -1), (6, 6, (floor - 0.1) * SIDE)))
        space.put(np.asarray(plate.triangles), 0.0)
    tops = []
    for t in range(len(types)):
        turns = problem.allowed[t, : problem.allowed_counts[t]]
        least = min(lowest_by_trial(taken, solid(cells, t, o)) or 10**6 for o in turns)
        o, place = space.lowest(t, turns) or (0, np.zeros(3))
        own = solid(cells, t, o)
        i, j, k = np.round(place / SIDE - np.array(own.shape) / 2).astype(int)
        x, y, z = own.shape
        assert k + z == least
        assert not (taken[i : i + x, j : j + y, k : k + z] & own).any()
        corners = types[t].vertices - (types[t].low + types[t].high) / 2
        triangles = (corners @ problem.lookup.turns[o].T + place)[types[t].faces]
        low, placed = placed_voxels(triangles, SIDE, 0.0)
        for cell in np.argwhere(placed) + low:
            if (cell >= 0).all() and (cell < taken.shape).all():
                taken[tuple(cell)] = True
        space.put(triangles, 0.0)
        tops.append(k + z)
    assert max(tops) > 16  # longer than any window


def test_there_is_no_place_in_a_low_box_and_in_a_full_one() -> None:
    problem = build(shapes(3), 4.4, 0.0, by_cells=True, has_fields=False)
    cells = cells_of(problem, SIDE)
    turns = problem.allowed[0, : problem.allowed_counts[0]]
    assert Space(cells, boxes_of([(4.4, 4.4, 0.5)])[0]).lowest(0, turns) is None
    space = Space(cells, boxes_of([(4.4, 4.4, 4.4)])[0])
    assert space.lowest(0, turns) is not None
    full = creation.box((4.4, 4.4, 4.4)).apply_translation((2.2, 2.2, 2.2)).triangles
    space.put(np.asarray(full), 0.0)
    assert space.lowest(0, turns) is None


def test_the_hull_of_an_item_says_how_hard_it_is_to_place() -> None:
    ring = creation.annulus(r_min=0.9, r_max=1.0, height=1.0, sections=24)
    block = creation.box((0.9, 0.9, 0.9))
    types = [ItemType(f"{n}", mesh.vertices, mesh.faces) for n, mesh in enumerate((block, ring))]
    assert types[0].volume > types[1].volume
    problem = build(types, 4.0, 0.0, BY_CELLS, by_cells=True, has_fields=False)
    volumes = np.array([each.volume for each in types])
    task = SearchTask(np.array([0, 1]), volumes, volumes, ((4.0, 4.0, math.inf),), BY_CELLS)
    assert hardest_first(problem, task).tolist() == [1, 0]
    task = replace(task, sizes=((1.2, 1.2, 1.2),))
    assert most_valuable_first(problem, task).tolist() == [0, 1]
    assert problem.hulls == pytest.approx([0.729, math.pi], rel=0.02)
    equal = replace(task, values=np.ones(2))  # the smaller hull first, whatever the volumes
    assert most_valuable_first(problem, equal).tolist() == [0, 1]
    limits = ItemLimits(np.array([[1.0, 0.1]]), np.array([1.0]))
    limited = replace(task, limits=limits)
    assert most_valuable_first(problem, limited).tolist() == limited.order.tolist() == [1, 0]
    roomy = replace(equal, sizes=((4.0, 4.0, 4.0),))
    assert most_valuable_first(problem, roomy).tolist() == roomy.order.tolist() == [1, 0]


def test_windows_hold_whether_any_cell_is_taken() -> None:
    rng = np.random.default_rng(0)
    taken = rng.random((30, 26, 600)) < 0.004
    windows = np.zeros((8, 4, 3, 30, 26), np.uint64)
    for i, j, k in np.argwhere(taken):
        windows[0, k % 4, k // 256, i, j] |= np.uint64(1) << np.uint64(k // 4 % 64)
    update_windows(windows, 0, 0, 30, 26)
    padded = np.pad(taken, ((0, 16), (0, 16), (0, 256)))
    for number, side in enumerate(SIDES):
        for i, j, k in rng.integers((30, 26, 600), size=(300, 3)):
            word = windows[number, k % 4, k // 256, i, j]
            found = bool(word >> np.uint64(k // 4 % 64) & np.uint64(1))
            assert found == padded[i : i + side, j : j + side, k : k + side].any()


def with_holes() -> Any:
    """Return a block of cells of which some single ones are missing."""
    own = np.ones((12, 13, 40), np.uint8)
    own[tuple(np.random.default_rng(0).integers(own.shape, size=(20, 3)).T)] = 0
    return own


@pytest.mark.parametrize("kind", ["ring", "cone", "plate", "block with holes"])
def test_cubes_cover_a_solid_and_lie_in_it(kind: str) -> None:
    solids = [
        voxelized(each.vertices[each.faces] - (each.low + each.high) / 2, 0.05)
        for each in shapes(3)
    ]
    own = dict(zip(("ring", "cone", "plate"), solids, strict=True)).get(kind, with_holes())
    covered = np.zeros(own.shape, int)
    for i, j, k, side in cover(own):
        assert (np.array((i, j, k)) + side <= own.shape).all()
        covered[i : i + side, j : j + side, k : k + side] += 1
    assert np.array_equal(covered, own)
    large = inner_cubes(own, 30)
    assert (large[:-1, 3] >= large[1:, 3]).all() and len(large) > 3
    for i, j, k, side in large:
        assert (np.array((i, j, k)) + side <= own.shape).all()
        assert own[i : i + side, j : j + side, k : k + side].all()


def test_a_solid_at_a_place_has_the_cells_that_it_touches() -> None:
    triangles = np.asarray(creation.box((1, 1, 1)).apply_translation((0.55, 2.5, -0.5)).triangles)
    low, own = placed_voxels(triangles, 0.25, 0.0)
    x = low[0] + np.nonzero(own)[0]
    assert (x.min(), x.max()) == (0, 4)  # from 0.05 to 1.05
    low, grown = placed_voxels(triangles, 0.25, 0.3)
    y = low[1] + np.nonzero(grown)[1]
    assert (y.min(), y.max()) == (6, 13)  # from 1.7 to 3.3


def grid_of(problem: Problem, cells: Cells, places: Any) -> tuple[Any, CellState]:
    n = len(places)
    state = state_of(list(range(n)), n)
    state.inside[:] = 1
    matrix = np.zeros((n, n), np.float32)
    grid = CellState(
        np.zeros(3),
        np.zeros((6, n), np.int32).T,
        matrix,
        matrix.copy(),
        np.ones((n, n), np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.uint8),
    )
    put_on_grid(cells, state, grid, places, np.array([60, 60, 300]))
    return state, grid


def cut(cells: Any, low: Any, high: Any) -> Any:
    (a, b, c), (d, e, f) = low, high
    return cells[a:d, b:e, c:f]


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_bodies_around_types_have_their_own_cells(factor: float) -> None:
    """There is room for their words, however large they are."""
    types = shapes(6)
    bodies = [
        ItemType(one.name, one.middle + factor * (one.vertices - one.middle), one.faces)
        for one in types
    ]
    problem = build(types, 4.4, 0.0, by_cells=True, has_fields=False, bodies=bodies)
    alone = build(bodies, 4.4, 0.0, by_cells=True, has_fields=False)
    cells, expected = cells_of(problem, SIDE), cells_of(alone, SIDE)
    assert (cells.bits == expected.bits).all()
    assert (cells.forms == expected.forms).all()


def test_finer_cells_take_more_memory_and_never_more_than_is_allowed(monkeypatch) -> None:
    problem = build(shapes(9), 4.4, 0.0, by_cells=True, has_fields=False)
    allowed = cells_of(problem, SIDE).bits.nbytes
    monkeypatch.setattr(cells_module, "MOST_BYTES", 1.2 * allowed)
    assert least_side(problem, SIDE) == SIDE
    side = least_side(problem, 0.4 * SIDE)
    assert 0.4 * SIDE < side <= SIDE
    assert 0.7 * allowed < cells_of(problem, side).bits.nbytes <= 1.2 * allowed


def test_grids_make_room_before_another_one_is_computed(monkeypatch) -> None:
    problem = build(shapes(3), 6.0, 0.0, by_cells=True, has_fields=False)
    computed, kept = cells_module._computed, []

    def noted(given: Problem, side: float) -> Cells:
        kept.append(sum(each.bits.nbytes for each in cells_module._known.values()))
        return computed(given, side)

    monkeypatch.setattr(cells_module, "_known", {})
    monkeypatch.setattr(cells_module, "_computed", noted)
    sizes = [cells_of(problem, side).bits.nbytes for side in (SIDE, 0.9 * SIDE)]
    monkeypatch.setattr(cells_module, "MOST_KNOWN", sum(sizes))
    again = cells_of(problem, 0.8 * SIDE).bits.nbytes
    assert kept[:2] == [0, sizes[0]] and kept[2] + again <= sum(sizes)
    assert cells_of(problem, 0.8 * SIDE).bits.nbytes == again and len(kept) == 3


def test_shared_cells_are_counted() -> None:
    problem = build(shapes(12), 12.0, 0.0, by_cells=True, has_fields=False)
    rng = np.random.default_rng(3)
    places = rng.uniform(2, (6, 6, 40), (12, 3))
    places[:, 2] = places[:, 2] % 5 + 20 * (np.arange(12) % 2)
    for side in (0.2, 0.019):  # items of one word along z, and of several
        cells = cells_of(problem, side)
        state, grid = grid_of(problem, cells, places * (side / 0.2))
        for i in range(12):
            for j in range(i):
                shared = 0
                one, other = (solid(cells, t, state.turned[t]) for t in (i, j))
                p, q = grid.bounds[i, :3], grid.bounds[j, :3]
                low = np.maximum(p, q)
                high = np.minimum(p + one.shape, q + other.shape)
                if (low < high).all():
                    shared = int(
                        (cut(one, low - p, high - p) & cut(other, low - q, high - q)).sum()
                    )
                assert grid.shared[i, j] == grid.shared[j, i] == shared


def test_only_items_that_are_inside_are_separated() -> None:
    types = shapes(20)
    problem = build(types, 4.0, 0.0, by_cells=True, has_fields=False)
    count = len(types)
    size = 3.6, 3.6, math.inf
    task = SearchTask(np.arange(count), np.ones(count), np.ones(count), (size,), BY_CELLS)
    boxes = boxes_of([(3.6, 3.6, 5.0)])
    places = np.random.default_rng(3).uniform(1.5, 2.1, (count, 3))
    inside = (np.arange(count) % 2).astype(np.uint8)
    start = Poses(inside, np.zeros(count, int), places)
    state = loaded(problem, task, start, boxes)
    assert count_conflicts(problem, state) > 0
    attempt = CellSeparation(task, Solution((5.0,), start, boxes), SIDE, 0)
    rng = np.array([1], np.uint64)
    assert attempt.advance(problem, rng, SearchBudget(1, passes=1), True) is None
    assert attempt.least is start
    assert attempt.advance(problem, rng, SearchBudget(1, passes=2000), True)
    assert np.array_equal(attempt.least.inside, inside)
    assert np.array_equal(attempt.least.places[::2], places[::2])
    assert count_conflicts(problem, loaded(problem, task, attempt.least, boxes)) == 0


def test_an_attempt_in_too_little_space_fails_and_keeps_all_items() -> None:
    types = shapes(6)
    problem = build(types, 4.0, 0.0, by_cells=True, has_fields=False)
    count = len(types)
    task = SearchTask(
        np.arange(count), np.ones(count), np.ones(count), ((4.0, 4.0, math.inf),), BY_CELLS
    )
    start = Poses(np.ones(count, np.uint8), np.zeros(count, int), np.ones((count, 3)))
    attempt = CellSeparation(task, Solution((2.0,), start, boxes_of([(4, 4, 2)])), SIDE, 8)
    rng = np.array([1], np.uint64)
    assert attempt.advance(problem, rng, SearchBudget(1, passes=2000), True) is False
    assert attempt.least.inside.all()


def test_the_hardest_items_are_arranged_first(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []
    begun = CellSeparation.__init__

    def note(self: CellSeparation, task: SearchTask, start: Solution, *given: Any) -> None:
        counts.append(int(start.poses.inside.sum()))
        begun(self, task, start, *given)

    monkeypatch.setattr(CellSeparation, "__init__", note)
    types = shapes(24)
    settings = NestSettings(workers=1, iterations=400, search=BY_CELLS)
    packing = nest(types, (4.4, 4.2, math.inf), settings=settings)
    assert packing.problems() == [] and not any(packing.left_out)
    assert sorted(set(counts)) == [6, 12, 24] and counts == sorted(counts)
    counts.clear()
    later = nest(types, (4.4, 4.2, math.inf), settings=replace(settings, start=packing))
    assert later.height <= packing.height * (1 + 1e-9) and set(counts) == {24}


@pytest.mark.parametrize("clearance", [0.0, 0.08])
def test_strips_of_many_types_are_valid_complete_and_improve(clearance: float) -> None:
    types = shapes(18)
    heights: list[float] = []
    settings = NestSettings(workers=1, iterations=100, search=BY_CELLS)
    packing = nest(
        types,
        (4.4, 4.2, math.inf),
        clearance=clearance,
        settings=settings,
        callback=lambda better, _: heights.append(better.height),
    )
    assert packing.problems() == [] and not any(packing.left_out)
    assert heights == sorted(heights, reverse=True)
    assert heights[-1] < heights[0]
    again = nest(types, (4.4, 4.2, math.inf), clearance=clearance, settings=settings)
    assert again.height == packing.height


@pytest.mark.parametrize("seconds", [10.0, 55.0])
def test_no_construction_begins_that_would_not_end(seconds: float, monkeypatch) -> None:
    """Constructions on cells of the first side take so many of the 100 seconds of a search."""
    clock, ends = [0.0], []

    def timed(problem: Problem, task: SearchTask, *given: Any) -> Poses:
        order, side = given[2], given[5]
        share = (len(order) / task.count) ** 1.15
        clock[0] += seconds * share * (cell_side(problem, task) / side) ** 2.3
        if len(order) == task.count:
            ends.append(clock[0])
        return filled_cells(problem, task, *given)

    def now() -> float:
        clock[0] += 0.2
        return clock[0]

    for module in (cell_strips, filling, finer_sides):
        monkeypatch.setattr(module, "filled_cells", timed)
    monkeypatch.setitem(CLOCKS, "wall", now)
    settings = NestSettings(workers=1, search=BY_CELLS)
    packing = nest(shapes(18), (4.4, 4.2, math.inf), time=100.0, settings=settings)
    assert packing.problems() == []
    assert 2 <= len(ends) <= 3 and ends[-1] < 80


def test_a_knapsack_of_many_types_is_valid_and_leaves_out_what_does_not_fit() -> None:
    types = shapes(36)
    settings = NestSettings(workers=1, iterations=1, search=BY_CELLS)
    packing = nest(types, (5, 5, 4), "knapsack", settings=settings)
    assert packing.problems() == []
    assert any(packing.left_out) and packing.volume > 0.4 * 100


def test_a_search_that_is_late_does_not_fill_again_and_again(monkeypatch) -> None:
    fills = []

    def counted(*given: Any) -> Poses:
        fills.append(given)
        return filled_cells(*given)

    monkeypatch.setattr(knapsacks, "filled_cells", counted)
    settings = NestSettings(workers=1, search=replace(BY_CELLS, construction_seconds=0.0))
    packing = nest(shapes(80), (5, 5, 4), "knapsack", time=0.1, settings=settings)
    assert packing.problems() == []
    assert len(fills) <= 1


def test_items_as_cells_keep_clear_of_obstacles_and_of_a_start() -> None:
    types = shapes(9)
    post = creation.box((1, 1, 30)).apply_translation((2.63, 2.57, 15))
    container = BoxContainer(
        (6.1, 6.1, math.inf), (ItemType("post", post.vertices, post.faces, rotations="fixed"),)
    )
    settings = NestSettings(workers=1, iterations=6, search=BY_CELLS)
    packing = nest(types, container, settings=settings)
    assert packing.problems() == [] and not any(packing.left_out)
    later = nest(types, container, settings=replace(settings, start=packing))
    assert later.problems() == []
    assert later.height <= packing.height * (1 + 1e-9)


def test_hollow_items_in_a_strip_have_too_many_fields_sooner() -> None:
    cubes, tubes = (
        [ItemType(str(n), mesh.vertices, mesh.faces, rotations="cube") for n in range(3)]
        for mesh in (creation.box((1, 2, 3)), creation.annulus(r_min=0.9, r_max=1, height=2))
    )
    settings = replace(DEFAULT_SETTINGS, most_fields=144, most_hollow_fields=143)
    few = replace(settings, most_fields=143)  # there are 144: 6 pairs, 24 relative rotations
    for types in (cubes, tubes):
        assert not have_many_fields(types, False, settings)
        assert have_many_fields(types, False, few) and have_many_fields(types, True, few)
    assert have_many_fields(tubes, True, settings) and not have_many_fields(cubes, True, settings)
    enough = replace(settings, most_hollow_fields=144)
    assert not have_many_fields(tubes, True, enough)


def test_cells_are_for_strips_of_many_types_that_fit_on_a_grid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun = []
    init = CellStripSearch.__init__

    def note(self: CellStripSearch, *arguments: Any) -> None:
        begun.append(self)
        init(self, *arguments)

    monkeypatch.setattr(CellStripSearch, "__init__", note)
    few, settings = shapes(3), NestSettings(workers=1, iterations=1)
    nest(few, (5, 5, math.inf), settings=settings)
    assert not begun
    by_cells = replace(settings, search=BY_CELLS)
    nest(few, (5, 5, math.inf), settings=by_cells)
    assert len(begun) == 1
    bar = creation.box((5, 0.5, 0.5))  # cells would not reach both walls
    long = ItemType("bar", bar.vertices, bar.faces, rotations="fixed")
    nest([*few, long], (5, 5, math.inf), settings=by_cells)
    assert len(begun) == 1
