"""Lattices of equal items: as many as fit, free of conflicts, in the box."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import ItemType, NestSettings, nest
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.lattices import FEWEST, lattice_poses
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.settling_kernels import count_conflicts
from packit_sim.parts.nesting.tasks import Poses, SearchTask


def bracket() -> trimesh.Trimesh:
    """An L of two plates, 1 thick, of 6 x 3 each."""
    upright = creation.box((1, 6, 3)).apply_translation((0.5, 3, 1.5))
    foot = creation.box((5, 1, 3)).apply_translation((3.5, 0.5, 1.5))
    corners = np.concatenate((upright.vertices, foot.vertices))
    faces = np.concatenate((upright.faces, foot.faces + len(upright.vertices)))
    return trimesh.Trimesh(corners, faces, process=False)


def cup() -> trimesh.Trimesh:
    """A conical cup with a wall of 0.3."""
    outside = [(0, 0), (2, 0), (3, 6), (2.7, 6), (1.75, 0.3), (0, 0.3)]
    return creation.revolve(outside, sections=24)


def item(mesh: trimesh.Trimesh, rotations: str = "cube") -> ItemType:
    return ItemType("part", mesh.vertices, mesh.faces, rotations=rotations)


def task_of(size: tuple[float, float, float], count: int) -> SearchTask:
    return SearchTask(np.zeros(count, np.int64), np.ones(count), np.ones(count), (size,))


def grid(mesh: trimesh.Trimesh, size: tuple[float, float, float], gap: float) -> int:
    """Return how many bounding boxes fit in a grid, turned as is best."""
    counts = [
        math.prod(int((side + gap) / (own + gap)) for side, own in zip(size, sides, strict=True))
        for sides in permutations(mesh.extents)
    ]
    return max(counts)


def checked(problem: Problem, task: SearchTask, poses: Poses | None) -> int:
    """Return how many items there are, after a check of conflicts and walls."""
    assert poses is not None
    boxes = boxes_of([task.size])
    state = loaded(problem, task, poses, boxes)
    own = poses.inside > 0
    assert np.allclose(state.places[own], poses.places[own], atol=1e-6)  # none is moved inside
    assert count_conflicts(problem, state) == 0
    return int(own.sum())


@pytest.mark.parametrize("clearance", [0.0, pytest.param(0.2, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("mesh", "gains"),
    [
        (bracket(), {0.0: 1.4, 0.2: 1.4}),
        (cup(), {0.0: 2.1, 0.2: 1.3}),
        (creation.icosphere(2, 1.5), {0.0: 1.3, 0.2: 1.2}),
        (creation.cone(2, 4), {0.0: 2.4, 0.2: 2.0}),
    ],
    ids=["bracket", "cup", "ball", "cone"],
)
def test_a_lattice_holds_more_than_a_grid_of_bounding_boxes(
    mesh: trimesh.Trimesh, gains: dict[float, float], clearance: float
) -> None:
    size = (31.0, 26.0, 40.0)
    problem = build([item(mesh)], 26.0, clearance)
    task = task_of(size, 2000)
    found = checked(problem, task, lattice_poses(problem, task))
    assert found >= gains[clearance] * grid(mesh, size, clearance)


def test_boxes_fill_their_box_as_a_grid() -> None:
    problem = build([item(creation.box((3, 2, 1)))], 12.0, 0.0)
    task = task_of((12.0, 12.0, 12.0), 400)
    assert checked(problem, task, lattice_poses(problem, task)) == 12**3 / 6


def test_items_that_may_not_turn_keep_their_rotation_and_no_more_are_placed_than_wanted() -> None:
    problem = build([item(cup(), "fixed")], 30.0, 0.0)
    task = task_of((30.0, 30.0, 30.0), 20)
    poses = lattice_poses(problem, task)
    assert checked(problem, task, poses) == 20
    assert poses is not None and not poses.turned.any()


def test_a_strip_is_filled_from_below() -> None:
    problem = build([item(cup())], 12.0, 0.0)
    task = task_of((12.0, 12.0, math.inf), 40)
    poses = lattice_poses(problem, task)
    assert checked(problem, task, poses) == 40
    assert poses is not None
    assert poses.places[:, 2].max() < 0.6 * 40 / 4 * 6  # of a grid's height


def test_several_types_few_items_and_obstacles_have_no_lattice() -> None:
    types = [item(cup()), item(bracket())]
    problem = build(types, 30.0, 0.0)
    several = SearchTask(np.arange(20) % 2, np.ones(20), np.ones(20), ((30.0, 30.0, 30.0),))
    assert lattice_poses(problem, several) is None
    problem = build(types[:1], 30.0, 0.0)
    assert lattice_poses(problem, task_of((30.0, 30.0, 30.0), FEWEST - 1)) is None
    assert lattice_poses(problem, task_of((30.0, 30.0, 1.0), FEWEST)) is None


def test_nesting_begins_with_a_lattice() -> None:
    settings = NestSettings(workers=1, iterations=1)
    types = [item(bracket()).changed(demand=500)]
    packing = nest(types, (31.0, 26.0, 40.0), "knapsack", settings=settings)
    assert packing.problems() == []
    assert len(packing.placements) >= 1.4 * grid(bracket(), (31.0, 26.0, 40.0), 0.0)
