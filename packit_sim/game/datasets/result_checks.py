"""Checks of results: recorded returns and ends must follow from items and task."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise

from packit_sim.core.check_reports import named
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import Fact, ItemRecord, Pack, arrival_order, task_digest
from packit_sim.game.datasets.provenance import RETURN_SLACK, Played
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELLS_PER_UNIT, STEP, Triple
from packit_sim.placement import is_insertable, support_oracle
from packit_sim.rules import End, Rules

Facts = tuple[Fact, ...]
"""The shape and scale, and the value if it has one, of each item of a task, sorted."""


def facts(items: Sequence[ItemRecord]) -> Facts:
    """Return the facts of each item, sorted."""
    return tuple(sorted(item.facts for item in items))


def task_of(pack: Pack, played: Played) -> Facts | None:
    """Find the items of the task of a result.

    Parameters
    ----------
    pack : Pack
        The result.
    played : Played
        Its provenance.

    Returns
    -------
    tuple or None
        The facts of each item: those in the box and outside it if they have the task's digest, else
        those of the built-in task with this digest; None if there is none.
    """
    own = facts([*pack.items, *pack.outside])
    if task_digest(pack.library.digest, _box_cells(pack, played), own) == played.task_digest:
        return own
    return _builtin_tasks().get(played.task_digest)


def result_problems(
    pack: Pack, played: Played, volume: Callable[[str], float] | None = None
) -> Iterator[str]:
    """Yield the contradictions between a result and its items, its task or its rules.

    Parameters
    ----------
    played : Played
        Its provenance.
    volume : callable, optional
        Returns the volume of a shape by its id. Without it the return is not computed.

    Yields
    ------
    str
        A sentence for each problem.
    """
    wanted, cells = played.rules.cells, _box_cells(pack, played)
    boxes = f"{played.rules.boxes} boxes" if played.rules.boxes > 1 else "box"
    if wanted is not None and wanted != cells:
        yield f"its {boxes} has {list(pack.cells)} cells, its rules say {list(wanted)}"
    elif pack.cells[0] % (played.rules.boxes * STEP):
        yield f"its {list(pack.cells)} cells are not those of {boxes}"
        return
    allowed = played.rules.allowed_rotations
    turned = next((n for n, item in enumerate(pack.items) if item.rotation not in allowed), None)
    if turned is not None:
        yield (
            f"item {turned} has rotation {pack.items[turned].rotation}, its rules allow "
            f"{played.rules.rotations} rotations only"
        )
    if not played.rules.moves_items and not pack.is_on_grid:
        yield "it has items off the grid, but its rules have no physics"
    steps = played.improvements
    if any(a.seconds > b.seconds or a.total >= b.total for a, b in pairwise(steps)):
        yield "its improvements are not each later and better than the one before"
    if steps and not abs(steps[-1].total - played.total) <= RETURN_SLACK:
        yield f"its return is {played.total!r}, its last improvement has {steps[-1].total!r}"
    task = task_of(pack, played)
    is_known = task is not None or played.rules.cells is None  # a task in its own box
    if pack.outside and is_known and facts([*pack.items, *pack.outside]) != task:
        yield f"its items, in the box and outside, are not those of task {played.task_digest!r}"
        return
    if task is None:
        return
    if wanted is None and task_digest(pack.library.digest, cells, task) != played.task_digest:
        yield f"its box or its library is not that of task {played.task_digest!r}"
        return
    packed = facts(pack.items)
    if Counter(packed) - Counter(task):
        yield f"its box has items that task {played.task_digest!r} does not have"
        return
    if played.rules.buffer is not None:
        yield from _arrival_problems(pack, played.task_digest, task, played.rules.buffer)
    is_complete, is_recorded = len(packed) == len(task), played.end == End.COMPLETE
    if is_complete != is_recorded:
        yield f"its end is recorded as {str(played.end)!r}, with {len(packed)} of {len(task)} items"
    if played.rules.values and not pack.values:
        yield "its items have no values, but its rules count them"
        return
    if volume is None:
        return
    counted = plain_sum(item.scale * volume(item.shape) for item in pack.items if item.counted)
    density = counted / (math.prod(pack.cells) / CELLS_PER_UNIT**3)
    if played.rules.values:
        values = pack.values
        counted = plain_sum(values[item.kind] for item in pack.items if item.counted)
        total = counted / plain_sum(values[fact[:2]] for fact in task)
    else:
        total = counted / plain_sum(scale * volume(shape) for shape, scale, *_ in task)
    for name, recorded, computed in (
        ("density", pack.density, density),
        ("return", played.total, total),
    ):
        if not abs(recorded - computed) <= RETURN_SLACK:
            yield f"its {name} is recorded as {recorded!r}, but its items give {computed!r}"


def _arrival_problems(pack: Pack, digest: str, task: Facts, buffer: int) -> Iterator[str]:
    """Yield the first item of a box of the task that was not visible when it was placed."""
    arriving = [task[n] for n in arrival_order(digest, len(task))]
    for n, item in enumerate(pack.items):
        visible = arriving[:buffer]
        if item.facts not in visible:
            yield f"item {n} ({item.shape!r}) was not among the {buffer} visible items"
            return
        del arriving[visible.index(item.facts)]


def _box_cells(pack: Pack, played: Played) -> Triple:
    """Return the cells of one box of a result."""
    x, y, z = pack.cells
    return x // played.rules.boxes, y, z


def placement_problems(rules: Rules, cells: Triple, placed: Sequence[PlacedItem]) -> Iterator[str]:
    """Yield the items that are where the rules don't allow it, given those before them.

    Parameters
    ----------
    cells : tuple of int
        The cells of all boxes together.
    """
    if rules.kinematic:
        yield from insertion_problems(placed)
    if cells[0] % rules.boxes:
        return  # reported by result_problems
    width = cells[0] // rules.boxes
    for n, candidate in enumerate(placed):
        if candidate.start[0] // width != (candidate.stop[0] - 1) // width:
            yield f"{named(n, candidate.item.shape.id)} is in two of its {rules.boxes} boxes"
        if rules.support and (found := support_oracle(placed[:n], candidate)) < rules.support:
            yield (
                f"{named(n, candidate.item.shape.id)} has a support of {found:.3g}, its rules want "
                f"{rules.support:g}"
            )


def insertion_problems(placed: Sequence[PlacedItem]) -> Iterator[str]:
    """Yield the items that can't come straight down from the open top, given those before them."""
    for n, candidate in enumerate(placed):
        if not is_insertable(placed[:n], candidate):
            yield (
                f"item {n} ({candidate.item.shape.id!r}) can't be inserted from above, "
                "as its record demands"
            )


@cache
def _builtin_tasks() -> dict[str, Facts]:
    """Return the items of all tasks of the built-in datasets, by digest."""
    from packit_sim.game.datasets.builtin import builtin_datasets
    from packit_sim.game.datasets.pack_files import dataset_files, read_packs

    packs = [
        pack
        for name in builtin_datasets()
        for file in dataset_files(name)
        for pack in read_packs(file)
    ]
    return {
        task_digest(pack.library.digest, pack.cells, own): own
        for pack in packs
        for own in [facts([*pack.items, *pack.outside])]
    }
