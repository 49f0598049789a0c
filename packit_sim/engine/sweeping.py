"""The exact swept test: the distance that an item can move straight until its mesh meets another's.

It compares collision meshes triangle by triangle over the whole motion, without time steps. Where
two triangles overlap, seen along the motion, the distance between them is linear, so that it is
smallest at a corner of the overlap: a corner of either triangle, or a crossing of two edges.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.sweeping_kernels import least_rise, least_rise_of_pairs
from packit_sim.geometry.deviation import Surface
from packit_sim.geometry.items import ItemInBox
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.shapes import Item

SURFACES_BUDGET = 96 * 2**20
"""Bytes in the process's cache of items' collision meshes as trees of boxes."""

OFF_GRID_SURFACES_BUDGET = 32 * 2**20
"""Bytes in the process's cache of the same off the grid."""

AxisNumber = Literal[0, 1, 2]


@bounded_cache(
    "surfaces",
    SURFACES_BUDGET,
    "bytes",
    size=lambda surface: surface.triangles.nbytes + surface.boxes.nbytes,
    key=lambda item, axis=2: (item.key, axis),
)
def surface(item: Item, axis: AxisNumber = 2) -> Surface:
    """Look up an item's collision mesh, shrunk by half the contact tolerance on each side.

    Parameters
    ----------
    item : Item
        The item, in its rotation.
    axis : {0, 1, 2}, default: 2
        The axis that becomes the last coordinate; the order of the axes stays cyclic.

    Returns
    -------
    Surface
        The mesh relative to the item's centre, in box units.
    """
    if axis != 2:
        return reordered(surface(item), axis)
    shrink = np.maximum(item.extents - CONTACT_TOLERANCE, 0) / item.extents
    mesh = item.mesh
    return Surface.of(trimesh.Trimesh(mesh.vertices * shrink, mesh.faces, process=False))


@bounded_cache(
    "surfaces off the grid",
    OFF_GRID_SURFACES_BUDGET,
    "bytes",
    size=lambda surface: surface.triangles.nbytes + surface.boxes.nbytes,
    key=lambda posed, axis=2: (posed.item.key, posed.matrix.tobytes(), axis),
)
def posed_surface(posed: ItemInBox, axis: AxisNumber = 2) -> Surface:
    """Look up the collision mesh of an item off the grid, relative to its centre, as `surface`."""
    if axis != 2:
        return reordered(posed_surface(posed), axis)
    item = posed.item.turned(0)
    shrink = np.maximum(item.extents - CONTACT_TOLERANCE, 0) / item.extents
    vertices = posed.pose.direction(np.asarray(item.mesh.vertices) * shrink)
    return Surface.of(trimesh.Trimesh(vertices, item.mesh.faces, process=False))


def reordered(upright: Surface, axis: AxisNumber) -> Surface:
    """Return a surface with another axis as the last one; the order stays cyclic."""
    turned = cyclic(axis)
    return Surface(
        np.ascontiguousarray(upright.triangles[..., turned]),
        np.ascontiguousarray(upright.boxes[..., turned]),
        upright.starts,
    )


def cyclic(axis: AxisNumber) -> list[int]:
    """Return the axes in cyclic order, with this one last."""
    return [(axis + 1) % 3, (axis + 2) % 3, axis]


def free_distance(
    item: Item, other: Item, offset: npt.NDArray[np.float64], axis: AxisNumber, forward: bool
) -> float:
    """Compute how far an item can move along an axis before it meets another item.

    Parameters
    ----------
    item : Item
        The item that moves.
    offset : ndarray of float64, shape (3,)
        The vector from the item's centre to the other's, in box units.
    axis : {0, 1, 2}
        The axis of the motion.
    forward : bool
        Whether the item moves towards larger coordinates.

    Returns
    -------
    float
        Distance in box units, inf if they never meet. Parts of the other item that cross the item
        at the start, or are behind it, are ignored.
    """
    return way_between(surface(item, axis), surface(other, axis), offset, axis, forward)


def way_between(
    mine: Surface, its: Surface, offset: npt.NDArray[np.float64], axis: AxisNumber, forward: bool
) -> float:
    """Compute `free_distance` for two surfaces with this axis as the last one."""
    apart = offset[cyclic(axis)]
    if not forward:  # the same as the other item moving forward
        mine, its, apart = its, mine, -apart
    return float(least_rise(mine, its, apart, 0.0))


def least_rise_oracle(item: Surface, other: Surface, offset: npt.NDArray[np.float64]) -> float:
    """Compute `least_rise` by a loop over all pairs of triangles.

    Parameters
    ----------
    item : Surface
        The lower surface.
    other : Surface
        The upper surface.
    offset : ndarray of float64, shape (3,)
        Translation of the upper surface.

    Returns
    -------
    float
        The smallest height of a point of the upper surface above one of the lower surface; inf if
        there is none.
    """
    return float(least_rise_of_pairs(item.triangles, other.triangles, offset, math.inf, 0.0))
