"""Bounding boxes, packed by the bin packer packvium (PyPI, MIT).

The chosen profile and objective did best on train packs: one pass, the most value placed. The
packer chooses order, rotations and places; an item that does not fit is left outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.peers.posed import AXIS_ORDERS, Posed
from packit_sim.game.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL

MILLIMETRES = 10**7
"""A box unit in the packer's whole millimetres, to which lengths are rounded up."""

VALUES = 1e12
"""Value of a volume of 1, since values are whole numbers."""

SIDES = "LWH"


@dataclass(frozen=True)
class Cuboids:
    """A packer of the items' bounding boxes."""

    @property
    def name(self) -> str:
        return "cuboids (packvium)"

    def pack(self, task: Task) -> list[Posed]:
        """Place as much volume as possible."""
        from packvium import Container, Dimensions, Item, Packer, PackingConfig
        from packvium.effort import EffortBudget

        def rounded_up(lengths: list[float]) -> Dimensions:
            return Dimensions.mm(*(math.ceil(length * MILLIMETRES) for length in lengths))

        config = PackingConfig.fast(
            objective="maximum_value",
            effort_budget=EffortBudget(max_candidates_evaluated=200_000),
            time_limit_ms=60_000,  # must never be reached, or two runs could differ
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
