"""Searches on several cores, which exchange their best solutions after each round.

Each worker runs a search of its own, from its own seed. After a round, searches adopt the best
solution whose packing passed the check; a search whose best did not pass begins again. After the
last round, each search makes its best solution better in ways that no attempt should begin from.
"""

from __future__ import annotations

import hashlib
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count
from typing import Any, TypeVar

from packit_sim.core.debugging import is_checking
from packit_sim.core.memory import release_memory
from packit_sim.core.parallel import Threads, Workers
from packit_sim.core.plain_text import plain_logger
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.overlap_kernels import add_fields
from packit_sim.parts.nesting.problem import Problem, with_own_arrays, with_own_fields
from packit_sim.parts.nesting.search import NestSearch
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS, SearchSettings
from packit_sim.parts.nesting.tasks import CLOCKS, ClockName, SearchBudget, Solution
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing

_log = plain_logger("packit_sim.parts.nesting")

_Result = TypeVar("_Result")

CHECKING = 0.1
"""Largest share of the seconds that is kept for the check of the last packing."""


class Problems:
    """A problem's arguments: each process computes it once, each thread has its own work arrays.

    Parameters
    ----------
    unit : float
        The longest fixed side of the container.
    clearance : float
        The distance to keep.
    shares_fields : bool
        True to let threads share the fields that surfaces compute, if there is space for all of
        them: each node is computed once, but the result of one thread depends on the others.
    settings : SearchSettings
        The resolution of the fields, among others.
    by_cells : bool
        True to fill boxes with items as cells.
    has_fields : bool
        False for a problem without fields.
    bodies : tuple of ItemType
        Bodies around the types, which keep clear of each other instead; none for the types.
    """

    def __init__(
        self,
        types: tuple[ItemType, ...],
        unit: float,
        clearance: float,
        shares_fields: bool = False,
        settings: SearchSettings = DEFAULT_SETTINGS,
        by_cells: bool = False,
        has_fields: bool = True,
        bodies: tuple[ItemType, ...] = (),
    ) -> None:
        self.shares_fields = shares_fields and not is_checking()  # others would change its nodes
        self._arguments = types, unit, clearance, settings, by_cells, has_fields, bodies
        parts = [(each.digest, searched_rotations(each).tobytes()) for each in (*types, *bodies)]
        key = parts, unit, clearance, self.shares_fields, settings, by_cells, has_fields
        self._digest = hashlib.sha256(repr(key).encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Problems) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def get(self) -> Problem:
        """Return the problem with this thread's own work arrays, and fields unless shared."""
        if getattr(_own, "problems", None) != self:
            shared, has_fields = _built(self)
            _own.problem = with_own_arrays(shared if has_fields else with_own_fields(shared))
            _own.problems = self
        problem: Problem = _own.problem
        return problem

    def build(self) -> Problem:
        """Compute the problem."""
        return build(*self._arguments)


_own = threading.local()


@lru_cache(maxsize=1)
def _built(problems: Problems) -> tuple[Problem, bool]:
    """Compute a problem; the second value is True if it has all fields."""
    problem = problems.build()
    release_memory()
    shares = problems.shares_fields and problem.refined
    return problem, shares and bool(add_fields(problem.lookup))


def forget_problem() -> None:
    """Drop what this thread knows of its last problem, which only another search of it can use."""
    _built.cache_clear()
    _own.__dict__.clear()
    release_memory()


@dataclass(frozen=True)
class Limits:
    """Limits of a search; the first that is reached ends it.

    Attributes
    ----------
    seconds : float
        Time limit in seconds.
    passes : int, optional
        Pass limit of each worker; replaces the time limit.
    stop : threading.Event
        Ends the search when it is set, at once if the workers are threads.
    clock : str
        The clock of the seconds (see `CLOCKS`).
    """

    seconds: float
    passes: int | None
    stop: threading.Event
    clock: ClockName


class _Stopwatch:
    """Seconds since the start, of the wall or of this thread and the slowest worker."""

    def __init__(self, clock: ClockName) -> None:
        self._now = CLOCKS[clock]
        self._counts_workers = clock == "processor"
        self._start = self._now()

    def add(self, seconds: Iterable[float]) -> None:
        """Add the processor time that workers took in parallel."""
        if self._counts_workers:
            self._start -= max(seconds)

    @property
    def seconds(self) -> float:
        return self._now() - self._start


def rounds(
    problems: Problems,
    beginnings: Sequence[list[NestSearch]],
    limits: Limits,
    workers: Workers | Threads,
    check: Callable[[Solution], Packing | None],
    settings: SearchSettings,
) -> Iterator[tuple[Packing, float]]:
    """Search in rounds, from one beginning after the other.

    Parameters
    ----------
    beginnings : sequence of list of NestSearch
        Searches, one for each worker; each list has an equal share of the seconds. If the settings
        say so, a list begins with the best solution if the list before found it, or if it would not
        begin with a construction.
    limits : Limits
        The seconds of all lists together; passes are for each list.
    workers : Workers or Threads
        The threads or processes that they run in.
    check : callable
        Returns the packing of a solution, or None if it is not valid.
    settings : SearchSettings
        The lengths of rounds, and whether searches resume.

    Yields
    ------
    packing : Packing
        Each valid packing that is better than all before, after the round that found it.
    seconds : float
        The seconds until then.
    """
    best: Solution | None = None
    latest: Solution | None = None
    before = 0.0
    for n, searches in enumerate(beginnings):
        watch = _Stopwatch(limits.clock)
        lowest = best if searches[0].has_start else latest
        if lowest is not None and settings.resumes:
            for each in searches:
                each.begin_with(lowest)
        latest = None
        own = replace(limits, seconds=(limits.seconds - before) / (len(beginnings) - n))
        for solution, packing in _once(problems, searches, own, workers, check, settings, watch):
            if best is None or solution.score < best.score:
                best = latest = solution
                yield packing, before + watch.seconds
        before += watch.seconds
        is_over = limits.passes is None and before >= limits.seconds
        if is_over or limits.stop.is_set() or all(each.is_done for each in searches):
            return


