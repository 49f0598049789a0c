"""The filling of one box with parts of groups: which groups to try, until those in it are whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.boxes import BoxType

_FULL = 0.9
"""Share of a box's volume up to which whole groups are tried together."""

_MAX_TRIED = 4
"""Groups that are tried for a box, one after the other, where only one may be in it, or where one
more may fit."""

_SHARE = 1 / 3
"""Share of the time left for each step."""

_MORE = 1.2
"""Volume of the groups that are tried again, relative to what was in the fullest box before."""

Fill = Callable[[Mapping[int, int], float, Packing | None], tuple[Packing | None, Counter[int]]]
"""Fills the box with some of the parts, in a share of the time left, from a packing to begin with.
It returns the best packing that keeps all rules, and how many parts were in the fullest one."""


class GroupedFilling:
    """The filling of one box.

    Parameters
    ----------
    task : PackTask
        The task, with rules of groups.
    box : BoxType
        The box.
    counts : mapping of int to int
        How many of each part may be in it.
    fill : callable
        See `Fill`.
    is_last : bool
        Whether no other box follows.
    """

    def __init__(
        self, task: PackTask, box: BoxType, counts: Mapping[int, int], fill: Fill, is_last: bool
    ) -> None:
        self._task, self._box, self._counts, self._fill = task, box, counts, fill
        rules = task.settings.groups
        self._is_kit, self._is_apart = "kit" in rules, "apart" in rules
        self._is_whole = self._is_kit or ("together" in rules and not is_last)
        self._groups = {
            group: [n for n in numbers if n in counts] for group, numbers in task.groups.items()
        }

    def run(self) -> Packing | None:
        """Fill the box.

        Returns
        -------
        Packing or None
            Its contents, which keep the rules; None if nothing is in it.
        """
        groups = [group for group, numbers in self._groups.items() if numbers]
        groups.sort(key=self._promise, reverse=True)
        if not self._is_apart:
            return self._filled(groups, 1.0)
        tried = [[group] for group in groups[:_MAX_TRIED]] or [[]]
        found = (self._filled(each, 1 / len(tried)) for each in tried)
        return max((each for each in found if each), key=self._worth, default=None)

    def _filled(self, groups: Sequence[str], share: float) -> Packing | None:
        """Fill the box with some groups, and with parts of none."""
        if not self._is_whole or not groups:
            return self._fill(self._parts(groups), share, None)[0]
        able = [g for g in groups if self._task.may_hold(self._box, self._task.groups[g])]
        chosen = self._within(able, _FULL)
        found, chosen = self._with_whole(chosen, share)
        for group in [g for g in able if g not in chosen][:_MAX_TRIED]:
            if group in self._within([*chosen, group], 1.0):
                more, kept = self._with_whole([*chosen, group], share * _SHARE, found)
                if len(kept) > len(chosen):
                    found, chosen = more, kept
        if not chosen and not self._is_kit:  # one that can be whole in no box is cut
            found = self._fill(self._parts(groups[:1]), share * _SHARE, found)[0] or found
        return found

    def _with_whole(
        self, chosen: Sequence[str], share: float, found: Packing | None = None
    ) -> tuple[Packing | None, list[str]]:
        """Fill the box, and drop groups of which least is in it, until all are whole.

        Of groups that are cut, as many go at a time as leave what the fullest box had, and a little
        more: one at a time, hundreds of groups would take hundreds of searches.
        """
        left, start = list(chosen), found
        while True:
            found, most = self._fill(self._parts(left), share * _SHARE, start)
            packed = Counter(one.type for one in found.placements) if found else Counter[int]()
            cut = [group for group in left if not self._is_in(group, packed)]
            if not cut:
                return found, left
            over = plain_sum(map(self._volume, left)) - _MORE * self._packed_volume(left, most)
            goes: set[str] = set()
            for group in sorted(cut, key=lambda group: self._share(group, most)):
                if not goes or over > 0:
                    goes.add(group)
                    over -= self._volume(group)
            left = [group for group in left if group not in goes]

    def _parts(self, groups: Sequence[str]) -> dict[int, int]:
        """Return how many of each part of some groups, and of none, there are."""
        known = {n for group in groups for n in self._groups[group]}
        parts = self._task.parts
        return {n: k for n, k in self._counts.items() if n in known or not parts[n].part.group}

    def _within(self, groups: Sequence[str], full: float) -> list[str]:
        """Return those groups, in their order, whose volume is within a share of the box's."""
        left = full * self._box.container.volume
        found: list[str] = []
        for group in groups:
            if (volume := self._volume(group)) <= left:
                left -= volume
                found.append(group)
        return found

    def _volume(self, group: str) -> float:
        return plain_sum(self._task.parts[n].volume * self._counts[n] for n in self._groups[group])

    def _packed_volume(self, groups: Sequence[str], packed: Counter[int]) -> float:
        numbers = (n for group in groups for n in self._groups[group])
        return plain_sum(self._task.parts[n].volume * packed[n] for n in numbers)

    def _promise(self, group: str) -> float:
        """Return the worth of what probably fits of a group, relative to its space."""
        worth = sum(self._task.weights[n] * self._counts[n] for n in self._groups[group])
        if self._task.objective == "boxes":
            return self._volume(group)
        space = max(self._volume(group), 1e-300)
        most = _FULL * self._box.container.volume
        return worth * min(1.0, most / space) if self._is_apart else worth / space

    def _share(self, group: str, packed: Counter[int]) -> float:
        numbers = self._groups[group]
        return sum(packed[n] for n in numbers) / sum(self._counts[n] for n in numbers)

    def _is_in(self, group: str, packed: Counter[int]) -> bool:
        return all(packed[n] == self._counts[n] for n in self._groups[group])

    def _worth(self, packing: Packing) -> float:
        return sum(self._task.weights[one.type] for one in packing.placements)
