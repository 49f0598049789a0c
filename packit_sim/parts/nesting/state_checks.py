"""The debug comparison of a search state with one that is rebuilt from its poses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.nesting.conflict_kernels import load
from packit_sim.parts.nesting.problem import (
    Problem,
    State,
    state_of,
    with_own_arrays,
    with_own_fields,
)
from packit_sim.parts.nesting.tasks import Poses

_TOUCHING = 1e-9
"""Distance of bounding boxes, relative to the largest coordinate, below which rounding decides
whether a pair is compared at all: it depends on which of the two items moved last."""


class StateCheck:
    """Asserts that bounds and overlaps, which kernels update item by item, fit the poses.

    An overlap depends on the stored distances at the time when one of its two items last moved. So
    overlaps are not compared if these were computed anew since then: when the memory for fields was
    full, and for pairs that have not moved since an attempt was resumed.

    Parameters
    ----------
    resumed : State, optional
        The state of a resumed attempt.
    """

    def __init__(self, problem: Problem, resumed: State | None) -> None:
        self._drops = int(problem.lookup.used[2])
        self._resumed = resumed
        self._before = None if resumed is None else Poses.of(resumed)

    def __call__(self, problem: Problem, state: State, boxes: Floats) -> None:
        """Compare a state with one rebuilt from scratch.

        Parameters
        ----------
        problem : Problem
            The problem; not changed, not even the fields that the comparison computes.
        boxes : ndarray of float64, shape (b, 4)
            The boxes.

        Raises
        ------
        AssertionError
            If they differ.
        """
        fresh = state_of(state.types.tolist(), state.movable)
        fresh.inside[:], fresh.margins[:] = state.inside, state.margins
        load(_copied(problem), fresh, state.turned, state.places, boxes, False)
        assert np.array_equal(fresh.places, state.places), "an item is not in its box"
        assert np.array_equal(fresh.bounds, state.bounds), "bounds do not fit the poses"
        for each in (state.overlaps, state.margins, state.weights):
            assert np.array_equal(each, each.T), "pairs are not symmetric"
        assert (state.weights >= 1).all(), "a weight is less than 1"
        wrong = (fresh.overlaps != state.overlaps) & self._are_comparable(problem, state)
        assert not wrong.any(), (
            f"overlaps of pairs {np.argwhere(wrong).tolist()} are {state.overlaps[wrong]}, "
            f"not {fresh.overlaps[wrong]}"
        )

    def _are_comparable(self, problem: Problem, state: State) -> npt.NDArray[np.bool_]:
        """Return for which pairs (n, n) the overlaps must be equal."""
        if problem.lookup.used[2] != self._drops:
            self._drops = int(problem.lookup.used[2])
            self._resumed, self._before = state, Poses.of(state)
        found = ~_is_touching(state.bounds)
        if self._before is not None and self._resumed is state:
            is_moved = (self._before.turned != state.turned) | (
                self._before.places != state.places
            ).any(axis=1)
            found &= is_moved[:, None] | is_moved
        return found


def _copied(problem: Problem) -> Problem:
    """Return a copy of a problem with the same fields, which may be changed."""
    copied = with_own_arrays(with_own_fields(problem))
    for name in ("numbers", "fields", "used"):
        getattr(copied.lookup, name)[:] = getattr(problem.lookup, name)
    used = problem.lookup.used[1]
    copied.lookup.values[:used] = problem.lookup.values[:used]
    return copied


def _is_touching(bounds: Floats) -> npt.NDArray[np.bool_]:
    """Return which pairs (n, n) of bounding boxes (n, 6) touch, up to rounding."""
    ways = bounds[:, None, :3] - bounds[None, :, 3:]
    gap = np.maximum(ways, ways.transpose(1, 0, 2)).max(axis=2)
    largest = np.abs(bounds[np.abs(bounds) < 1e100]).max(initial=0.0)
    return np.asarray(np.abs(gap) <= _TOUCHING * largest)
