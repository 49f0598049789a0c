"""The process's caches: bounded, counted, and safe in threads and after a fork.

What they hold can always be made anew, so that they change how fast an answer comes, never which.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Generic, ParamSpec, TypeVar

from cachetools import LRUCache, cached

_P = ParamSpec("_P")
_T = TypeVar("_T")

lock = threading.RLock()
"""Held by who reads or changes what the process shares; no fork falls between."""

os.register_at_fork(before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release)


@dataclass(frozen=True)
class CacheUse:
    """How a cache was used since the process began, or since it was cleared.

    hits, misses: questions answered from it, and those that were not. size: what it holds now, and
    budget: what it may hold, both in `unit`; beyond that the least recently used goes first.
    """

    hits: int
    misses: int
    size: float
    budget: float
    unit: str


class _Bounded(Generic[_P, _T]):
    """A function whose values are kept by key, up to a budget."""

    def __init__(
        self,
        function: Callable[_P, _T],
        unit: str,
        size: Callable[[Any], int],
        key: Callable[..., Hashable],
        budget: int,
    ) -> None:
        self._function = function
        self._unit = unit
        self._size = size
        self._key = key
        self.limit(budget)

    def limit(self, budget: int) -> None:
        store: LRUCache[Hashable, Any] = LRUCache(budget, getsizeof=self._size)
        self._kept = cached(store, key=self._key, lock=lock, info=True)(self._function)

    def clear(self) -> None:
        self._kept.cache_clear()

    def use(self) -> CacheUse:
        hits, misses, budget, size = self._kept.cache_info()
        return CacheUse(hits, misses, size, budget or 0, self._unit)

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        return self._kept(*args, **kwargs)


_caches: dict[str, _Bounded[..., Any]] = {}


def bounded(
    name: str,
    budget: int,
    unit: str,
    size: Callable[[Any], int],
    key: Callable[..., Hashable],
) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Keeps a function's values by key, up to a budget in `unit`s of which a value takes `size`."""

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        cache = _Bounded(function, unit, size, key, budget)
        _caches[name] = cache
        return cache

    return decorate


def usage() -> dict[str, CacheUse]:
    """How each of the caches was used, by name."""
    return {name: cache.use() for name, cache in _caches.items()}


def limit(name: str, budget: int) -> None:
    """Sets the budget of a cache and empties it. Raises ValueError where there is no such cache."""
    _named(name).limit(budget)


def clear(*names: str) -> None:
    """Empties the caches of these names, or all of them, and starts their counts anew."""
    for name in names or _caches:
        _named(name).clear()


def _named(name: str) -> _Bounded[..., Any]:
    if name not in _caches:
        raise ValueError(f"no cache is called {name!r}: choose one of {', '.join(_caches)}")
    return _caches[name]
