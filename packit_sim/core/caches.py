"""The process's caches: bounded, counted, and safe in threads and after a fork.

What they hold can always be made anew, so that they change how fast an answer comes, never which.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Generic, ParamSpec, Self, TypeVar, overload

from cachetools import LRUCache

from packit_sim.core.errors import ArgumentError

_P = ParamSpec("_P")
_T = TypeVar("_T")

lock = threading.RLock()
"""Held by who reads or changes what the process shares; no fork falls between."""

os.register_at_fork(before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release)


class cached_property(functools.cached_property[_T]):  # as in the standard library
    """An attribute made when it is first asked for, as Python 3.12 has it: without a lock.

    Python 3.11's takes one that all instances share; a child forked meanwhile would wait for ever.
    """

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> _T: ...
    def __get__(self, instance: object | None, owner: type[Any] | None = None) -> Self | _T:
        if instance is None:
            return self
        assert self.attrname is not None
        kept = instance.__dict__
        if self.attrname not in kept:
            kept[self.attrname] = self.func(instance)
        value: _T = kept[self.attrname]
        return value


@dataclass(frozen=True)
class CacheUsage:
    """How a cache was used since the process began.

    hits, misses: questions answered from it, and those that were not. size: what it holds now, and
    budget: what it may hold, both in `unit`; beyond that the least recently used goes first.
    """

    hits: int
    misses: int
    size: float
    budget: float
    unit: str


class BoundedCache(Generic[_P, _T]):
    """A function whose values are kept by key, up to a budget."""

    def __init__(
        self,
        function: Callable[_P, _T],
        unit: str,
        size: Callable[[_T], int],
        key: Callable[..., Hashable],
        budget: int,
    ) -> None:
        self._function = function
        self._unit = unit
        self._size = size
        self._key = key
        self._hits = self._misses = 0
        self.limit(budget)

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        """The value that is kept, or a new one."""
        key = self._key(*args, **kwargs)
        with lock:
            if key in self._kept:
                self._hits += 1
                return self._kept[key]
            self._misses += 1
        value = self._function(*args, **kwargs)
        with lock:
            if self._size(value) <= self._kept.maxsize:
                self._kept[key] = value
        return value

    def peek(self, *args: _P.args, **kwargs: _P.kwargs) -> _T | None:
        """The value that is kept, or None."""
        key = self._key(*args, **kwargs)
        with lock:
            if key not in self._kept:
                return None
            self._hits += 1
            return self._kept[key]

    def limit(self, budget: int) -> None:
        """Sets the budget, and empties."""
        with lock:
            self._kept: LRUCache[Hashable, _T] = LRUCache(budget, getsizeof=self._size)

    def clear(self) -> None:
        self.limit(int(self._kept.maxsize))

    def use(self) -> CacheUsage:
        with lock:
            kept = self._kept
            return CacheUsage(self._hits, self._misses, kept.currsize, kept.maxsize, self._unit)


_caches: dict[str, BoundedCache[..., Any]] = {}


def bounded_cache(
    name: str,
    budget: int,
    unit: str,
    size: Callable[[Any], int],
    key: Callable[..., Hashable],
) -> Callable[[Callable[_P, _T]], BoundedCache[_P, _T]]:
    """Keeps a function's values by key, up to a budget in `unit`s of which a value takes `size`."""

    def decorate(function: Callable[_P, _T]) -> BoundedCache[_P, _T]:
        cache: BoundedCache[_P, _T] = BoundedCache(function, unit, size, key, budget)
        _caches[name] = cache
        return cache

    return decorate


def usage() -> dict[str, CacheUsage]:
    """How each of the caches was used, by name."""
    return {name: cache.use() for name, cache in _caches.items()}


def limit(name: str, budget: int) -> None:
    """Sets the budget of a cache and empties it. Raises ValueError where there is no such cache."""
    _named(name).limit(budget)


def clear(*names: str) -> None:
    """Empties the caches of these names, or all of them; what was counted stays."""
    for name in names or _caches:
        _named(name).clear()


def _named(name: str) -> BoundedCache[..., Any]:
    if name not in _caches:
        raise ArgumentError(f"no cache is called {name!r}: choose one of {', '.join(_caches)}")
    return _caches[name]
