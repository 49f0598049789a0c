"""The validity of a packing by its meshes, with the same rule for all peers.

It is the rule for packings of other tools (see `nesting.validity`): each mesh is inside the box,
crosses no other, and lies in no other, within the contact tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations

from benchmarks.peers.posed import Posed
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.shapes import Shape
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.validity import outside, pair_problems


@dataclass(frozen=True)
class QualityScores:
    """The conflicts in a packing, by the numbers of its items.

    Attributes
    ----------
    outside : tuple[int, ...]
        Items that reach beyond a wall.
    pairs : tuple[tuple[int, int], ...]
        Pairs of items in conflict.
    kept : tuple[int, ...]
        The valid items: in the order of placing, each item is removed that is outside or in
        conflict with an earlier valid one.
    """

    outside: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    kept: tuple[int, ...]

    @classmethod
    def of(cls, packing: Sequence[Posed], cells: Triple) -> QualityScores:
        """Check the items in a box of the given number of cells."""
        x, y, z = (side * CELL for side in cells)
        container = BoxContainer((x, y, z))
        items = [
            CheckedItem("", _item_type(posed.item.shape), Placement.from_matrix(0, posed.pose), 1.0)
            for posed in packing
        ]
        beyond = [n for n, item in enumerate(items) if any(outside(item, container))]
        pairs = [
            (n, m)
            for (n, one), (m, other) in combinations(enumerate(items), 2)
            if any(pair_problems(one, other))
        ]
        kept: list[int] = []
        for m in range(len(items)):
            if m not in beyond and not any((n, m) in pairs for n in kept):
                kept.append(m)
        return cls(tuple(beyond), tuple(pairs), tuple(kept))

    @property
    def valid(self) -> bool:
        """Whether no item is outside or in conflict."""
        return not (self.outside or self.pairs)


@cache
def _item_type(shape: Shape) -> ItemType:
    return ItemType(shape.id, shape.mesh.vertices, shape.mesh.faces)
