"""The search for the best packing of a task: box after box, or all boxes together."""

from __future__ import annotations

import itertools
import math
import threading
import time as clock
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.block_lattices import latticed
from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.filling.brick_windows import BrickWindows
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.delivered_filling import ROUNDS, delivered_filling
from packit_sim.parts.filling.grouped_filling import GroupedFilling
from packit_sim.parts.filling.interruption import interruption_noted
from packit_sim.parts.filling.lowering import Lowering
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.shelf_filling import allowed, shelved_box, shelved_boxes
from packit_sim.parts.nesting.nest import NestingError
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.sizes import fits

_FULL = 0.6
"""Share of the boxes' volume above which parts probably do not fit into all of them."""

_REPEATS = 4
"""Searches for a box, if their iterations are limited, while constraints leave parts out."""

_FIRST = 0.4
"""Share of the time for a search that does not know the order of parts, before one that does."""

_BY_VOLUME = 0.15
"""Share of the time in which volume counts, not worth, for a box that may hold all parts."""

_LATTICE_TIME = 0.3
"""Share of the time for a box in which lattices are put into it, at most."""

_WINDOW_TIME = 0.5
"""Share of the time for a box that a search in windows has for a gain, if none took longer."""

_NEXT_SEED = 1000
"""Difference of the seeds of searches for a box; a search that resumes adds 1."""


