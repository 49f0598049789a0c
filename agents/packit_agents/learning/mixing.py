"""Tasks mixed of others, so that a network does not learn a dataset's tasks by heart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.datasets.packs import ItemRecord, Pack, Task
from packit_sim.libraries.library import ShapeLibrary


@dataclass(frozen=True)
class Mixture:
    """Makes tasks of the items of two others, each taken or left by chance: half of them in all.

    Items come as often as in the tasks, and are as large; whether all go into the box together is
    not known. tasks: of one box. share: of the tasks that are mixed; the rest are the tasks' own.
    """

    tasks: Sequence[Task]
    library: ShapeLibrary
    share: float

    def __call__(self, rng: np.random.Generator) -> Task:
        first, second = (self.tasks[int(n)] for n in rng.integers(len(self.tasks), size=2))
        if rng.random() >= self.share:
            return first
        both = first.items + second.items
        taken = rng.random(len(both)) < 0.5
        items = [item for item, is_taken in zip(both, taken, strict=True) if is_taken]
        outside = tuple(ItemRecord(item.shape.id, item.scale) for item in items or both[:1])
        return Pack(first.pack.library, first.cells, (), 0.0, outside=outside).task(self.library)
