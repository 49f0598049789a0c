"""Compaction lowers strips where no single item can go down, and leads to no conflict."""

import math
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.optimize import OptimizeResult

from packit_sim import ItemType
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.nesting import compaction
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.cell_filling import filled_cells, settle_all
from packit_sim.parts.nesting.compaction import SHAKEN, compact, shaken
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.problem import boxes_of
from packit_sim.parts.nesting.settling_kernels import count_conflicts
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask
from tests.test_cells import shapes


def block(x: float, y: float, z: float) -> ItemType:
    mesh = trimesh.creation.box((x, y, z))
    return ItemType(f"{x} x {y} x {z}", mesh.vertices, mesh.faces, rotations="fixed")


def wedge() -> ItemType:
    """A prism that stands on its edge, 1 wide and 1.5 high."""
    corners = [(x, y, z) for y in (-1, 1) for x, z in ((0, -0.75), (-0.5, 0.75), (0.5, 0.75))]
    mesh = trimesh.Trimesh(corners).convex_hull
    return ItemType("wedge", mesh.vertices, mesh.faces, rotations="fixed")


@pytest.mark.parametrize("clearance", [0.0, 0.05])
def test_a_wedge_goes_down_between_blocks_that_go_aside(clearance: float) -> None:
    types = [block(1, 2, 1), block(1, 2, 0.99), wedge()]
    problem = build(types, 4.0, clearance, by_cells=True, has_fields=False)
    task = SearchTask(np.arange(3), np.ones(3), np.ones(3), ((4.0, 2.0, math.inf),))
    places = np.array([(1.35, 1, 0.5), (2.65, 1, 0.5), (2, 1, 1.8)])
    poses = Poses(np.ones(3), np.zeros(3, int), places)
    state = loaded(problem, task, poses, boxes_of([task.size]))
    settle_all(problem, task, state, np.array([1], np.uint64))
    assert state.places[2, 2] > 1.25  # its edge is between the blocks, which can't go lower
    compact(problem, task, state, 30)
    assert count_conflicts(problem, state) == 0
    assert state.places[2, 2] == pytest.approx(0.75 + 1.5 * clearance, abs=0.1)


@pytest.mark.parametrize("clearance", [0.0, 0.08])
def test_strips_get_lower_without_a_conflict_and_obstacles_stay(clearance: float) -> None:
    types = shapes(18)
    post = trimesh.creation.box((0.5, 0.5, 6)).apply_translation((0.25, 0.25, 3))
    types.append(ItemType("post", post.vertices, post.faces, rotations="fixed"))
    problem = build(types, 4.4, clearance, by_cells=True, has_fields=False)
    task = SearchTask(
        np.arange(19),
        np.ones(18),
        np.ones(18),
        ((4.4, 4.2, math.inf),),
        obstacles=np.array([(0.25, 0.25, 3.0)]),
    )
    boxes = boxes_of([task.size])
    poses = filled_cells(
        problem, task, task.unplaced, boxes, np.arange(18), np.array([1], np.uint64)
    )
    assert poses.inside.all()
    poses.places[:18, 2] *= 1.1  # space between layers
    heights, state = [math.inf], loaded(problem, task, poses, boxes)

    def lowest() -> Floats:
        boxes = problem.lookup.boxes[state.types[:18], state.turned[:18]]
        return (state.places[:18] + boxes[:, :3]).min(axis=0)

    walls = lowest()
    for _ in range(4):
        heights.append(state.bounds[:18, 5].max())
        assert heights[-1] <= heights[-2] and count_conflicts(problem, state) == 0
        assert (lowest() >= np.minimum(walls, 0) - 1e-9).all()
        assert state.places[18].tolist() == [0.25, 0.25, 3.0]
        compact(problem, task, state, 1)
    assert heights[-1] < 0.98 * heights[1]


def test_items_stay_when_it_is_late() -> None:
    types = [block(1, 1, 1)]
    problem = build(types, 4.0, 0.0, by_cells=True, has_fields=False)
    task = SearchTask(np.arange(1), np.ones(1), np.ones(1), ((4.0, 4.0, math.inf),))
    poses = Poses(np.ones(1), np.zeros(1, int), np.array([(1.0, 1.0, 3.0)]))
    state = loaded(problem, task, poses, boxes_of([task.size]))
    compact(problem, task, state, 5, SearchBudget(9.0, latest=0.0))
    assert state.places[0, 2] >= 3.0 - 0.04 - 1e-9
    compact(problem, task, state, 200)
    assert state.places[0, 2] == pytest.approx(0.5, abs=1e-6)


def test_a_linear_program_ends_in_time_and_moves_nothing_then(monkeypatch) -> None:
    task = SearchTask(np.arange(1), np.ones(1), np.ones(1), ((4.0, 4.0, math.inf),))
    problem = build([block(1, 1, 1)], 4.0, 0.0, by_cells=True, has_fields=False)
    poses = Poses(np.ones(1), np.zeros(1, int), np.array([(1.0, 1.0, 3.0)]))
    state, limits = loaded(problem, task, poses, boxes_of([task.size])), []

    def unfinished(cost: Floats, *given: Any, options: dict[str, float], **more: Any) -> Any:
        limits.append(options["time_limit"])
        return OptimizeResult(status=1, x=np.full(len(cost), -9.0))

    monkeypatch.setattr(compaction, "linprog", unfinished)
    compact(problem, task, state, 1, SearchBudget(9.0, latest=5.0))
    compact(problem, task, state, 1)
    assert 0 < limits[0] <= 5 and limits[1] == math.inf
    assert state.places[0].tolist() == [1.0, 1.0, 3.0]


@pytest.mark.parametrize("clearance", [0.0, 0.08])
def test_a_strip_that_is_shaken_is_another_one_without_a_conflict_and_no_higher(
    clearance: float,
) -> None:
    problem = build(shapes(18), 4.4, clearance, by_cells=True, has_fields=False)
    task = SearchTask(np.arange(18), np.ones(18), np.ones(18), ((4.4, 4.2, math.inf),))
    boxes, choices = boxes_of([task.size]), np.random.default_rng(3)
    rng = np.array([1], np.uint64)
    poses = filled_cells(problem, task, task.unplaced, boxes, np.arange(18), rng)
    poses.places[:, 2] *= 1.1  # space between layers
    height = loaded(problem, task, poses, boxes).bounds[:18, 5].max()
    ways = []
    for _ in range(6):
        new = shaken(problem, task, poses, boxes, choices, None)
        state = loaded(problem, task, new, boxes)
        assert count_conflicts(problem, state) == 0
        assert state.bounds[:18, 5].max() <= height + 1e-6
        ways.append(np.abs(new.places - poses.places))
        assert ways[-1].max() <= SHAKEN[1] * 4.4 + 1e-9
        poses = new
    assert max(way.max() for way in ways) > 0.25 * SHAKEN[1] * 4.4
    assert sum((way.max(axis=1) > 0).all() for way in ways) >= 4
