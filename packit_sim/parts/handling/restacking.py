"""Restacking of strips: parts that interlock are placed again, on top of the others."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.filtering import filter_packing
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.packing import Packing


def separated(packing: Packing) -> Packing:
    """Place parts of a strip again, on top of the others, until all can be moved out.

    Parameters
    ----------
    packing : Packing
        A valid packing of a strip.

    Returns
    -------
    Packing
        The packing; the same if all its parts are separable (see `separability`).

    Raises
    ------
    ArgumentError
        If it is not of a strip.
    """
    container = packing.container
    if not container.is_strip:
        raise ArgumentError("only a strip has space on top: choose filter_packing for a box")
    filtered = filter_packing(packing, Constraints(separable=True))
    tolerance = checked_items.tolerance(container.longest, math.inf)
    own = (each.clearance or 0.0 for each in (*packing.types, *container.obstacles))
    largest = max(packing.clearance, packing.clearance_z or 0.0, *own)
    gap = largest and largest + tolerance
    boxes = [_bounds(packing.vertices(one)) for one in filtered.packing.placements]
    boxes += [_bounds(each.vertices) for each in container.obstacles]
    placements = list(packing.placements)
    for each in filtered.left_out:
        low, high = _bounds(packing.vertices(placements[each.part]))
        below = [b[2] for a, b in boxes if (a < high + gap)[:2].all() and (b > low - gap)[:2].all()]
        lift = np.array((0.0, 0.0, max(below, default=-gap) + gap - low[2]))
        pose = Motion.shift(lift) @ placements[each.part].pose
        placements[each.part] = replace(placements[each.part], pose=pose)
        boxes.append((low + lift, high + lift))
    return replace(packing, placements=tuple(placements)) if filtered.left_out else packing


def _bounds(vertices: Floats) -> tuple[Floats, Floats]:
    return vertices.min(axis=0), vertices.max(axis=0)
