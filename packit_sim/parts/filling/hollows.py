"""Parts that lie in the hollows of open ones: legitimate for a box, a mistake for a solid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from packit_sim.core.plain_text import listed
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.winding import winding_numbers
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.prepared import PreparedPart

SAMPLES = 32
"""Points of a part's surface that may be inside an open one: middles of its triangles."""

_SAME = 1e-6
"""Share of a part's longest side up to which poses are the same."""

_DRAWN_IN = 1 - 1e-3
"""Factor of their distances from the part's middle: parts that touch are not inside."""


def hollow_notes(packings: Sequence[Packing], parts: Sequence[PreparedPart]) -> list[str]:
    """Return a warning for each open part in whose hollow others were placed.

    Parameters
    ----------
    packings : sequence of Packing
        The packing of each box.
    parts : sequence of PreparedPart
        The part of each of their types.

    Returns
    -------
    list of str
        The warnings. A part is in a hollow if the open surface winds around a point of it, which is
        in its convex hull, by more than half, like a closed one does around all points inside.
    """
    inside: dict[int, Counter[int]] = {}
    hollows: dict[int, _Hollow] = {}
    for packing in packings:
        bounds = np.array([_bounds(packing, one) for one in packing.placements])
        for n, one in enumerate(packing.placements):
            if parts[one.type].is_closed:
                continue
            near = (bounds[n, 0] < bounds[:, 1]) & (bounds[:, 0] < bounds[n, 1])
            near[n] = False
            others = [packing.placements[m] for m in np.flatnonzero(near.all(axis=1))]
            hollow = hollows.setdefault(one.type, _Hollow(packing.types[one.type]))
            found = [
                each.type
                for each in others
                if hollow.has(packing.types[each.type], each.pose.seen_from(one.pose))
            ]
            inside.setdefault(one.type, Counter()).update(found)
    return [
        f"warning: {parts[n].part.name} is open, and other parts are inside its hollow: "
        + listed(f"{parts[m].part.name} ({count})" for m, count in found.items())
        for n, found in inside.items()
        if found
    ]


def _bounds(packing: Packing, one: Placement) -> tuple[Floats, Floats]:
    vertices = packing.vertices(one)
    return vertices.min(axis=0), vertices.max(axis=0)


class _Hollow:
    """The hollow of an open part, and the parts inside it."""

    def __init__(self, around: ItemType) -> None:
        self._triangles = around.vertices[around.faces]
        self._hull = ConvexHull(around.vertices).equations
        self._known: dict[tuple[str, bytes], bool] = {}  # lattices repeat the same poses

    def has(self, own: ItemType, pose: Motion) -> bool:
        """Return whether a point of another part is inside, at its pose in the open one's frame."""
        some = np.linspace(0, len(own.faces) - 1, min(SAMPLES, len(own.faces))).astype(int)
        points = own.vertices[own.faces[some]].mean(axis=1)
        there = pose.apply(own.middle + (points - own.middle) * _DRAWN_IN)
        key = own.digest, (there / (_SAME * own.extents.max())).round().tobytes()
        if key not in self._known:
            in_hull = (there @ self._hull[:, :3].T + self._hull[:, 3] < 0).all(axis=1)
            found = winding_numbers(self._triangles, there[in_hull])
            self._known[key] = bool((np.abs(found) > 0.5).any())
        return self._known[key]
