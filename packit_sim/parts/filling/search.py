"""The search for the best packing of a task: box after box, or all boxes together."""

from __future__ import annotations

import itertools
import math
import signal
import threading
import time as clock
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.balance import centred, nest_balance
from packit_sim.parts.filling.block_lattices import latticed
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.delivered_filling import DeliveredFilling
from packit_sim.parts.filling.grouped_filling import GroupedFilling
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.shelves import shelved
from packit_sim.parts.filling.stretching import StretchedTypes
from packit_sim.parts.nesting.nest import NestingError, NestSettings, nest
from packit_sim.parts.packings.bounds import SUM_ROUNDING
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.limits import NO_LIMITS, Limits
from packit_sim.parts.reading.sizes import fits

_FULL = 0.6
"""Share of the boxes' volume above which parts probably do not fit into all of them."""

_SECONDS = 0.05, 1e6
"""Seconds that a box gets, at least and at most."""

_REPEATS = 4
"""Searches for a box, if their iterations are limited, while constraints leave parts out."""

_LATTICE_TIME = 0.3
"""Share of the time for a box in which lattices are put into it, at most."""

_ROUNDS = 4
"""Times that a box is filled with parts for several stops, at least if there is time."""

_STEPS = 0.08, 0.005
"""Shares by which a height is lowered at a time, at first and at last."""

