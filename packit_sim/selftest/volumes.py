"""Boolean volumes of solids by manifold3d: a witness that uses neither voxels nor FCL."""

from __future__ import annotations

import importlib.util

import numpy as np
import trimesh

from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CONTACT_TOLERANCE

DEPTH = float(np.sqrt(3)) * CONTACT_TOLERANCE
"""Maximum depth of the overlap of two accepted solids: the tolerance along each axis."""


def is_available() -> bool:
    """Return whether manifold3d is installed."""
    return importlib.util.find_spec("manifold3d") is not None


def is_solid(placed: PlacedItem) -> bool:
    """Return whether an item's mesh is closed, so that it has a volume."""
    with np.errstate(divide="ignore", invalid="ignore"):  # the centre of mass, if it has none
        return bool(placed.item.shape.mesh.is_volume)


def is_one_solid(placed: PlacedItem) -> bool:
    """Return whether an item's mesh is one closed body."""
    return placed.item.shape.is_solid


def shared_depth(one: PlacedItem, other: PlacedItem) -> float:
    """Compute the mean thickness of the overlap of two solids: twice its volume over its area."""
    shared = _shared(one, other, 0.0)
    return 2 * _volume(shared) / shared.area if _volume(shared) else 0.0


def touch(one: PlacedItem, other: PlacedItem) -> bool:
    """Decide whether two solids share a volume, if both grow or shrink by half the tolerance."""
    growths = (-CONTACT_TOLERANCE, 0.0, CONTACT_TOLERANCE)
    return any(_volume(_shared(one, other, growth)) > 0 for growth in growths)


def _volume(mesh: trimesh.Trimesh) -> float:
    if mesh.is_empty:
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):  # the centre of mass, if it has none
        return abs(float(mesh.volume))


def _shared(one: PlacedItem, other: PlacedItem, growth: float) -> trimesh.Trimesh:
    """Intersect two solids; both are longer by `growth` along each axis."""
    solids = []
    for placed in (one, other):
        extents = placed.item.extents
        factor = np.maximum(extents + growth, 1e-3 * extents) / extents
        vertices = placed.item.mesh.vertices * factor + placed.center
        solids.append(trimesh.Trimesh(vertices, placed.item.shape.mesh.faces, process=False))
    return trimesh.boolean.intersection(solids, engine="manifold")
