"""Which shapes are for training, testing and validation: the paper's rule, kept fair to objects."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np

from packit_sim.core.errors import ArgumentError

Split = Literal["train", "test", "validation"]

SPLITS: tuple[str, ...] = get_args(Split)
"""The three splits of a library (paper, section 3)."""

MOST = 100
"""Shapes of a category in a split, at most (paper, section 3)."""


def divide(
    categories: Mapping[str, str], groups: Mapping[str, str], seed: int = 0, most: int = MOST
) -> dict[str, tuple[str, ...]]:
    """Sorted ids of the shapes in each split.

    categories, groups: the category and the group of each id; shapes of one group are the same
    object and go to the same split. Of each category every split gets `most` shapes, or, where it
    has fewer than three times as many, an equal share; what is left over goes where there are
    fewest in all. The seed decides which, for each category by itself. Raises ValueError where
    `most` is less than 1.
    """
    if most < 1:
        raise ArgumentError(
            f"most {most!r} is not possible: at least 1 shape of a category in a split"
        )
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
            if inside[split] and inside[split] + size > most:
                continue
            split_of[group] = split
            inside[split] += size
            totals[split] += size
    return {
        split: tuple(id for id in sorted(categories) if split_of.get(groups[id]) == split)
        for split in SPLITS
    }
