"""Counters of the placement engine's work, which show where time is spent."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace

from packit_sim.core import caches

__all__ = [
    "Counters",
    "counters",
]


@dataclass(frozen=True)
class Counters:
    """Counts of one process, over all its boxes and threads.

    Attributes
    ----------
    masks, searches, checks : int
        The queries for a whole mask, for the BLBF location, and about a single location.
    locations : int
        The locations that were tested by cells.
    undecided : int
        The locations that cells could not decide, so that meshes were tested.
    mesh_comparisons : int
        The collision tests of meshes, by FCL or by a proof: those that no cache answered.
    caches : dict of str to CacheUsage
        The usage of each cache by name.
    """

    masks: int
    searches: int
    checks: int
    locations: int
    undecided: int
    mesh_comparisons: int
    caches: dict[str, caches.CacheUsage]

    @property
    def queries(self) -> int:
        """The number of queries of all kinds."""
        return self.masks + self.searches + self.checks

    @property
    def undecided_share(self) -> float:
        """The share of locations that cells could not decide; 0 without locations."""
        return self.undecided / max(self.locations, 1)

    @property
    def mesh_comparisons_per_query(self) -> float:
        """The mean number of mesh comparisons of a query; 0 without queries."""
        return self.mesh_comparisons / max(self.queries, 1)

    def since(self, earlier: Counters) -> Counters:
        """Return the counts since an earlier reading; the sizes of caches are the current ones."""
        counts = {
            field.name: getattr(self, field.name) - getattr(earlier, field.name)
            for field in fields(self)
            if field.name != "caches"
        }
        used = {
            name: replace(
                now,
                hits=now.hits - earlier.caches[name].hits,
                misses=now.misses - earlier.caches[name].misses,
            )
            for name, now in self.caches.items()
        }
        return Counters(**counts, caches=used)


_counts = dict.fromkeys(
    ("masks", "searches", "checks", "locations", "undecided", "mesh_comparisons"), 0
)


@dataclass
class ComparisonCounter:
    """Counts the mesh comparisons that are made while it is active (see `counted_by`).

    Attributes
    ----------
    mesh_comparisons : int
        Comparisons so far.
    """

    mesh_comparisons: int = 0


_active: ContextVar[ComparisonCounter | None] = ContextVar("active", default=None)


def count(kind: str, locations: int, undecided: int) -> None:
    """Count one query; `kind` is "masks", "searches" or "checks"."""
    with caches.lock:
        _counts[kind] += 1
        _counts["locations"] += locations
        _counts["undecided"] += undecided


@contextmanager
def counted_by(counter: ComparisonCounter) -> Iterator[None]:
    """Count the mesh comparisons of a block, in this thread only; the innermost block counts."""
    token = _active.set(counter)
    try:
        yield
    finally:
        _active.reset(token)


def count_mesh_comparisons(number: int) -> None:
    """Count collision tests of meshes that no cache answered."""
    with caches.lock:
        _counts["mesh_comparisons"] += number
    counter = _active.get()
    if counter is not None:
        counter.mesh_comparisons += number


def counters() -> Counters:
    """Return what this process has counted until now."""
    with caches.lock:
        counts = dict(_counts)
    return Counters(**counts, caches=caches.usage())
