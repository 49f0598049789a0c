"""With the debug switch, a search compares its state with one rebuilt from the poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from trimesh import creation

from packit_sim import BoxContainer, ItemType, NestSettings, nest
from packit_sim.core.debugging import checking
from packit_sim.parts.nesting import separation
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.problem import boxes_of
from packit_sim.parts.nesting.separation import Separation
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask

SIZE = (4.0, 4.0, 4.0)


def items(detailed: bool) -> list[ItemType]:
    meshes = {
        "plate": creation.box((1.5, 1, 2)),
        "ring": creation.torus(0.8, 0.3, 32, 16) if detailed else creation.annulus(0.4, 0.8, 1),
    }
    return [ItemType(name, m.vertices, m.faces, 5, "cube") for name, m in meshes.items()]


@pytest.mark.slow
@pytest.mark.parametrize("detailed", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("objective", ["strip", "knapsack", "bins"])
def test_checked_searches_find_the_same_packings(objective: str, detailed: bool) -> None:
    size = (4.0, 4.0, math.inf) if objective == "strip" else (3.0, 3.0, 3.0)
    found = []
    for on in (False, True):
        with checking(on):
            settings = NestSettings(workers=2, iterations=120)
            packing = nest(items(detailed), BoxContainer(size), objective, 600, settings=settings)
        found.append([(p.type, p.box, p.pose.matrix.tolist()) for p in packing.placements])
    assert found[0] == found[1]


def attempt(obstacles: int = 0) -> bool | None:
    """Separate items at random poses, for a few passes."""
    types = items(False)
    problem = build(types, max(SIZE), 0.1)
    numbers = np.repeat([0, 1], 5)
    volumes = np.array([types[n].volume for n in numbers])
    obstacle = np.full((obstacles, 3), 2.0)
    task = SearchTask(np.append(numbers, [1] * obstacles), volumes, volumes, (SIZE,))
    task.obstacles = obstacle
    rng = np.random.default_rng(0)
    places = np.concatenate((rng.uniform(1, 3, (10, 3)), obstacle))
    poses = Poses(np.ones(len(places), np.uint8), np.zeros(len(places), np.int64), places)
    search = Separation(task, poses, boxes_of([SIZE]), 60)
    return search.advance(problem, np.array([1], np.uint64), SearchBudget(0, 50), True)


def test_an_attempt_around_an_obstacle_keeps_its_state() -> None:
    with checking():
        attempt(obstacles=1)


@pytest.mark.parametrize(
    ("array", "message"),
    [("overlaps", "overlaps of pairs"), ("bounds", "bounds"), ("weights", "less than 1")],
)
def test_a_state_that_does_not_fit_its_poses_is_found(
    monkeypatch: pytest.MonkeyPatch, array: str, message: str
) -> None:
    original = separation.separate

    def wrong(problem, state, *arguments):
        overlap = original(problem, state, *arguments)
        found = getattr(state, array)
        found[:] = 0.5 * found - 0.1
        return overlap

    monkeypatch.setattr(separation, "separate", wrong)
    attempt()
    with checking(), pytest.raises(AssertionError, match=message):
        attempt()
