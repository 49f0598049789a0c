"""Caches change the speed of results, never the results: with budgets, threads and forks."""

import multiprocessing
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from packit_sim.box import Box
from packit_sim.core import caches
from packit_sim.core.caches import BoundedCache
from packit_sim.core.counters import counters
from tests.zoo import ZOO, cube_of, fill, random_item


@pytest.fixture
def budgets() -> Iterator[dict[str, int]]:
    """What the caches may hold; put back in the end, empty."""
    before = {name: int(use.budget) for name, use in caches.usage().items()}
    yield before
    for name, budget in before.items():
        caches.limit(name, budget)


def masks(seed: int) -> list[bytes]:
    """Answers about a box that is drawn from a seed."""
    rng = np.random.default_rng(seed)
    box = Box((48, 48, 48))
    fill(box, [random_item(ZOO, 0.35, rng) for _ in range(4)], rng)
    items = [random_item(ZOO, 0.3, rng) for _ in range(3)]
    return [np.packbits(box.feasible(item)).tobytes() for item in items]


def test_the_least_recently_used_goes_when_the_budget_is_full() -> None:
    calls = []

    def square(n: int) -> int:
        calls.append(n)
        return n * n

    kept = BoundedCache(square, "units", size=lambda value: value, key=lambda n: n, budget=30)
    assert [kept(n) for n in (3, 4, 3, 4)] == [9, 16, 9, 16]
    assert calls == [3, 4]
    assert kept(3) == 9 and kept(5) == 25  # with 9, 16 and 25 it would hold 50: 4, then 3 must go
    assert kept.peek(3) is None and kept.peek(4) is None and kept.peek(5) == 25
    assert kept(6) == kept(6) == 36  # larger than the budget: answered, and never kept
    assert calls == [3, 4, 5, 6, 6]
    use = kept.usage()
    assert (use.hits, use.misses, use.size, use.budget, use.unit) == (4, 7, 25, 30, "units")
    kept.clear()
    assert kept.usage().size == 0 and kept.usage().hits == 4, "what was counted stays"


def test_peeking_counts_hits_and_misses() -> None:
    kept = BoundedCache(lambda n: n, "units", size=lambda value: 1, key=lambda n: n, budget=3)
    assert kept.peek(1) is None
    kept(1)
    assert kept.peek(1) == 1
    assert (kept.usage().hits, kept.usage().misses) == (1, 2)


def test_what_fails_is_not_kept_and_fails_again() -> None:
    kept = BoundedCache(lambda n: 1 // n, "units", size=lambda value: 1, key=lambda n: n, budget=3)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            kept(0)
    assert kept.usage().size == 0


@pytest.mark.parametrize("budget", [0, 1, 3000])
def test_answers_are_the_same_with_next_to_no_budget(budget: int, budgets: dict[str, int]) -> None:
    expected = [masks(seed) for seed in range(4)]
    for name in budgets:
        caches.limit(name, budget)
    assert [masks(seed) for seed in range(4)] == expected
    assert all(use.size <= use.budget == budget for use in caches.usage().values())


def test_a_cache_that_there_is_not_is_named_with_those_that_there_are() -> None:
    for change in (lambda: caches.limit("pixels", 3), lambda: caches.clear("pixels")):
        with pytest.raises(ValueError, match=r"'pixels': choose from .*no-fit tables"):
            change()


def test_threads_get_the_answers_of_one() -> None:
    expected = [masks(seed) for seed in range(12)]
    caches.clear()
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(masks, range(12))) == expected


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_processes_get_the_answers_of_one(method: str) -> None:
    expected = [masks(seed) for seed in range(4)]
    context = multiprocessing.get_context(method)
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        assert list(pool.map(masks, range(4))) == expected


def test_a_fork_never_takes_a_held_lock_along() -> None:
    """Children would wait for ever for a thread that they do not have."""
    expected = masks(0)
    stop = threading.Event()

    def ask() -> None:
        while not stop.is_set():
            masks(1)

    asking = [threading.Thread(target=ask) for _ in range(2)]
    for thread in asking:
        thread.start()
    try:
        context = multiprocessing.get_context("fork")
        for _ in range(10):
            with context.Pool(1) as pool:
                assert pool.apply_async(masks, (0,)).get(timeout=60) == expected
    finally:
        stop.set()
        for thread in asking:
            thread.join()


def test_the_default_budgets_of_eight_environments_fit_in_8_gb() -> None:
    """Without those of the oracle, of the champion and of nesting, which no environment asks."""
    others = ("whole fine arrays", "items in all rotations", "distances to solids")
    budgets = [
        use.budget
        for name, use in caches.usage().items()
        if use.unit == "bytes" and not name.startswith(others)
    ]
    assert len(budgets) >= 6 and 8 * sum(budgets) <= 8 * 2**30


def test_counters_count_questions_locations_and_calls_of_fcl() -> None:
    caches.clear()
    before = counters()
    box = Box()
    box.place(cube_of(24.01), (0, 0, 0))  # half a cell of clearance on each side, and touching
    box.feasible(cube_of(24.005))
    box.blbf(cube_of(24.005))
    assert box.blbf(cube_of(90)) is None
    used = counters().since(before)
    assert (used.masks, used.searches, used.checks, used.queries) == (1, 2, 1, 4)
    assert used.locations > 19**3
    assert 0 < used.undecided < used.locations
    assert used.undecided_share == used.undecided / used.locations
    assert 0 < used.mesh_comparisons <= used.undecided
    assert used.mesh_comparisons_per_query == used.mesh_comparisons / 4
    assert used.caches["collisions"].misses <= used.mesh_comparisons
    assert used.caches["turned voxels"].hits > 0
