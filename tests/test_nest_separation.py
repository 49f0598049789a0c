"""Attempts of a search for a strip: what is no overlap, and how one follows from the last."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim import ItemType, NestSettings, nest
from packit_sim.parts.nesting import separation
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.conflict_kernels import load
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.separation import Separation
from packit_sim.parts.nesting.settings import SearchSettings
from packit_sim.parts.nesting.strips import StripSearch
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask


def cubes(places: list[tuple[float, float, float]]) -> tuple[Problem, SearchTask, Poses]:
    """Return unit cubes at places in a box with sides of 4."""
    cube, n = creation.box((1, 1, 1)), len(places)
    problem = build([ItemType("cube", cube.vertices, cube.faces)], 4.0, 0.0)
    task = SearchTask(np.zeros(n, np.int64), np.ones(n), np.ones(n), ((4.0, 4.0, 4.0),))
    return problem, task, Poses(np.ones(n, np.int64), np.zeros(n, np.int64), np.array(places))


@pytest.mark.parametrize(("more", "overlaps"), [(0.0, False), (1e-12, False), (1e-6, True)])
def test_what_rounding_leaves_of_a_margin_is_no_overlap(more, overlaps) -> None:
    problem, task, poses = cubes([(1.0, 1.0, 1.0), (1.99, 1.0, 1.0)])
    boxes = boxes_of(task.sizes)
    state = loaded(problem, task, poses, boxes)
    assert state.overlaps[0, 1] > 0.01
    state.margins[:] = more - state.overlaps[0, 1]
    load(problem, state, poses.turned, poses.places, boxes, False)
    assert (state.overlaps[0, 1] > 0) == overlaps


@pytest.mark.parametrize(("conflicts", "is_apart"), [(0, True), (19, True), (20, False)])
def test_an_attempt_gives_up_after_as_many_conflicts_without_an_overlap_as_its_patience(
    conflicts: int, is_apart: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The surfaces find one after the other, and what moves apart by distances has a gain."""
    problem, task, poses = cubes([(1.0, 1.0, 1.0)])
    left = iter([1] * conflicts)
    monkeypatch.setattr(separation, "load", lambda *_: next(left, 0))
    monkeypatch.setattr(separation, "separate", lambda *_: 0.0)
    attempt = Separation(task, poses, boxes_of(task.sizes), patience=20)
    budget = SearchBudget(1.0, 10_000, latest=1.0)
    assert attempt.advance(problem, np.zeros(1, np.uint64), budget, True) == is_apart


@pytest.mark.parametrize(("whole", "expected"), [(1_000, 60), (10_000, 100), (100_000, 240)])
def test_an_attempt_has_more_patience_as_long_as_it_takes_little_of_the_search(
    whole: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a gain: 60 passes, or as many as are 1% of the search, but at most 240."""
    problem, task, poses = cubes([(1.0, 1.0, 1.0)])
    monkeypatch.setattr(separation, "separate", lambda *_: 0.5)
    attempt = Separation(task, poses, boxes_of(task.sizes), 60, most_patience=240)
    budget = SearchBudget(1.0, whole, 0.5, latest=1.0)
    assert not attempt.advance(problem, np.zeros(1, np.uint64), budget, True)
    assert budget.progress == pytest.approx(0.5 + expected / whole)


def test_a_failed_attempt_is_disrupted_by_exchanging_two_items_that_differ(monkeypatch) -> None:
    begun = StripSearch._begun
    exchanged = []

    def begin(search: StripSearch, *arguments: Any) -> Separation:
        failed, has_space = search._failed, search._has_space
        attempt = begun(search, *arguments)
        if failed is not None and has_space:
            starts = [one.places for one in (failed, search._current) if one is not None]
            moved = [(attempt.least.places != start).any(axis=1) for start in starts]
            (pair,) = (np.flatnonzero(each) for each in moved if each.sum() == 2)
            kinds = np.column_stack((search._task.numbers, attempt.least.turned))[pair]
            assert (kinds[0] != kinds[1]).any()
            exchanged.append(pair)
        return attempt

    monkeypatch.setattr(StripSearch, "_begun", begin)
    meshes = [
        creation.annulus(0.6, 1, 0.5, sections=8),
        creation.cone(0.8, 1.2, sections=7),
        creation.box((1.2, 0.9, 0.8)),
    ]
    types = [ItemType(f"{n}", mesh.vertices, mesh.faces, demand=3) for n, mesh in enumerate(meshes)]
    search = SearchSettings(shrink=0.3)  # steps that mostly fail
    settings = NestSettings(workers=1, iterations=600, search=search)
    nest(types, (3, 3, np.inf), "strip", seed=1, settings=settings)
    assert exchanged