def _once(
    problems: Problems,
    searches: list[NestSearch],
    limits: Limits,
    workers: Workers | Threads,
    check: Callable[[Solution], Packing | None],
    settings: SearchSettings,
    watch: _Stopwatch,
) -> Iterator[tuple[Solution, Packing]]:
    """Search in rounds, the first of which only constructs a packing; yield what becomes better."""
    problems.get()
    passes = limits.passes
    left_over = _left_over(searches, limits.seconds, settings)
    limits = replace(limits, seconds=limits.seconds - left_over)
    best: Solution | None = None
    kept = 0.0  # seconds for the last check, by those before
    stop = limits.stop if isinstance(workers, Threads) else None
    for number in count():
        now = watch.seconds
        left = limits.seconds - kept - now
        shortest, longest = settings.round_seconds
        length = min(max(settings.round_growth * now, shortest), longest)
        seconds = min(length, left) if number else 0.0
        share = None if passes is None else min(settings.round_passes, passes) if number else 0
        if passes is None or limits.passes is None:
            done, whole = now / limits.seconds, limits.seconds
        else:
            done, whole = 1 - passes / limits.passes, limits.passes
        latest = max(left, 0.0 if number else settings.construction_seconds)
        budget = seconds, share, done, whole, stop, limits.clock, latest
        own = [(problems, each, *budget) for each in searches]
        ends = _run(workers, _advance, own, limits)
        searches[:] = [search for search, _ in ends]
        if not (number or limits.stop.is_set()) and any(each.is_cut for each in searches):
            _log.warning("the time was over before all items were tried: allow more time")
        watch.add(spent for _, spent in ends)
        for solution in sorted((each.best for each in searches if each.best), key=_score):
            if best is not None and solution.score >= best.score:
                break
            before = watch.seconds
            packing = check(solution)
            kept = max(kept, min(watch.seconds - before, CHECKING * limits.seconds))
            if packing is not None:
                best = solution
                yield solution, packing
                break
        for each in searches:
            if best is None or (each.best is not None and each.best.score < best.score):
                each.restart()
            if best is not None and (each.best is None or each.best.score > best.score):
                each.adopt(problems.get(), best)
        if passes is not None and share is not None:
            passes -= share
        is_over = watch.seconds + kept >= limits.seconds if passes is None else passes <= 0
        if is_over or limits.stop.is_set() or all(each.is_done for each in searches):
            break
    if best is None or limits.stop.is_set() or not searches[0].finishes:
        return
    latest = max(limits.seconds + left_over - kept - watch.seconds, 0.0)
    if limits.passes is not None:
        passes = math.ceil(settings.finishing[0] * limits.passes)
    last = [(problems, each, latest, passes, stop, limits.clock) for each in searches]
    finished = _run(workers, _finished, last, limits)
    watch.add(spent for _, spent in finished)
    for solution in sorted((each for each, _ in finished if each), key=_score):
        packing = check(solution) if solution.score < best.score else None
        if packing is not None:
            yield solution, packing
            return


def _run(
    workers: Workers | Threads,
    function: Callable[..., _Result],
    arguments: Sequence[tuple[Any, ...]],
    limits: Limits,
) -> list[_Result]:
    """Run a function for all arguments; Ctrl-C stops the threads that do."""
    try:
        return workers.map(function, arguments)
    except KeyboardInterrupt:
        limits.stop.set()
        raise


def _score(solution: Solution) -> tuple[float, ...]:
    return solution.score


def _left_over(searches: list[NestSearch], seconds: float, settings: SearchSettings) -> float:
    """Return how many of the seconds are for finishing the best solutions after the last round."""
    share, most, long_share = settings.finishing
    most = max(most, long_share * seconds)
    return min(share * seconds, most) if searches[0].finishes else 0.0


def _finished(
    problems: Problems,
    search: NestSearch,
    latest: float,
    passes: int | None,
    stop: threading.Event | None,
    clock: ClockName,
) -> tuple[Solution | None, float]:
    start = CLOCKS[clock]()
    budget = SearchBudget(latest, passes, 1.0, stop=stop, clock=clock, latest=latest)
    return search.finished(problems.get(), budget), CLOCKS[clock]() - start


def _advance(
    problems: Problems,
    search: NestSearch,
    seconds: float,
    passes: int | None,
    done: float,
    whole: float,
    stop: threading.Event | None,
    clock: ClockName,
    latest: float,
) -> tuple[NestSearch, float]:
    start = CLOCKS[clock]()
    problem = problems.get()
    if passes is not None:
        forget_fields(problem)
    search.advance(problem, SearchBudget(seconds, passes, done, whole, stop, clock, latest))
    return search, CLOCKS[clock]() - start


def forget_fields(problem: Problem) -> None:
    """Drop all fields: a pass depends on the nodes that were refined before it.

    With a fixed number of passes, a warm thread must find the same packing as a new one.
    """
    problem.lookup.numbers.fill(-1)
    problem.lookup.used.fill(0)
