"""Candidates of the search: packings that meet all constraints, since parts were left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from packit_sim.parts.filling.balance import centred, over_balance
from packit_sim.parts.filling.groups import surplus
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.handling.broken import broken_constraints
from packit_sim.parts.handling.filtering import filter_packing
from packit_sim.parts.handling.order import packing_order
from packit_sim.parts.handling.supports import lowered
from packit_sim.parts.nesting.limits import ItemLimits
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.packing import Packing


def candidate(task: PackTask, packings: Sequence[Packing], searches: int = 1) -> PackedParts:
    """Leave parts out of packings until they meet the constraints of a task.

    Parameters
    ----------
    packings : sequence of Packing
        The packing of each box.
    searches : int
        How many searches led to them.

    Returns
    -------
    PackedParts
        The boxes that still have parts.
    """
    rejected: list[tuple[int, str]] = []
    while True:
        kept = _within_constraints(task, packings, rejected)
        packings = _in_groups(task, kept, rejected)
        if packings == kept:
            return PackedParts(task, tuple(packings), tuple(rejected), searches)


def _within_constraints(
    task: PackTask, packings: Sequence[Packing], rejected: list[tuple[int, str]]
) -> list[Packing]:
    """Leave parts out of each packing until it keeps limits and constraints; note them."""
    kept: list[Packing] = []
    for packing in map(partial(_balanced, task), packings):
        while reasons := _reasons(task, packing):
            rejected += [(packing.placements[n].type, reasons[n]) for n in sorted(reasons)]
            left = [one for n, one in enumerate(packing.placements) if n not in reasons]
            packing = replace(packing, placements=tuple(left))
        if packing.placements:
            kept.append(packing)
    return kept


def _balanced(task: PackTask, packing: Packing) -> Packing:
    """Move the parts of a box with nothing else in it together, if it is off balance."""
    container = packing.container
    is_empty = isinstance(container, BoxContainer) and not container.obstacles
    return centred(task, packing) if is_empty and over_balance(task, packing) else packing


def _in_groups(
    task: PackTask, packings: list[Packing], rejected: list[tuple[int, str]]
) -> list[Packing]:
    """Leave out the parts of groups that break a rule; note them."""
    rules = task.settings.groups
    if not rules:
        return packings
    names = [each.part.name for each in task.parts]
    weights = dict(zip(names, task.weights, strict=True))
    groups = {each.part.name: each.part.group for each in task.parts}
    asked = {each.part.name: each.part.count for each in task.parts}
    boxes = [Counter(names[one.type] for one in each.placements) for each in packings]
    found = list(packings)
    for number, group, reason in surplus(rules, groups, asked, boxes, weights.__getitem__):
        goes = set(task.groups[group])
        placements = found[number].placements
        rejected += [(one.type, reason) for one in placements if one.type in goes]
        stays = tuple(one for one in placements if one.type not in goes)
        found[number] = replace(found[number], placements=stays)
    return [each for each in found if each.placements]


def _reasons(task: PackTask, packing: Packing) -> Mapping[int, str]:
    """Return the reason for each placement to leave out, by the first constraint that is broken."""
    if faults := task.limits(packing).faults(masses := task.masses_in(packing)):
        amounts, most = zip(*task.limits(packing).sums(masses), strict=True)
        limits = ItemLimits(np.array(amounts), np.array(most))
        values = np.array([task.weights[one.type] for one in packing.placements])
        excess = limits.excess(np.ones(len(masses), bool), values)
        return {int(n): f"the box {faults[0]}" for n in excess}
    if off := over_balance(task, packing):
        return off
    if not task.constraints.is_empty:
        first = len(task.fixed)
        filtered = filter_packing(task.with_fixed(packing), task.constraints)
        if filtered.left_out:
            return {one.part - first: one.reason for one in filtered.left_out}
    for custom in task.settings.constraints:
        if reasons := custom.left_out(packing):
            return reasons
    return {}


def in_order(packed: PackedParts) -> PackedParts:
    """Put the parts of each box into an order of packing, if there are constraints.

    Where gravity matters, parts come straight down to where they rest, if they may touch.

    Returns
    -------
    PackedParts
        The same parts in the same boxes.
    """
    task, constraints = packed.task, packed.task.constraints
    if constraints.is_empty:
        return packed
    first = len(task.fixed)
    packings = []
    for packing, whole in zip(packed.packings, packed.contents, strict=True):
        may_touch = task.largest_gap == 0 and task.walls.floor == 0
        if constraints.stable is not None and may_touch:
            resting = lowered(whole, constraints.fixed)
            own = replace(packing, placements=resting.placements[first:])
            others = replace(constraints, stable=None)
            if not (own.problems() or broken_constraints(resting, others)):
                whole = resting
        order = packing_order(whole, constraints)[first:]
        placements = tuple(whole.placements[n] for n in order)
        packings.append(replace(packing, placements=placements))
    return replace(packed, packings=tuple(packings))
