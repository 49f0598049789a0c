"""What is left of an item where a box is cut open, and the section that the cut shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.lattice import CELL, FINE
from packit_sim.placement import PlacedItem
from packit_sim.render.looks import Cut


@dataclass(frozen=True, eq=False)
class Section:
    """An item that is cut through, about its centre, in box units.

    rest: the surface before the cut, open there. cap: the section, flat.
    """

    rest: trimesh.Trimesh
    cap: trimesh.Trimesh


def is_beyond(placed: PlacedItem, cut: Cut) -> bool:
    """Whether an item is taken away whole."""
    return float(_span(placed, cut)[0]) >= _plane(cut)


def section(placed: PlacedItem, cut: Cut, mesh: trimesh.Trimesh | None = None) -> Section | None:
    """What is left of an item that stands across a cut; None where it does not.

    The cut is at the face between fine cells that is next to it. mesh: what is shown of the item,
    about its centre, in box units; by default its own.
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
    """Where the cut goes, in box units: on the nearest face between fine cells."""
    return round(cut.at / FINE) * FINE


def _span(placed: PlacedItem, cut: Cut) -> npt.NDArray[np.float64]:
    """(2,) from where to where an item reaches along the cut's axis."""
    half = placed.item.extents[cut.dimension] / 2
    return placed.center[cut.dimension] + np.array((-half, half))


def _cap(placed: PlacedItem, cut: Cut, at: float) -> trimesh.Trimesh:
    """The outer fine cells of the layer before the cut, as rectangles at the cut."""
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
