"""Items that a plane cuts: the part that remains, and its section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, FINE
from packit_sim.render.looks import Cut

BRIGHTNESS = 0.8
"""The share of its item's brightness that a section has."""


@dataclass(frozen=True, eq=False)
class Section:
    """An item that is cut, relative to its centre, in box units.

    Attributes
    ----------
    rest : trimesh.Trimesh
        The surface in front of the plane, open there.
    cap : trimesh.Trimesh
        The section, flat.
    """

    rest: trimesh.Trimesh
    cap: trimesh.Trimesh


def is_beyond(placed: PlacedItem, cut: Cut) -> bool:
    """Return whether an item is hidden completely."""
    return float(_span(placed, cut)[0]) >= _plane(cut)


def section(placed: PlacedItem, cut: Cut, mesh: trimesh.Trimesh | None = None) -> Section | None:
    """Compute the part that remains of an item that a plane crosses.

    The plane is moved to the nearest face between fine cells.

    Parameters
    ----------
    cut : Cut
        The plane.
    mesh : trimesh.Trimesh | None
        The surface that is shown of the item, relative to its centre, in box units; by default its
        own mesh.

    Returns
    -------
    Section | None
        The part that remains; None if the plane does not cross the item.
    """
    low, high = _span(placed, cut)
    at = _plane(cut)
    if not low < at < high:
        return None
    normal = -np.eye(3)[cut.dimension]
    mesh = placed.item.mesh if mesh is None else mesh
    plane = (at - placed.center) * -normal
    vertices, faces, _ = trimesh.intersections.slice_faces_plane(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), normal, plane
    )
    return Section(trimesh.Trimesh(vertices, faces, process=False), _cap(placed, cut, at))


def _plane(cut: Cut) -> float:
    """Return the position of the plane in box units: the nearest face between fine cells."""
    return round(cut.at / FINE) * FINE


def _span(placed: PlacedItem, cut: Cut) -> npt.NDArray[np.float64]:
    """Return an item's extent (2,) along the cut's axis."""
    half = placed.item.extents[cut.dimension] / 2
    return placed.center[cut.dimension] + np.array((-half, half))


def _cap(placed: PlacedItem, cut: Cut, at: float) -> trimesh.Trimesh:
    """Build rectangles at the plane from the outer fine cells of the layer in front of it."""
    axis = cut.dimension
    layer = round(at / FINE - placed.start[axis] * CELL / FINE) - 1
    filled = np.take(placed.item.voxels.outer_fine, layer, axis=axis)
    edges = np.diff(np.pad(filled, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, first), (_, last) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    corners = np.empty((len(row), 4, 3))
    others = [n for n in range(3) if n != axis]
    corners[..., axis] = at
    corners[..., others[0]] = np.stack((row, row + 1, row + 1, row), axis=1) * FINE
    corners[..., others[1]] = np.stack((first, first, last, last), axis=1) * FINE
    corners[..., others] += np.array(placed.start)[others] * CELL
    faces = 4 * np.arange(len(row))[:, None, None] + np.array(((0, 1, 2), (0, 2, 3)))
    vertices = corners.reshape(-1, 3) - placed.center
    return trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False)
