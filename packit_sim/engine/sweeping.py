"""The exact swept test: how far an item can go straight on before its mesh meets another's.

It is of collision meshes, triangle by triangle, and of the whole of the motion, not of steps of it.
Where two triangles overlap seen along the way, the distance between them is linear, so that it is
least at a corner of the overlap: a corner of either triangle, or where edges cross.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.sweeping_kernels import least_of, least_rise
from packit_sim.geometry.deviation import Surface
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.shapes import Item

SURFACES_BUDGET = 512 * 2**20
"""Bytes in the process's cache of items' collision meshes as trees of boxes."""

Axis = Literal[0, 1, 2]


@bounded_cache(
    "surfaces",
    SURFACES_BUDGET,
    "bytes",
    size=lambda surface: surface.triangles.nbytes + surface.boxes.nbytes,
    key=lambda item, axis=2: (item.key, axis),
)
def surface(item: Item, axis: Axis = 2) -> Surface:
    """An item's collision mesh about its centre: drawn in by half the contact tolerance a side.

    axis: which of x, y and z comes last, in the cyclic order, so that it is "up" to what follows.
    """
    if axis != 2:
        upright = surface(item)
        turned = cyclic(axis)
        return Surface(
            np.ascontiguousarray(upright.triangles[..., turned]),
            np.ascontiguousarray(upright.boxes[..., turned]),
            upright.starts,
        )
    drawn_in = np.maximum(item.extents - CONTACT_TOLERANCE, 0) / item.extents
    mesh = item.mesh
    return Surface.of(trimesh.Trimesh(mesh.vertices * drawn_in, mesh.faces, process=False))


def cyclic(axis: Axis) -> list[int]:
    """The axes in cyclic order, with this one last."""
    return [(axis + 1) % 3, (axis + 2) % 3, axis]


def room(
    item: Item, other: Item, offset: npt.NDArray[np.float64], axis: Axis, forward: bool
) -> float:
    """How far an item can go along an axis until it meets another, in box units; inf for ever.

    offset: (3,) from the item's centre to the other's. What already crosses it where they start, or
    is behind it, is not met.
    """
    turned = cyclic(axis)
    mine, its, apart = surface(item, axis), surface(other, axis), offset[turned]
    if not forward:  # as if the other came up to it
        mine, its, apart = its, mine, -apart
    return float(least_rise(mine, its, apart, 0.0))


def plainly_rises(item: Surface, other: Surface, offset: npt.NDArray[np.float64]) -> float:
    """The least by which the other surface is above the item's, by all pairs of triangles."""
    return float(least_of(item.triangles, other.triangles, offset, math.inf, 0.0))
