"""Where an evolution's time goes: timers around kernels, FCL and cached functions."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, TypeVar
from unittest.mock import patch

import fcl
from numba.core.dispatcher import Dispatcher

from packit_sim import EvolutionSettings, ShapeLibrary
from packit_sim.core import caches
from packit_sim.engine import occupancy, screening_kernels
from packit_sim.game.generation.evolution import Evolution

_T = TypeVar("_T")

REST = "Python: all the rest"

CACHED = {
    "turned voxels": "turning voxels",
    "voxels": "first voxels of a shape and scale",
    "collision meshes": "building FCL's trees",
    "collisions": "the way to FCL and back",
}
"""Accounts by the caches whose values they compute."""

KERNELS = {screening_kernels: "kernels: looking for a location", occupancy: "kernels: placing"}


class Accounts:
    """Seconds by account; each second counts for the account that was opened last."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls = 0
        self._open: list[str] = []
        self._since = 0.0

    def timed(self, name: str, function: Callable[..., _T]) -> Callable[..., _T]:
        """Wrap a function so that its time counts for an account."""

        def booked(*arguments: Any, **named: Any) -> _T:
            self.calls += 1
            self._book()
            self._open.append(name)
            try:
                return function(*arguments, **named)
            finally:
                self._book()
                self._open.pop()

        return booked

    def _book(self) -> None:
        now = time.perf_counter()
        if self._open:
            self.seconds[self._open[-1]] += now - self._since
        self._since = now


def time_shares(
    library: ShapeLibrary, seeds: list[int], settings: EvolutionSettings
) -> dict[str, Any]:
    """Measure the accounts' shares of the time of evolutions, and the share of the timers."""
    _evolve(library, seeds[0], EvolutionSettings(generations=0))  # compiles
    accounts = Accounts()
    patches = [patch.object(fcl, "collide", accounts.timed("FCL", fcl.collide))]
    for name, account in CACHED.items():
        cache = caches._caches[name]
        function = accounts.timed(account, cache._function)
        patches.append(patch.object(cache, "_function", function))
    for module, account in KERNELS.items():
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher):
                patches.append(patch.object(module, name, accounts.timed(account, value)))
    with ExitStack() as stack:
        for function_patch in patches:
            stack.enter_context(function_patch)
        for seed in seeds:
            caches.clear()
            accounts.timed(REST, _evolve)(library, seed, settings)
    spent = sorted(accounts.seconds.items(), key=lambda account: -account[1])
    total = sum(seconds for _, seconds in spent)
    return {
        "seeds": seeds,
        "generations": settings.generations,
        "seconds": total,
        "shares": {name: seconds / total for name, seconds in spent},
        "share of the timers": accounts.calls * _one_timer() / total,
    }


def _evolve(library: ShapeLibrary, seed: int, settings: EvolutionSettings) -> None:
    evolution = Evolution(library, seed, settings)
    while not evolution.is_over:
        evolution.step()


def _one_timer(calls: int = 100_000) -> float:
    """Measure the seconds that the timer of one call takes."""
    idle = Accounts().timed("nothing", lambda: None)
    started = time.perf_counter()
    for _ in range(calls):
        idle()
    return (time.perf_counter() - started) / calls
