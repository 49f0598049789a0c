"""A rebuilt box has other items than before, and none in conflict."""

from __future__ import annotations

import numpy as np
import pytest
from trimesh import creation

from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.filling import constructed, loaded, rebuilt
from packit_sim.parts.nesting.problem import boxes_of
from packit_sim.parts.nesting.tasks import SearchTask
from packit_sim.parts.packings.item_types import ItemType

SIZE = (4.0, 4.0, 4.0)


@pytest.mark.parametrize("obstacles", [0, 1])
def test_rebuilt_boxes_have_no_conflict_and_other_items(obstacles: int) -> None:
    meshes = [creation.box((1.5, 1, 2)), creation.cylinder(0.7, 2), creation.icosphere(2)]
    types = [ItemType(str(n), mesh.vertices, mesh.faces) for n, mesh in enumerate(meshes)]
    problem = build(types, max(SIZE), 0.0)
    numbers = np.repeat([0, 1, 2], 12)
    volumes = np.array([meshes[n].volume for n in numbers])
    task = SearchTask(
        np.append(numbers, [2] * obstacles),
        volumes,
        volumes,
        (SIZE,),
        obstacles=np.full((obstacles, 3), 2.0),
    )
    choices, rng = np.random.default_rng(0), np.array([0], np.uint64)
    poses = constructed(problem, task, [SIZE], rng)
    boxes, sets = boxes_of([SIZE]), set()
    for _ in range(20):
        poses = rebuilt(problem, task, poses, boxes, choices, rng)
        assert not loaded(problem, task, poses, boxes, is_checked=True).overlaps.any()
        assert (poses.inside[task.count :] == 1).all()
        assert (poses.places[task.count :] == 2.0).all()
        sets.add(poses.inside.tobytes())
    assert len(sets) > 10


def test_an_empty_box_is_filled() -> None:
    mesh = creation.box((1.0, 1.0, 1.0))
    problem = build([ItemType("cube", mesh.vertices, mesh.faces)], 4.0, 0.0)
    task = SearchTask(np.zeros(3, int), np.ones(3), np.ones(3), (SIZE,))
    rng = np.array([0], np.uint64)
    poses = rebuilt(problem, task, task.unplaced, boxes_of([SIZE]), np.random.default_rng(0), rng)
    assert poses.inside.all()
