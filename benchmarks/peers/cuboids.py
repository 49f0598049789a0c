"""Bounding boxes, packed by a bin packer of the package index: packvium (MIT).

Of its profiles and objectives these did best on train packs: one pass, the most value placed. It
chooses order, rotations and places; an item that does not fit is left outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.peers.posed import AXIS_ORDERS, Posed
from packit_sim.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL

MILLIMETRES = 10**7
"""A box unit as the packer sees it, which counts in whole ones; lengths are rounded up to them."""

VALUES = 1e12
"""Of a box unit cubed: it takes whole numbers."""

SIDES = "LWH"


@dataclass(frozen=True)
class Cuboids:
    """The items' bounding boxes as cuboids."""

    @property
    def name(self) -> str:
        return "cuboids (packvium)"

    def pack(self, task: Task) -> list[Posed]:
        """Places as much volume as it can."""
        from packvium import Container, Dimensions, Item, Packer, PackingConfig
        from packvium.effort import EffortBudget

        def rounded_up(lengths: list[float]) -> Dimensions:
            return Dimensions.mm(*(math.ceil(length * MILLIMETRES) for length in lengths))

        config = PackingConfig.fast(
            objective="maximum_value",
            effort_budget=EffortBudget(max_candidates_evaluated=200_000),
            time_limit_ms=60_000,  # never reached: else two runs could differ
        )
        items = [
            Item.create(
                str(n), rounded_up(item.extents.tolist()), value=round(item.volume * VALUES)
            )
            for n, item in enumerate(task.items)
        ]
        box = Container.create("box", rounded_up([n * CELL for n in task.cells]), quantity=1)
        unit = rounded_up([1.0, 1.0, 1.0]).length.ticks
        packed = []
        for container in Packer(config).pack(items=items, containers=[box]).containers:
            for placement in container.placements:
                size, at = placement.dimensions, placement.position
                low = np.array((at.x, at.y, at.z), dtype=float)
                extents = np.array((size.length.ticks, size.width.ticks, size.height.ticks))
                axes = [SIDES.index(side) for side in placement.rotation.value]
                turn = next(n for n in AXIS_ORDERS if rotations.AXES[n].tolist() == axes)
                item = task.items[int(placement.instance.item.id)].turned(turn)
                packed.append(Posed(item, (low + extents / 2) / unit))
        return packed
