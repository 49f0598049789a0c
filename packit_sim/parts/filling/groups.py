"""Groups of parts: parts that share a box, groups that never do, and kits, which are whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeVar, get_args

from packit_sim.core.choices import GroupRule

GROUP_RULES: tuple[GroupRule, ...] = get_args(GroupRule)
"""All parts of a group are in one box; no box has parts of two groups; all parts of a group are in
one box, or none is packed."""

_T = TypeVar("_T", int, float)

Contents = Sequence[Counter[str]]
"""How many of each part are in each box, by their names."""


def group_faults(
    rules: Collection[str],
    groups: Mapping[str, str | None],
    asked: Mapping[str, int],
    boxes: Contents,
) -> list[str]:
    """Return how boxes break the rules of groups.

    Parameters
    ----------
    rules : collection of str
        Some of `GROUP_RULES`.
    groups : mapping of str to str
        The group of each part, by its name; None if it has none.
    asked : mapping of str to int
        How many of each part were asked for.
    boxes : sequence of Counter
        How many of each part are in each box.

    Returns
    -------
    list of str
        A sentence for each fault.
    """
    found = []
    places = _places(groups, boxes)
    if "apart" in rules:
        for number in range(len(boxes)):
            inside = [group for group, numbers in places.items() if number in numbers]
            if len(inside) > 1:
                first, second = sorted(inside)[:2]
                found.append(f"box {number + 1} has parts of the groups {first!r} and {second!r}")
    if {"together", "kit"} & set(rules):
        for group, numbers in places.items():
            if len(numbers) > 1:
                one, other = sorted(numbers)[:2]
                found.append(f"the group {group!r} is in the boxes {one + 1} and {other + 1}")
    if "kit" in rules:
        packed = _totals(groups, sum(boxes, Counter()))
        for group, most in _totals(groups, asked).items():
            if 0 < (count := packed.get(group, 0)) < most:
                found.append(f"{count} of {most} parts of the kit {group!r} are packed")
    return found


def surplus(
    rules: Collection[str],
    groups: Mapping[str, str | None],
    asked: Mapping[str, int],
    boxes: Contents,
    weight: Callable[[str], float],
) -> list[tuple[int, str, str]]:
    """Choose what to take out of boxes until they keep the rules, which are as in `group_faults`.

    Parameters
    ----------
    weight : callable
        The worth of one of a part, by its name: the more valuable groups stay.

    Returns
    -------
    list of (int, str, str)
        Boxes and groups to take out of them, with the reasons.
    """
    found: dict[tuple[int, str], str] = {}
    worth = [_totals(groups, {part: weight(part) * k for part, k in box.items()}) for box in boxes]
    packed, wanted = [_totals(groups, box) for box in boxes], _totals(groups, asked)
    places = _places(groups, boxes)
    if {"together", "kit"} & set(rules):
        for group, numbers in places.items():
            best = max(sorted(numbers), key=lambda number: worth[number][group])
            for number in numbers - {best}:
                found[number, group] = "its group is in another box"
            if "kit" in rules and packed[best][group] < wanted[group]:
                found[best, group] = "the whole kit does not fit"
    if "apart" in rules:
        for number in range(len(boxes)):
            inside = [group for group in sorted(worth[number]) if (number, group) not in found]
            best_group = max(inside, key=worth[number].__getitem__, default=None)
            for group in inside:
                if group != best_group:
                    found[number, group] = "its box has parts of another group"
    return [(number, group, reason) for (number, group), reason in found.items()]


def _places(groups: Mapping[str, str | None], boxes: Contents) -> dict[str, set[int]]:
    """Return the numbers of the boxes in which each group has parts."""
    found: dict[str, set[int]] = {}
    for number, inside in enumerate(boxes):
        for part in inside:
            group = groups[part]
            if group is not None:
                found.setdefault(group, set()).add(number)
    return found


def _totals(groups: Mapping[str, str | None], amounts: Mapping[str, _T]) -> dict[str, _T]:
    """Return the sum of the amounts of each group's parts."""
    found: dict[str, _T] = {}
    for part, amount in amounts.items():
        group = groups.get(part)
        if group is not None:
            found[group] = found[group] + amount if group in found else amount
    return found
