"""Searches in several processes, which exchange their best solutions after each round."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

from packit_sim.core.parallel import Workers
from packit_sim.nesting.item_types import ItemType
from packit_sim.nesting.problem import Problem, build
from packit_sim.nesting.search import Search
from packit_sim.nesting.tasks import Budget, Solution

ROUNDS = 12
"""Rounds into which the time is divided."""

SECONDS = 1.0, 10.0
"""Shortest and longest time of a round."""

PASSES = 100
"""Passes of a round, where passes are counted instead of the time."""


class Problems:
    """A problem that each process computes once.

    Parameters
    ----------
    types : tuple of ItemType
        The types of items.
    unit : float
        The longest fixed side of the container.
    clearance : float
        The distance to keep.
    """

    def __init__(self, types: tuple[ItemType, ...], unit: float, clearance: float) -> None:
        self._arguments = types, unit, clearance
        parts = [(each.digest, each.rotations) for each in types]
        self._digest = hashlib.sha256(repr((parts, unit, clearance)).encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Problems) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def get(self) -> Problem:
        """Return the problem."""
        return _built(self)

    def build(self) -> Problem:
        """Compute the problem."""
        return build(*self._arguments)


@lru_cache(maxsize=1)
def _built(problems: Problems) -> Problem:
    return problems.build()


@dataclass(frozen=True)
class Limits:
    """When a search ends: after some seconds, or after some passes of each worker."""

    seconds: float
    passes: int | None = None


def rounds(
    problems: Problems, searches: Sequence[Search], limits: Limits, workers: Workers
) -> Iterator[Solution]:
    """Search in rounds.

    Parameters
    ----------
    problems : Problems
        The problem.
    searches : sequence of Search
        The searches, one for each worker.
    limits : Limits
        When to end.
    workers : Workers
        Where they run.

    Yields
    ------
    Solution
        Each solution that is better than all before, after the round that found it.
    """
    end = time.perf_counter() + limits.seconds
    length = min(max(limits.seconds / ROUNDS, SECONDS[0]), SECONDS[1])
    passes = limits.passes
    best: Solution | None = None
    while time.perf_counter() < end if passes is None else passes > 0:
        seconds = min(length, end - time.perf_counter())
        share = None if passes is None else min(PASSES, passes)
        jobs = [(problems, each, seconds, share) for each in searches]
        searches = workers.map(_advance, jobs) if len(jobs) > 1 else [_advance(*jobs[0])]
        if passes is not None and share is not None:
            passes -= share
        found = min((each.best for each in searches if each.best), key=lambda each: each.score)
        if best is None or found.score < best.score:
            best = found
            yield best
        for each in searches:
            if each.best is None or found.score < each.best.score:
                each.adopt(problems.get(), found)
        if all(each.is_done for each in searches):
            return


def _advance(problems: Problems, search: Search, seconds: float, passes: int | None) -> Search:
    budget = Budget(seconds, passes)
    search.advance(problems.get(), budget)
    return search
