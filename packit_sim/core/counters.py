"""What the placement engine did since the process began: for users who wonder where time goes."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from packit_sim.core import caches


@dataclass(frozen=True)
class Counters:
    """Counts of one process, over all its boxes and threads.

    masks, searches, checks: questions for the whole mask, for the BLBF location, and about one
    location. locations: of which cells were asked; undecided: of them, those that cells left open,
    for the meshes to decide. fcl_calls: questions that no memory of the same pair could answer.
    caches: see `caches.CacheUsage`.
    """

    masks: int
    searches: int
    checks: int
    locations: int
    undecided: int
    fcl_calls: int
    caches: dict[str, caches.CacheUsage]

    @property
    def queries(self) -> int:
        return self.masks + self.searches + self.checks

    @property
    def undecided_share(self) -> float:
        """The share of locations that cells left open; 0 where none was asked about."""
        return self.undecided / max(self.locations, 1)

    @property
    def fcl_calls_per_query(self) -> float:
        return self.fcl_calls / max(self.queries, 1)

    def since(self, earlier: Counters) -> Counters:
        """What was counted after an earlier reading; sizes of caches are as they are now."""
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


_COUNTED = ("masks", "searches", "checks", "locations", "undecided")
_counts = dict.fromkeys(_COUNTED, 0)

_ANSWERS = ("collisions", "collisions with bodies")
"""The caches of what FCL said."""


def count(kind: str, locations: int, undecided: int) -> None:
    """Counts one query: "masks", "searches" or "checks"."""
    with caches.lock:
        _counts[kind] += 1
        _counts["locations"] += locations
        _counts["undecided"] += undecided


def statistics() -> Counters:
    """What this process counted until now."""
    with caches.lock:
        counts = dict(_counts)
    used = caches.usage()
    return Counters(**counts, fcl_calls=sum(used[kind].misses for kind in _ANSWERS), caches=used)
