"""Estimates of the time that the generation of a dataset still takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Evolved
from packit_sim.game.generation.jobs import EvolutionProgress, SearchSettings

ENOUGH = 20
"""Generations per worker before the first estimate: the first ones are the slowest."""

MINUTE, HOUR, DAY = 60, 3600, 86400
"""In seconds."""


@dataclass
class TimeEstimate:
    """The time that a generation job still takes, estimated from its pace so far.

    An evolution is expected to have as many generations as those that ended after more generations
    than it has, or as its settings allow if there is none; so with early stopping it is rough. The
    rounds of densifications count as generations.

    Attributes
    ----------
    settings : EvolutionSettings or DensificationSettings
        The settings of the searches.
    packs : int
        The number of searches.
    workers : int
        The number of searches that run at the same time.
    since : float
        The start of the measurement, in seconds of any clock.
    before : iterable of EvolutionProgress
        The unfinished searches at that time.
    done : mapping of int to Pack
        The finished packs at that time, by number.
    """

    settings: SearchSettings
    packs: int
    workers: int
    since: float
    before: Iterable[EvolutionProgress] = ()
    done: Mapping[int, Pack] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._lengths = {n: self._length(pack) for n, pack in self.done.items()}
        self._before = {p.number: p.generation + 1 for p in self.before}
        self._worked = self._finished = 0
        self._crew = max(1, min(self.workers, self.packs - len(self._lengths)))

    def is_over(self, number: int) -> bool:
        """Return whether a pack is finished."""
        return number in self._lengths

    def finish(self, number: int, pack: Pack) -> None:
        """Count a pack that was finished just now."""
        length = self._length(pack)
        self._lengths[number] = length
        self._worked += max(0, length - self._before.get(number, 0))
        self._finished += 1

    def seconds_left(self, under_way: Iterable[EvolutionProgress], now: float) -> float | None:
        """Estimate the seconds until the last pack is finished; None while too little is known."""
        at = {p.number: p.generation + 1 for p in under_way if not self.is_over(p.number)}
        worked = self._worked + sum(done - self._before.get(n, 0) for n, done in at.items())
        if not self._finished and worked < ENOUGH * self._crew:
            return None
        waiting = self.packs - len(self._lengths) - len(at)
        left = [self._expected(done) - done for done in at.values()]
        left += [self._expected(0)] * waiting
        if not left:
            return 0.0
        seconds = (now - self.since) / max(1, worked)
        return seconds * max(sum(left), self._crew * max(left))

    def _expected(self, done: int) -> float:
        """Estimate the length of an evolution that has done a number of generations."""
        longer = [length for length in tuple(self._lengths.values()) if length > done]
        return sum(longer) / len(longer) if longer else max(self.settings.steps, done)

    def _length(self, pack: Pack) -> int:
        """Compute the generations of an evolution from its best pack, patience and limit."""
        found = pack.provenance
        if isinstance(found, Evolved):
            return min(found.generation + found.settings.patience + 1, found.settings.steps)
        return self.settings.steps


def format_remaining(seconds: float | None) -> str:
    """Format a time estimate no more exactly than it is known; "" for None or 0."""
    if not seconds:
        return ""
    if seconds < MINUTE:
        return "less than a minute left"
    if seconds < HOUR:
        return f"about {seconds / MINUTE:.0f} min left"
    if seconds < 10 * HOUR:
        hours, minutes = divmod(10 * round(seconds / (10 * MINUTE)), 60)
        return f"about {hours} h {minutes} min left" if minutes else f"about {hours} h left"
    if seconds < 2 * DAY:
        return f"about {seconds / HOUR:.0f} h left"
    return f"about {seconds / DAY:.1f} days left"
