"""Parts that lie in the hollows of open ones: legitimate for a box, a mistake for a solid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from packit_sim.core.plain_text import listed
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.winding import winding_numbers
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.prepared import PreparedPart

SAMPLES = 32
"""Points of a part's surface that may be inside an open one: middles of its triangles."""

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
        The warnings. A part is in a hollow if the open surface winds around a point of it by more
        than half, like a closed one does around all points inside.
    """
    inside: dict[int, Counter[int]] = {}
    for packing in packings:
        bounds = np.array([_bounds(packing, one) for one in packing.placements])
        for n, one in enumerate(packing.placements):
            if parts[one.type].is_closed:
                continue
            near = (bounds[n, 0] < bounds[:, 1]) & (bounds[:, 0] < bounds[n, 1])
            near[n] = False
            others = [packing.placements[m] for m in np.flatnonzero(near.all(axis=1))]
            found = [each.type for each in others if _is_inside(packing, each, one)]
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


def _is_inside(packing: Packing, own: Placement, around: Placement) -> bool:
    mesh, surface = packing.types[own.type], packing.types[around.type]
    some = np.linspace(0, len(mesh.faces) - 1, min(SAMPLES, len(mesh.faces))).astype(int)
    points = mesh.vertices[mesh.faces[some]].mean(axis=1)
    points = mesh.middle + (points - mesh.middle) * _DRAWN_IN
    there = own.pose.seen_from(around.pose).apply(points)
    found = winding_numbers(surface.vertices[surface.faces], there)
    return bool((np.abs(found) > 0.5).any())
