"""Lines that show a container which is no box: on pictures, on pages and in models."""

from __future__ import annotations

import numpy as np
import trimesh

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.mesh_containers import MeshContainer

_SHARP = np.radians(25)
"""Angle between neighbouring triangles whose edge is drawn."""

_FLAT = np.radians(1)
"""Angle up to which neighbouring triangles count as one flat face."""

_CURVED = 0.2
"""Share of edges in curved surfaces from which sections of a mesh are drawn, too."""

MAX_LINES = 4000
"""Most lines of a mesh, the longest ones: scans have sharp edges everywhere."""

_RING = 72
"""Lines of a circle."""

_WIDTH = 0.006
"""Width of a line that is a body, relative to the container's longest side."""


def outline(container: Container) -> Floats:
    """Return the lines (n, 2, 3) of a container, in its coordinates; none for a box.

    Returns
    -------
    ndarray of float64, shape (n, 2, 3)
        The rims of a cylinder and four lines between them; the sharp edges of a mesh, and its
        sections through the middle if it is curved.
    """
    if isinstance(container, CylinderContainer):
        return _of_cylinder(container)
    if isinstance(container, MeshContainer):
        return _of_mesh(container.mesh)
    return np.empty((0, 2, 3))


def _of_cylinder(container: CylinderContainer) -> Floats:
    angles = np.linspace(0, 2 * np.pi, _RING + 1)
    x, y = (1 + np.array((np.cos(angles), np.sin(angles)))) * container.diameter / 2
    low, high = (np.column_stack((x, y, np.full(_RING + 1, z))) for z in (0.0, container.height))
    rims = [np.stack((ring[:-1], ring[1:]), axis=1) for ring in (low, high)]
    upright = np.stack((low[: -1 : _RING // 4], high[: -1 : _RING // 4]), axis=1)
    return np.concatenate((*rims, upright))


def _of_mesh(item_type: ItemType) -> Floats:
    vertices = item_type.vertices - item_type.low
    mesh = trimesh.Trimesh(vertices, item_type.faces, process=False)
    angles = mesh.face_adjacency_angles
    lines = [vertices[mesh.face_adjacency_edges[angles > _SHARP]].reshape(-1, 2, 3)]
    if np.mean((angles > _FLAT) & (angles <= _SHARP)) > _CURVED:
        middle = item_type.extents / 2
        lines += [trimesh.intersections.mesh_plane(mesh, way, middle) for way in np.eye(3)]
    found = np.concatenate(lines)
    lengths = np.linalg.norm(found[:, 1] - found[:, 0], axis=1)
    return found[np.argsort(-lengths, kind="stable")[:MAX_LINES]]


def outline_body(container: Container) -> ItemType | None:
    """Return the lines of a container as thin bars; None for a box."""
    lines = outline(container)
    lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    width = _WIDTH * container.longest
    lines = lines[lengths > 0.01 * width]
    if not len(lines):
        return None
    along = lines[:, 1] - lines[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    other = np.eye(3)[np.abs(along).argmin(axis=1)]
    one = np.cross(along, other)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(along, one)
    corners = [one, two, -one, -two]
    ends = [lines[:, end] + width / 2 * corner for end in (0, 1) for corner in corners]
    vertices = np.stack(ends, axis=1).reshape(-1, 3)
    sides = [(k, (k + 1) % 4, k + 4) for k in range(4)]
    sides += [((k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4)]
    bar = np.array([*sides, (2, 1, 0), (3, 2, 0), (4, 5, 6), (4, 6, 7)])
    faces = (bar + 8 * np.arange(len(lines))[:, None, None]).reshape(-1, 3)
    return ItemType(container.name, vertices, faces, known_volume=float(lengths.sum() * width**2))
