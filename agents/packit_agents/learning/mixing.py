"""Tasks mixed from others, so that a network does not memorise the tasks of a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.game.datasets.packs import ItemRecord, Pack, Task
from packit_sim.libraries.library import ShapeLibrary


@dataclass(frozen=True)
class Mixture:
    """A source of tasks that hold a random half of the items of two tasks.

    Items are as frequent and as large as in the original tasks. Whether all of them fit into the
    box together is not known.

    Attributes
    ----------
    tasks : sequence of Task
        The original tasks, all with the same box.
    share : float
        Share of the drawn tasks that are mixed; the rest are original.
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
        items = [item for item, keep in zip(both, taken, strict=True) if keep]
        outside = tuple(ItemRecord(item.shape.id, item.scale) for item in items or both[:1])
        return Pack(first.pack.library, first.cells, (), 0.0, outside=outside).task(self.library)
