"""Division of shapes into train, test and validation by the paper's rule, object by object."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping

import numpy as np

from packit_sim.core.checks import Range, check_range
from packit_sim.core.choices import SPLITS

MAX_SHAPES = 100
"""Maximum number of shapes of a category in a split (paper, section 3)."""


def divide(
    categories: Mapping[str, str],
    groups: Mapping[str, str],
    seed: int = 0,
    max_shapes: int = MAX_SHAPES,
) -> dict[str, tuple[str, ...]]:
    """Divide shapes into splits.

    Parameters
    ----------
    categories : mapping of str to str
        The category of each id.
    groups : mapping of str to str
        The group of each id; shapes of one group are the same object and go to the same split.
    seed : int, default: 0
        The seed of the choice, which is independent for each category.
    max_shapes : int
        The maximum number of shapes of a category in a split.

    Returns
    -------
    dict of str to tuple of str
        The sorted ids of each split.

    Raises
    ------
    ArgumentError
        If `max_shapes` is less than 1.

    Notes
    -----
    Every split gets `max_shapes` shapes of each category, or an equal share of a category with
    fewer than three times as many. A remainder goes to the splits with the fewest shapes in total.
    """
    check_range("max_shapes", max_shapes, Range(1), "shape of a category in a split")
    members = defaultdict(list)
    for id in sorted(categories):
        members[groups[id]].append(id)
    by_category = defaultdict(list)
    for group, ids in sorted(members.items()):
        counts = Counter(categories[id] for id in ids)
        by_category[min(counts, key=lambda name: (-counts[name], name))].append(group)
    split_of: dict[str, str] = {}
    totals = dict.fromkeys(SPLITS, 0)
    for category, names in sorted(by_category.items()):
        rng = np.random.default_rng([seed, *category.encode()])
        order = [names[n] for n in rng.permutation(len(names))]
        inside = dict.fromkeys(SPLITS, 0)
        for group in sorted(order, key=lambda name: -len(members[name])):
            split = min(SPLITS, key=lambda name: (inside[name], totals[name]))
            size = len(members[group])
            if inside[split] and inside[split] + size > max_shapes:
                continue
            split_of[group] = split
            inside[split] += size
            totals[split] += size
    return {
        split: tuple(id for id in sorted(categories) if split_of.get(groups[id]) == split)
        for split in SPLITS
    }
