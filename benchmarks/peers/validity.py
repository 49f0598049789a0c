"""The validity of a packing by its meshes, with the same rule for all peers.

It is the rule for packings of other tools (see `packings.verify_packing`): each mesh is inside the
box, crosses no other, and lies in no closed shell of another, within the contact tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from benchmarks.peers.posed import Posed
from packit_sim.datasets.packings import _Loaded, _MeshInBox, _pair_problems, _wall_problems
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.shapes import Shape


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
        bodies = [_MeshInBox("", _loaded(posed.item.shape), posed.pose, 1.0) for posed in packing]
        extents = np.array(cells) * CELL
        outside = [n for n, body in enumerate(bodies) if any(_wall_problems(body, extents, 1.0))]
        pairs = [
            (n, m)
            for (n, one), (m, other) in combinations(enumerate(bodies), 2)
            if (np.maximum(one.low, other.low) < np.minimum(one.high, other.high)).all()
            and any(_pair_problems(one, other))
        ]
        kept: list[int] = []
        for m in range(len(bodies)):
            if m not in outside and not any((n, m) in pairs for n in kept):
                kept.append(m)
        return cls(tuple(outside), tuple(pairs), tuple(kept))

    @property
    def valid(self) -> bool:
        """Whether no item is outside or in conflict."""
        return not (self.outside or self.pairs)


@cache
def _loaded(shape: Shape) -> _Loaded:
    return _Loaded(shape.mesh, shape.id)
