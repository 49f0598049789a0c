"""Bounded caches of the process: counted, and safe in threads and after fork().

A cached value can always be computed again: caches change speed, never results.
"""

from __future__ import annotations

import functools
import os
import sys
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Generic, ParamSpec, Self, TypeVar, overload

from cachetools import LRUCache

from packit_sim.core.errors import ArgumentError

__all__ = [
    "CacheUsage",
    "clear",
    "limit",
    "usage",
]

_P = ParamSpec("_P")
_T = TypeVar("_T")

lock = threading.RLock()
"""Guards the state that the threads share; the lock is also held across fork()."""

if sys.platform != "win32":
    os.register_at_fork(
        before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release
    )


class cached_property(functools.cached_property[_T]):  # named as in the standard library
    """A cached attribute without a lock, as in Python 3.12.

    In Python 3.11 all instances share one lock: a child forked while it is held waits forever.
    """

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> _T: ...
    def __get__(self, instance: object | None, owner: type[Any] | None = None) -> Self | _T:
        if instance is None:
            return self
        assert self.attrname is not None
        values = instance.__dict__
        if self.attrname not in values:
            values[self.attrname] = self.func(instance)
        value: _T = values[self.attrname]
        return value


@dataclass(frozen=True)
class CacheUsage:
    """The usage of a cache since the process started.

    Attributes
    ----------
    hits, misses : int
        The lookups that found a value, and those that did not.
    size : float
        The current size, in `unit`.
    budget : float
        The maximum size; beyond it the least recently used value is dropped.
    unit : str
        The unit of size and budget.
    """

    hits: int
    misses: int
    size: float
    budget: float
    unit: str


class BoundedCache(Generic[_P, _T]):
    """A function whose values are cached by key, up to a budget.

    Parameters
    ----------
    function : Callable[_P, _T]
        Computes a value.
    unit : str
        The unit of the size and the budget.
    size : Callable[[_T], int]
        The size of a value.
    key : Callable[..., Hashable]
        The key of the function's arguments.
    budget : int
        The maximum size of all values together.
    """

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
        """Return the cached value, or compute and cache it."""
        key = self._key(*args, **kwargs)
        with lock:
            try:
                value = self._values[key]
            except KeyError:
                self._misses += 1
            else:
                self._hits += 1
                return value
        value = self._function(*args, **kwargs)
        with lock:
            if self._size(value) <= self._values.maxsize:
                self._values[key] = value
        return value

    def peek(self, *args: _P.args, **kwargs: _P.kwargs) -> _T | None:
        """Return the cached value, or None; counts as a hit or a miss."""
        key = self._key(*args, **kwargs)
        with lock:
            try:
                value = self._values[key]
            except KeyError:
                self._misses += 1
                return None
            self._hits += 1
            return value

    def limit(self, budget: int) -> None:
        """Set the budget and drop all values."""
        with lock:
            self._values: LRUCache[Hashable, _T] = LRUCache(budget, getsizeof=self._size)

    def clear(self) -> None:
        """Drop all values; the counts stay."""
        self.limit(int(self._values.maxsize))

    def usage(self) -> CacheUsage:
        """Return the counts and sizes."""
        with lock:
            values = self._values
            return CacheUsage(self._hits, self._misses, values.currsize, values.maxsize, self._unit)


_caches: dict[str, BoundedCache[..., Any]] = {}


def bounded_cache(
    name: str,
    budget: int,
    unit: str,
    size: Callable[[Any], int],
    key: Callable[..., Hashable],
) -> Callable[[Callable[_P, _T]], BoundedCache[_P, _T]]:
    """Decorate a function with a `BoundedCache` that `usage`, `limit` and `clear` know by name."""

    def decorate(function: Callable[_P, _T]) -> BoundedCache[_P, _T]:
        cache: BoundedCache[_P, _T] = BoundedCache(function, unit, size, key, budget)
        _caches[name] = cache
        return cache

    return decorate


def usage() -> dict[str, CacheUsage]:
    """Return the usage of each cache by name."""
    return {name: cache.usage() for name, cache in _caches.items()}


def limit(name: str, budget: int) -> None:
    """Set the budget of a cache and drop its values. Raises ArgumentError for an unknown name."""
    _named(name).limit(budget)


def clear(*names: str) -> None:
    """Drop the values of the named caches, or of all if no name is given; the counts stay."""
    for name in names or _caches:
        _named(name).clear()


def _named(name: str) -> BoundedCache[..., Any]:
    if name not in _caches:
        raise ArgumentError(f"there is no cache {name!r}: choose from {', '.join(_caches)}")
    return _caches[name]