class PackingSearch:
    """A search for the best packing of a task.

    Parameters
    ----------
    first : PackedParts
        The packing that the search begins with, or one without boxes.
    end : float
        When it ends, by `time.perf_counter`.
    callback : callable, optional
        Called with each better packing.

    Attributes
    ----------
    best : PackedParts
        The best packing so far.
    """

    def __init__(
        self,
        first: PackedParts,
        end: float,
        seed: int,
        callback: Callable[[PackedParts], object] | None = None,
    ) -> None:
        self.best = first
        self._first = first
        self._task = first.task
        self._end = end
        self._seed = seed
        self._callback = callback
        self._stopped = first.task.settings.stop or threading.Event()
        self._known_fits: dict[tuple[int, BoxType | None, bool], bool] = {}
        self._nesting = BoxNesting(first.task, self._stopped)

    def run(self) -> PackedParts:
        """Search until the time is over, nothing better is possible, or Ctrl-C.

        Returns
        -------
        PackedParts
            The best packing.

        Raises
        ------
        NestingError
            If no valid packing was found.
        """
        parts = enumerate(self._task.parts)
        counts = {n: part.part.count for n, part in parts if self._fits(n)}
        if not counts or self._is_done(self.best, counts):
            return self.best
        try:
            with interruption_noted(self._stopped):
                self._search(counts)
        except (KeyboardInterrupt, NestingError):
            if not self.best.packings:
                raise
        return self.best

    def _search(self, counts: Mapping[int, int]) -> None:
        boxes = shelved_boxes(self._nesting, self._boxes_by_size, counts)
        shelves = self._candidate(boxes)
        self._offer(shelves)
        if self._is_best(shelves, counts) and self._task.objective != "height":
            return
        searched = {n: k for n, k in counts.items() if self._fits(n, in_search=True)}
        if searched:
            self._nest_all(searched)

    def _is_best(self, packed: PackedParts, counts: Mapping[int, int]) -> bool:
        """Return whether all parts are packed, and in as few boxes as their volume allows."""
        if packed.counts != counts:
            return False
        box = self._boxes_by_size[0]
        masses = [self._task.parts[n].mass for n in counts for _ in range(counts[n])]
        shares = [sum(own) / most for own, most in box.limits.sums(masses)]
        share = max(packed.volume / box.container.volume, *shares, 0.0)
        fewest = max(1, math.ceil(share * (1 - 1e-6)))
        return self._task.objective != "boxes" or len(packed.packings) == fewest

    @property
    def _boxes_by_size(self) -> list[BoxType]:
        """The boxes in the order in which they are filled."""
        boxes = list(self._task.boxes)
        if self._task.objective == "boxes":
            boxes.sort(key=lambda box: -box.container.volume)
        return boxes

    def _nest_all(self, counts: Mapping[int, int]) -> None:
        objective, first = self._task.objective, self._task.boxes[0]
        bodies = self._nesting.bodies
        is_plain = not any(bodies(b) or not b.limits.is_empty for b in self._task.boxes)
        is_plain = is_plain and not (self._task.settings.groups or self._task.stops)
        may_be_together = objective == "boxes" and is_plain and self._task.stretch == 1
        if may_be_together and self._can_all_fit(counts):
            self._fill_together(counts)
        else:
            left = self._fill_one_by_one(counts)
            if objective == "height" and not left and not self._is_over:
                self._lower(first, counts)

    def _fill_one_by_one(self, counts: Mapping[int, int]) -> dict[int, int]:
        """Fill box after box; return the parts that are left."""
        left = dict(counts)
        stock = {box: math.inf if box.count is None else box.count for box in self._task.boxes}
        boxes = self._boxes_by_size
        full: list[Packing] = []
        while left:
            usable = (
                b for b in boxes if stock[b] > 0 and any(self._fits(n, b, True) for n in left)
            )
            box = next(usable, None)
            if box is None:
                break
            stock[box] -= 1
            own = {n: k for n, k in left.items() if self._fits(n, box, True)}
            more = sum(stock.values())
            found = self._fill_by_rules(box, own, full, self._seconds(own, box, more), more == 0)
            if found is None:
                break
            full.append(found)
            for n, k in Counter(one.type for one in found.placements).items():
                left[n] -= k
            left = self._not_begun({n: k for n, k in left.items() if k > 0}, found)
            if self._stopped.is_set():
                break
        return left

    def _not_begun(self, left: dict[int, int], packing: Packing) -> dict[int, int]:
        """Return the parts that may be in a box after one: not of groups that share that one."""
        if not {"together", "kit"} & set(self._task.settings.groups):
            return left
        parts = [each.part for each in self._task.parts]
        begun = {parts[one.type].group for one in packing.placements} - {None}
        return {n: k for n, k in left.items() if parts[n].group not in begun}

    def _fill_by_rules(
        self,
        box: BoxType,
        counts: Mapping[int, int],
        full: list[Packing],
        seconds: float,
        is_last: bool,
    ) -> Packing | None:
        """Fill one box as the rules of groups allow; return its contents, or None."""
        if not self._task.settings.groups:
            return self._fill(box, counts, full, seconds)[0]

        end = clock.perf_counter() + seconds

        def fill(
            some: Mapping[int, int], share: float, start: Packing | None
        ) -> tuple[Packing | None, Counter[int]]:
            if not some or self._stopped.is_set():
                return None, Counter()
            shelves = shelved_box(self._nesting, box, some)
            quick = self._candidate([*full, *([shelves] if shelves else [])])
            self._offer(quick)
            if quick.count == sum(some.values()) + sum(len(each.placements) for each in full):
                return quick.packings[-1], Counter(some)
            best = quick.packings[-1] if len(quick.packings) > len(full) else None
            if (left := end - clock.perf_counter()) <= 0:
                return best, Counter(one.type for one in best.placements) if best else Counter()
            found, most = self._fill(box, some, full, left * share, start)
            return max(filter(None, (best, found)), key=self._weight, default=None), most

        return GroupedFilling(self._task, box, counts, fill, is_last).run()

    def _fill(
        self,
        box: BoxType,
        counts: Mapping[int, int],
        full: list[Packing],
        seconds: float,
        start: Packing | None = None,
    ) -> tuple[Packing | None, Counter[int]]:
        """Fill one box.

        Parameters
        ----------
        full : list of Packing
            The boxes before it.
        start : Packing, optional
            The contents to begin with.

        Returns
        -------
        Packing or None
            Its best contents, or None if nothing goes in.
        Counter
            How many of each part were in the fullest contents, which may break a rule.
        """
        best: PackedParts | None = None
        most = Counter[int]()
        total = sum(counts.values()) + sum(len(each.placements) for each in full)

        def consider(packing: Packing) -> None:
            nonlocal best, most
            own = Counter(one.type for one in packing.placements)
            most = max(most, own, key=Counter.total)
            found = self._candidate([*full, packing])
            if best is None or found.score > best.score:
                best = found
            self._offer(found)

        def better(packing: Packing) -> None:
            for each in self._nesting.in_boxes(packing, box):
                consider(each)

        end = clock.perf_counter() + seconds
        start = start or self._earlier(box, len(full))
        if start is None and (start := self._latticed(box, counts, seconds)):
            consider(start)
            if most.total() == sum(counts.values()) and best is not None and best.count == total:
                return start, most
        if start is not None:
            start = self._windowed(box, counts, start, end, consider)
            if clock.perf_counter() > end and best is not None:
                return best.packings[-1], most
        ordered = delivered_filling(self._nesting, box, counts)
        for number in range(_REPEATS) if self._task.settings.iterations else itertools.count():
            before = clock.perf_counter()
            seed = self._seed + _NEXT_SEED * number
            if ordered is not None and (self._task.stops or number > 0):
                better(ordered.fill(min(seconds / ROUNDS, end - before), seed))
            else:
                given = self._nesting.inner(box), "knapsack", counts
                left = (end - before) * (1.0 if ordered is None else _FIRST)
                if number == 0 and start is None and self._may_hold_all(box, counts):
                    share = left * _BY_VOLUME
                    with suppress(NestingError):  # the search by worth has more time
                        self._nesting.nest(*given, share, better, seed, None, box.limits, True)
                left += before - clock.perf_counter()
                is_all = best is not None and best.count == total
                if not (is_all or self._stopped.is_set()):
                    self._nesting.nest(*given, left, better, seed, start, box.limits)
            start = None
            now = clock.perf_counter()
            is_over = self._stopped.is_set() or now + (now - before) > end
            is_all = best is not None and best.count == total
            if is_over or is_all or not self._task.is_constrained:
                break
        if best is None or len(best.packings) <= len(full):
            return None, most
        return best.packings[-1], most

    def _latticed(self, box: BoxType, counts: Mapping[int, int], seconds: float) -> Packing | None:
        """Fill a box that is not empty or no box with lattices, in a share of the time."""
        if not (bodies := self._nesting.bodies(box)):
            return None
        end = clock.perf_counter() + _LATTICE_TIME * seconds
        own = allowed(self._task, box, counts)
        return latticed(self._task, box, own, bodies, lambda: clock.perf_counter() > end)

    def _windowed(
        self,
        box: BoxType,
        counts: Mapping[int, int],
        start: Packing,
        end: float,
        consider: Callable[[Packing], None],
    ) -> Packing:
        """Search for more bricks in a container that is no empty box; return the most found."""
        bodies, iterations = self._nesting.bodies(box), self._task.settings.iterations
        windows = BrickWindows(self._task, box, counts, bodies, self._seed)
        is_of_bricks = all(one.type in counts for one in start.placements)
        if not (bodies and windows.is_possible and is_of_bricks):
            return start
        found = start
        begun = last = clock.perf_counter()
        least = _WINDOW_TIME * (end - begun)

        def better(packing: Packing) -> None:
            nonlocal found, last
            found, last = packing, clock.perf_counter()
            consider(packing)

        def is_over() -> bool:
            now = clock.perf_counter()
            is_late = now - last > max(least, last - begun)
            return is_late or now > end or self._stopped.is_set()

        windows.run(start, iterations, is_over, better)
        return found

    def _fill_together(self, counts: Mapping[int, int]) -> None:
        """Search for the fewest boxes, of one size or of several that there are enough of."""
        types = self._task.boxes
        limit = types[0].count

        def better(packing: Packing) -> None:
            boxes = self._nesting.in_boxes(packing, *types)
            if limit is not None and len(boxes) > limit:
                boxes.sort(key=self._weight, reverse=True)
                boxes = boxes[:limit]
            self._offer(self._candidate(boxes))

        inner = [self._nesting.inner(each) for each in types]
        self._nesting.nest(inner, "bins", counts, self._left, better, self._seed)

    def _lower(self, box: BoxType, counts: Mapping[int, int]) -> None:
        """Search for the least height of all parts, below that of the best packing."""

        def offer(packing: Packing) -> float:
            self._offer(self._candidate([packing]))
            return self.best.packings[0].height

        lowering = Lowering(self._nesting, box, counts, offer, lambda: self._left)
        lowering.run(self.best.packings[0], self._seed, self._earlier(box, 0))

    def _earlier(self, box: BoxType, number: int) -> Packing | None:
        """Return the box of this number in the packing that the search began with."""
        packings = self._first.packings
        if number < len(packings) and packings[number].container.name == box.name:
            return packings[number]
        return None

    def _candidate(self, packings: Sequence[Packing]) -> PackedParts:
        return candidate(self._task, packings, self._first.searches)

    def _offer(self, found: PackedParts) -> None:
        if found.score > self.best.score:
            self.best = found
            if self._callback is not None:
                self._callback(found)

    def _fits(self, number: int, box: BoxType | None = None, in_search: bool = False) -> bool:
        """Return whether a part fits into a box, or any: for the nester, with its tolerance."""
        key = number, box, in_search
        if key not in self._known_fits:
            part = self._task.parts[number]
            margin = self._task.search_margin if in_search else self._task.margin
            boxes = self._task.boxes if box is None else (box,)
            self._known_fits[key] = any(
                each.limits.allow(part.mass) and fits(part, each, margin) for each in boxes
            )
        return self._known_fits[key]

    def _can_all_fit(self, counts: Mapping[int, int]) -> bool:
        """Return whether all parts probably fit the available boxes, filled together."""
        box, *others = self._task.boxes
        if box.count is None or others:
            return all(each.count is None for each in self._task.boxes)
        volume = self._volume(counts)
        return box.count > 1 and volume <= _FULL * box.count * box.container.volume

    def _may_hold_all(self, box: BoxType, counts: Mapping[int, int]) -> bool:
        """Return whether a box may hold all parts, although what counts is not their volume.

        Then large parts, which are worth no more than small ones, must not be left for last. Where
        not all fit after all, the search by worth begins anew: large parts are in its way.
        """
        has_room = self._volume(counts) <= _FULL * box.container.volume
        return has_room and self._task.objective in ("count", "value")

    def _volume(self, counts: Mapping[int, int]) -> float:
        return plain_sum(self._task.parts[n].volume * k for n, k in counts.items())

    def _is_done(self, packed: PackedParts, counts: Mapping[int, int]) -> bool:
        """Return whether nothing better is possible: all parts are packed."""
        is_all = packed.counts == counts
        if self._task.objective == "boxes":
            return is_all and len(packed.packings) == 1
        return is_all and self._task.objective != "height"

    def _weight(self, packing: Packing) -> float:
        counts = Counter(one.type for one in packing.placements)
        return sum(self._task.weights[n] * k for n, k in counts.items())

    def _seconds(self, counts: Mapping[int, int], box: BoxType, more: float) -> float:
        """Return the time for a box: that of all boxes that may follow is the same."""
        volume = self._volume(counts)
        space = min(self._nesting.inner(box).volume, box.container.volume)
        needed = math.ceil(volume / (_FULL * space))
        if "apart" in self._task.settings.groups:
            needed = max(needed, len({self._task.parts[n].part.group for n in counts}))
        return self._left / max(1, min(needed, more + 1))

    @property
    def _left(self) -> float:
        """Seconds that are left; without end where passes are counted instead, 0 if stopped."""
        if self._stopped.is_set():
            return 0.0
        if self._task.settings.iterations is not None:
            return math.inf
        return self._end - clock.perf_counter()

    @property
    def _is_over(self) -> bool:
        return self._left <= 0
