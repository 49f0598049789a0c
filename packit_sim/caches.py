"""The process's caches: bounded, counted, and safe in threads and after a fork.

What they hold can always be made anew, so that they change how fast an answer comes, never which.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

from cachetools import LRUCache, cached

_P = ParamSpec("_P")
_T = TypeVar("_T")

_lock = threading.RLock()
os.register_at_fork(
    before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release
)

_caches: dict[str, Callable[[], CacheUse]] = {}
_clear: list[Callable[[], None]] = []


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


def bounded(
    name: str,
    budget: int,
    unit: str,
    size: Callable[[Any], int],
    key: Callable[_P, Hashable],
) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Keeps a function's values by key, up to a budget in `unit`s of which a value takes `size`."""

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        store: LRUCache[Hashable, _T] = LRUCache(budget, getsizeof=size)
        kept = cached(store, key=key, lock=_lock, info=True)(function)

        def use() -> CacheUse:
            hits, misses, _, now = kept.cache_info()
            return CacheUse(hits, misses, now, budget, unit)

        _caches[name] = use
        _clear.append(kept.cache_clear)
        return kept

    return decorate


def usage() -> dict[str, CacheUse]:
    """How each of the caches was used, by name."""
    return {name: use() for name, use in _caches.items()}


def clear() -> None:
    """Empties every cache and starts their counts anew."""
    for clear_one in _clear:
        clear_one()