_STEP_TIME = 0.25
"""Share of the time that is left for each."""

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
        self._known_bodies: dict[BoxType, tuple[ItemType, ...]] = {}
        self._stopped = first.task.settings.stop or threading.Event()

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
            with _stop_noted(self._stopped):
                self._search(counts)
        except (KeyboardInterrupt, NestingError):
            if not self.best.packings:
                raise
        return self.best

    def _search(self, counts: Mapping[int, int]) -> None:
        shelves = self._shelves(counts)
        self._offer(shelves)
        if self._is_best(shelves, counts) and self._task.objective != "height":
            return
        margin = self._task.search_margin
        searched = {n: k for n, k in counts.items() if self._fits(n, margin=margin)}
        if searched:
            self._nest_all(searched)

    def _shelves(self, counts: Mapping[int, int]) -> PackedParts:
        """Fill box after box by shelves, as far as that is valid."""
        left = dict(counts)
        found: list[Packing] = []
        for box in self._boxes_by_size:
            stock = math.inf if box.count is None else box.count
            while left and stock > 0:
                packing = self._shelved(box, left)
                if packing is None:
                    break
                found.append(packing)
                stock -= 1
                for n, k in Counter(one.type for one in packing.placements).items():
                    left[n] -= k
                left = {n: k for n, k in left.items() if k > 0}
        return self._candidate(found)

    def _shelved(self, box: BoxType, counts: Mapping[int, int]) -> Packing | None:
        """Fill a box by shelves, if that is valid."""
        if self._bodies(box):
            return None
        placements = shelved(self._task, self._allowed(box, counts), box.size)
        packing = self._task.packing(self._task.container(box), placements)
        packing = centred(self._task, packing)
        return None if not placements or packing.problems() else packing

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

    def _allowed(self, box: BoxType, counts: Mapping[int, int]) -> dict[int, int]:
        """Return how many of each part the limits of a box allow, the most valuable first."""
        numbers = list(counts)
        sums = box.limits.sums([self._task.parts[n].mass for n in numbers])
        if not sums:
            return dict(counts)
        shares = np.array([np.array(own) / most for own, most in sums])
        values = np.array([self._task.weights[n] for n in numbers])
        left, found = np.full(len(sums), 1 + SUM_ROUNDING), {}
        for k in np.argsort(-values / shares.max(axis=0), kind="stable").tolist():
            copies = int(min(counts[numbers[k]], *(left // np.maximum(shares[:, k], 1e-15))))
            left -= copies * shares[:, k]
            if copies:
                found[numbers[k]] = copies
        return found

    @property
    def _boxes_by_size(self) -> list[BoxType]:
        """The boxes in the order in which they are filled."""
        boxes = list(self._task.boxes)
        if self._task.objective == "boxes":
            boxes.sort(key=lambda box: -box.container.volume)
        return boxes

    def _nest_all(self, counts: Mapping[int, int]) -> None:
        objective, first = self._task.objective, self._task.boxes[0]
        is_plain = not any(self._bodies(b) or not b.limits.is_empty for b in self._task.boxes)
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
        boxes, margin = self._boxes_by_size, self._task.search_margin
        full: list[Packing] = []
        while left:
            usable = (
                b for b in boxes if stock[b] > 0 and any(self._fits(n, b, margin) for n in left)
            )
            box = next(usable, None)
            if box is None:
                break
            stock[box] -= 1
            own = {n: k for n, k in left.items() if self._fits(n, box, margin)}
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
            shelves = self._shelved(box, some)
            quick = self._candidate([*full, *([shelves] if shelves else [])])
            self._offer(quick)
            if quick.count == sum(some.values()) + sum(len(each.placements) for each in full):
                return quick.packings[-1], Counter(some)
            found, most = self._fill(box, some, full, (end - clock.perf_counter()) * share, start)
            own = quick.packings[len(full) :]
            best = max((*own, *([found] if found else [])), key=self._weight, default=None)
            return best, most

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
            for each in self._in_boxes(packing, box):
                consider(each)

        end = clock.perf_counter() + seconds
        start = start or self._earlier(box, len(full))
        if start is None and (start := self._latticed(box, counts, seconds)):
            consider(start)
            if most.total() == sum(counts.values()) and best is not None and best.count == total:
                return start, most
        stops = self._delivered(box, counts) if self._task.stops else None
        for number in range(_REPEATS) if self._task.settings.iterations else itertools.count():
            before = clock.perf_counter()
            seed = self._seed + _NEXT_SEED * number
            if stops is not None:
                better(stops.fill(min(seconds / _ROUNDS, end - before), seed))
            else:
                inner, left = self._inner(box), end - before
                self._nest(inner, "knapsack", counts, left, better, start, seed, box.limits)
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
        if not self._bodies(box):
            return None
        end = clock.perf_counter() + _LATTICE_TIME * seconds
        own = self._allowed(box, counts)
        return latticed(self._task, box, own, self._bodies(box), lambda: clock.perf_counter() > end)

    def _delivered(self, box: BoxType, counts: Mapping[int, int]) -> DeliveredFilling:
        """Return the filling of a box with parts for several stops."""

        def fill(
            slab: BoxContainer, some: Mapping[int, int], seconds: float, seed: int
        ) -> Packing | None:
            found: list[Packing] = []
            with suppress(NestingError):
                self._nest(slab, "knapsack", some, seconds, found.append, seed=seed)
            return found[-1] if found else None

        return DeliveredFilling(self._task, self._inner(box), self._allowed(box, counts), fill)

    def _fill_together(self, counts: Mapping[int, int]) -> None:
        """Search for the fewest boxes, of one size or of several that there are enough of."""
        types = self._task.boxes
        limit = types[0].count

        def better(packing: Packing) -> None:
            boxes = self._in_boxes(packing, *types)
            if limit is not None and len(boxes) > limit:
                boxes.sort(key=self._weight, reverse=True)
                boxes = boxes[:limit]
            self._offer(self._candidate(boxes))

        inner = [self._inner(each) for each in types]
        self._nest(inner, "bins", counts, self._left, better)

    def _lower(self, box: BoxType, counts: Mapping[int, int]) -> None:
        """Search for the least height of all parts, below the box's."""
        if self._task.stretch != 1 or box.limits.balance is not None:
            self._lower_by_steps(box, counts)
            return
        inner = self._inner(box)
        x, y, z = inner.size

        def better(packing: Packing) -> None:
            if packing.height <= z:
                packing = replace(packing, container=inner, objective="knapsack")
                self._offer(self._candidate(self._in_boxes(packing, box)))

        strip = BoxContainer((x, y, math.inf), inner.obstacles)
        self._nest(strip, "strip", counts, self._left, better, self._earlier(box, 0))

    def _lower_by_steps(self, box: BoxType, counts: Mapping[int, int]) -> None:
        """Search for all parts in lower and lower boxes, where a strip is not possible."""
        margin, step = self._task.search_margin, _STEPS[0]
        while step >= _STEPS[1] and not self._is_over:
            height = self.best.packings[0].height * (1 - step)
            inner = self._inner(box, height + margin.top)
            is_all = False

            def better(packing: Packing) -> None:
                nonlocal is_all
                is_all = len(packing.placements) == sum(counts.values())
                if is_all:
                    self._offer(self._candidate(self._in_boxes(packing, box)))

            seconds = self._left * _STEP_TIME
            start = self._earlier(box, 0)
            self._nest(inner, "knapsack", counts, seconds, better, start, limits=box.limits)
            step = step if is_all else step / 2

    def _earlier(self, box: BoxType, number: int) -> Packing | None:
        """Return the box of this number in the packing that the search began with."""
        packings = self._first.packings
        if number < len(packings) and packings[number].container.name == box.name:
            return packings[number]
        return None

    def _nest(
        self,
        containers: BoxContainer | Sequence[BoxContainer],
        objective: str,
        counts: Mapping[int, int],
        seconds: float,
        better: Callable[[Packing], None],
        start: Packing | None = None,
        seed: int | None = None,
        limits: Limits = NO_LIMITS,
    ) -> None:
        """Nest some of the parts; the packings' types are those of all parts."""
        task, settings = self._task, self._task.settings
        numbers = sorted(counts)
        types = [task.types[n].changed(counts[n], value=task.weights[n]) for n in numbers]
        first = None if start is None else self._start(start, types, numbers)
        sums = limits.sums([task.parts[n].mass for n in numbers])
        balance = nest_balance(task, limits, numbers, containers)
        stretched: StretchedTypes | None = None
        own, container = tuple(types), containers
        if task.stretch != 1:
            assert isinstance(containers, BoxContainer)
            stretched = StretchedTypes(types, task.stretch)
            own, container = stretched.types, stretched.container(containers)
            sums = stretched.limits(sums, [counts[n] for n in numbers])
            balance = balance and stretched.balance(balance)
            if first is not None:
                known = filter(None, map(stretched.stretched, first.placements))
                first = Packing(own, container, tuple(known), 0.0, "knapsack")

        def of_all(packing: Packing, _: float) -> None:
            found = packing.placements
            if stretched is not None:
                assert isinstance(containers, BoxContainer)
                found = tuple(map(stretched.unstretched, found))
                packing = replace(packing, container=containers)
            placements = [replace(one, type=numbers[one.type]) for one in found]
            better(replace(packing, types=task.types, placements=tuple(placements)))

        nest(
            own,
            container,
            objective,
            min(max(seconds, _SECONDS[0]), _SECONDS[1]),
            self._seed if seed is None else seed,
            task.gap,
            of_all,
            NestSettings(
                settings.workers,
                settings.backend,
                settings.address,
                settings.iterations,
                start=first,
                stop=self._stopped,
                limits=sums,
                balance=balance,
            ),
        )

    def _start(
        self, packing: Packing, types: Sequence[ItemType], numbers: Sequence[int]
    ) -> Packing:
        """Move the parts of a box into the inner container, as a packing of some types."""
        box = next(each for each in self._task.boxes if each.name == packing.container.name)
        inner_from_box = Motion.shift(-self._task.search_margin.lower)
        placements = [
            replace(one, type=numbers.index(one.type), pose=inner_from_box @ one.pose, box=0)
            for one in packing.placements
            if one.type in numbers
        ]
        return Packing(tuple(types), self._inner(box), tuple(placements), 0.0, "knapsack")

    def _in_boxes(self, packing: Packing, *types: BoxType) -> list[Packing]:
        """Move a packing from the inner containers into its boxes, which are of some types."""
        by_size = {self._inner(each).size: each for each in reversed(types)}
        box_from_inner = Motion.shift(self._task.search_margin.lower)
        found: dict[int, list[Placement]] = {}
        for one in packing.placements:
            moved = replace(one, pose=box_from_inner @ one.pose, box=0)
            found.setdefault(one.box, []).append(moved)
        return [
            self._task.packing(self._task.container(box), found[n])
            for n in sorted(found)
            for box in [by_size.get(packing.container_of(n).size, types[0])]
        ]

    def _candidate(self, packings: Sequence[Packing]) -> PackedParts:
        return candidate(self._task, packings, self._first.searches)

    def _offer(self, found: PackedParts) -> None:
        if found.score > self.best.score:
            self.best = found
            if self._callback is not None:
                self._callback(found)

    def _inner(self, box: BoxType, height: float | None = None) -> BoxContainer:
        """Return the space for parts inside a box, of another height if wanted."""
        margin = self._task.search_margin
        sides = (*box.size[:2], box.size[2] if height is None else height)
        x, y, z = (np.array(sides) - margin.lower - margin.upper).tolist()
        return BoxContainer((x, y, z), self._bodies(box), box.name)

    def _bodies(self, box: BoxType) -> tuple[ItemType, ...]:
        """Return what is in a box and around it, in the coordinates of the inner container.

        A container that is no box is searched as its bounding box, and what is around it there as
        bodies that do not move.
        """
        if box not in self._known_bodies:
            task, margin = self._task, self._task.search_margin
            across = task.gap if form_of(box.container) == "cylinder" else task.least_gap
            walls = box.container.walls(margin, across)
            self._known_bodies[box] = tuple(
                replace(each, vertices=each.vertices - margin.lower, known_volume=each.volume)
                for each in (*task.container(box).obstacles, *walls)
            )
        return self._known_bodies[box]

    def _fits(
        self, number: int, box: BoxType | None = None, margin: WallClearance | None = None
    ) -> bool:
        part = self._task.parts[number]
        margin = self._task.margin if margin is None else margin
        boxes = self._task.boxes if box is None else (box,)
        return any(each.limits.allow(part.mass) and fits(part, each, margin) for each in boxes)

    def _can_all_fit(self, counts: Mapping[int, int]) -> bool:
        """Return whether all parts probably fit the available boxes, filled together."""
        box, *others = self._task.boxes
        if box.count is None or others:
            return all(each.count is None for each in self._task.boxes)
        volume = plain_sum(self._task.parts[n].volume * k for n, k in counts.items())
        return box.count > 1 and volume <= _FULL * box.count * box.container.volume

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
        volume = plain_sum(self._task.parts[n].volume * k for n, k in counts.items())
        space = min(self._inner(box).volume, box.container.volume)
        needed = math.ceil(volume / (_FULL * space))
        if "apart" in self._task.settings.groups:
            needed = max(needed, len({self._task.parts[n].part.group for n in counts}))
        return self._left / max(1, min(needed, more + 1))

    @property
    def _left(self) -> float:
        """Seconds that are left; without end where passes are counted instead."""
        if self._task.settings.iterations is not None:
            return math.inf
        return self._end - clock.perf_counter()

    @property
    def _is_over(self) -> bool:
        return self._left <= 0 or self._stopped.is_set()


@contextmanager
def _stop_noted(stopped: threading.Event) -> Iterator[None]:
    """Note Ctrl-C, which the nester catches when it has a packing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: object) -> None:
        stopped.set()
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
