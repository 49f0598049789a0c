"""A search that continues from the packing on the page, in which some parts are locked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.core.errors import ArgumentError, about
from packit_sim.parts.filling.candidates import candidate, in_order
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.search import PackingSearch
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.parts.packings.turning import ANY_TURN
from packit_sim.parts.reading.limits import Limits
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.results.resuming import items_of, resumed

Better = Callable[[PackedParts, tuple[int, ...]], object]
"""Called with each better packing, and the numbers of its locked parts."""


def repacked(
    task: PackTask,
    earlier: PackedParts | None,
    locked: Collection[int],
    end: float,
    better: Better,
) -> tuple[PackedParts, tuple[int, ...]]:
    """Pack the parts of a task, from the packing on the page on.

    Parameters
    ----------
    earlier : PackedParts, optional
        That packing, which may be of another task: its parts stay as far as the new task allows.
    locked : collection of int
        The numbers of its parts, in its one box, that stay where they are.
    end : float
        When the search ends, by `time.perf_counter`.
    better : callable
        Called with each better packing, and the numbers of its locked parts.

    Returns
    -------
    packed : PackedParts
        The best packing; never worse than the earlier one of the same task.
    locked : tuple of int
        The numbers of its locked parts.

    Raises
    ------
    ArgumentError
        If a locked part can't stay.
    NestingError
        If no valid packing was found.
    """
    repacking = _Repacking(task, _kept(task, earlier, locked))
    first = PackedParts(task)
    if earlier is not None:
        items = items_of(earlier, task.unit)
        names = [packing.container.name for packing in earlier.packings]
        first, _ = resumed(task, items, names, earlier.searches + 1)
        if not repacking.has_all(first):  # others, worth more, are in conflict with them by now
            first = replace(repacking.alone, searches=first.searches)
    return repacking.run(first, end, better)


def _kept(
    task: PackTask, earlier: PackedParts | None, locked: Collection[int]
) -> tuple[Placement, ...]:
    """Return the locked parts as placements of a task."""
    if not locked:
        return ()
    if task.settings.groups:
        with about("groups"):
            raise ArgumentError("parts can't be locked together with a rule for groups")
    if earlier is None or len(earlier.packings) != 1 or len(task.boxes) != 1:
        raise ArgumentError("parts can only be locked in a single box")
    items = items_of(earlier, task.unit)
    chosen = [items[n] for n in sorted(locked)]
    packed, faults = resumed(task, chosen, [earlier.packings[0].container.name], 1)
    if faults:
        name, fault = faults[0]
        raise ArgumentError(f"{name} is locked, but {fault}: unlock it, or change the order")
    return packed.packings[0].placements


@dataclass(frozen=True, eq=False)
class _Repacking:
    """A search for the best packing of a task in which some parts have their places.

    Attributes
    ----------
    locked : tuple of Placement
        The parts that stay where they are, in the first box.
    """

    task: PackTask
    locked: tuple[Placement, ...]

    def run(
        self, first: PackedParts, end: float, better: Better
    ) -> tuple[PackedParts, tuple[int, ...]]:
        """Search from a packing on, and return the best one and the numbers of locked parts."""
        best = first
        if first.packings:
            better(first, self._numbers(first))

        def offer(found: PackedParts) -> None:
            nonlocal best
            whole = self._joined(found) if self.locked else found
            if whole.score > best.score and self.has_all(whole):
                best = whole
                better(best, self._numbers(best))

        rest = self._rest() if self.locked else self.task
        if rest is not None:
            start = self._without_locked(first, rest) if self.locked else first
            offer(PackingSearch(start, end, first.searches - 1, offer).run())
        ordered = in_order(best)
        if self.has_all(ordered):  # gravity may have moved them
            best = ordered
        return best, self._numbers(best)

    @property
    def alone(self) -> PackedParts:
        """The packing of the locked parts alone."""
        return PackedParts(self.task, (_packing(self.task, self.locked),) if self.locked else ())

    def has_all(self, packed: PackedParts) -> bool:
        """Return whether a packing has all locked parts where they were."""
        return len(self._numbers(packed)) == len(self.locked)

    def _numbers(self, packed: PackedParts) -> tuple[int, ...]:
        if not packed.packings:
            return ()
        known = {_key(one) for one in self.locked}
        placements = packed.packings[0].placements
        return tuple(n for n, one in enumerate(placements) if _key(one) in known)

    def _rest(self) -> PackTask | None:
        """Return the task of the other parts, around the locked ones; None if there is nothing."""
        task, counts = self.task, Counter(one.type for one in self.locked)
        parts = []
        for n, each in enumerate(task.parts):
            if (count := each.part.count - counts[n]) > 0:
                part = replace(each.part, count=count)
                parts.append(replace(each, part=part, item_type=each.item_type.changed(count)))
        limits = self._limits_left()
        if not parts or limits is None:
            return None
        has_values = any(each.part.value is not None for each in parts)
        return replace(
            task,
            parts=tuple(parts),
            boxes=(replace(task.boxes[0], limits=limits),),
            objective="count" if task.objective == "value" and not has_values else task.objective,
            fixed=(*task.fixed, *(_fixed(task.parts[one.type], one) for one in self.locked)),
        )

    def _limits_left(self) -> Limits | None:
        """Return what the box may hold next to the locked parts; None if that is nothing."""
        limits = self.task.boxes[0].limits
        mass, count = limits.max_mass, limits.max_parts
        if mass is not None:
            mass -= sum(self.task.parts[one.type].mass or 0.0 for one in self.locked)
        if count is not None:
            count -= len(self.locked)
        is_full = (mass is not None and mass <= 0) or (count is not None and count <= 0)
        return None if is_full else Limits(mass, count)

    def _joined(self, rest: PackedParts) -> PackedParts:
        """Return a packing of the other parts together with the locked ones."""
        numbers = {each.part.name: n for n, each in enumerate(self.task.parts)}
        own = [numbers[each.part.name] for each in rest.task.parts]
        others = [replace(one, type=own[one.type]) for _, one in rest.placements]
        whole = candidate(self.task, [_packing(self.task, (*self.locked, *others))], rest.searches)
        rejected = [(own[n], reason) for n, reason in rest.rejected]
        return replace(whole, rejected=(*whole.rejected, *rejected))

    def _without_locked(self, packed: PackedParts, rest: PackTask) -> PackedParts:
        """Return a packing of the whole task as one of the other parts."""
        numbers = {each.part.name: n for n, each in enumerate(rest.parts)}
        locked = set(self._numbers(packed))
        others = tuple(
            replace(one, type=numbers[packed.part(one).part.name])
            for n, (_, one) in enumerate(packed.placements)
            if n not in locked
        )
        packings = (_packing(rest, others),) if others else ()
        return PackedParts(rest, packings, searches=packed.searches)


def _key(one: Placement) -> tuple[int, bytes]:
    return one.type, np.round(one.matrix, 9).tobytes()


def _packing(task: PackTask, placements: tuple[Placement, ...]) -> Packing:
    """Return a packing in the only box of a task."""
    return Packing(task.types, task.container(task.boxes[0]), placements, task.gap, "knapsack")


def _fixed(part: PreparedPart, one: Placement) -> PreparedPart:
    """Return a part at its place as one that is fixed, with the same collision mesh."""
    kind = part.item_type
    vertices = one.apply(kind.vertices)
    posed = ItemType(kind.name, vertices, kind.faces, rotations=FIXED, known_volume=kind.volume)
    own = replace(part.part, count=1, rotations=FIXED, turning=ANY_TURN, as_many_as_fit=False)
    return replace(part, part=own, item_type=posed)
