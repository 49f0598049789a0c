"""Meshes as OBJ text that PyBullet reads correctly."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Rows = npt.NDArray[Any]

UNIT = 100.0
"""Metres in PyBullet's worlds for a box unit; relative to it, PyBullet's tolerances are small."""

_CREASE = np.radians(35)
"""Edges sharper than this angle are drawn as edges, in radians."""


def convex_pieces(mesh: trimesh.Trimesh) -> list[tuple[Rows, Rows]]:
    """Split a mesh's surface into convex pieces: vertices (n, 3) and faces (m, 3) of each."""
    pieces: list[tuple[Rows, Rows]] = []
    for part in mesh.split(only_watertight=False, repair=False):
        with np.errstate(divide="ignore", invalid="ignore"):  # of a part without volume
            convex = part.is_volume and part.is_convex
        if convex:
            pieces.append((part.vertices, part.faces))
        else:
            pieces += [(corners, np.arange(3)[None]) for corners in part.triangles]
    return pieces


def drawn(mesh: trimesh.Trimesh, scale: float) -> str:
    """Write the OBJ text of a mesh for pictures, in metres.

    PyBullet draws the front of a triangle only, and parts that are open show their backs, so their
    triangles are written twice. Each vertex has a normal: the mean over faces that are joined by
    edges other than creases, weighted by area.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The canonical mesh.
    scale : float
        The ratio by which its volume is scaled.

    Returns
    -------
    str
        The text.
    """
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)  # so that its caches are freed
    joined = mesh.face_adjacency[mesh.face_adjacency_angles <= _CREASE]
    group = trimesh.graph.connected_component_labels(joined, node_count=len(mesh.faces))
    corners = mesh.faces + group[:, None].astype(np.int64) * len(mesh.vertices)
    _, first, faces = np.unique(corners.ravel(), return_index=True, return_inverse=True)
    crosses = np.repeat(mesh.triangles_cross, 3, axis=0)
    sums = [np.bincount(faces, weights=cross) for cross in crosses.T]
    normals = trimesh.unitize(np.stack(sums, axis=1))
    vertices = mesh.vertices[mesh.faces.ravel()[first]] * (np.cbrt(scale) * UNIT)
    fronts = np.repeat(faces.reshape(-1, 3) + 1, 2, axis=1)
    backs = fronts[:, ::-1] + np.tile((0, len(first)), 3)
    outside, inside = _sides(mesh)
    return (
        _rows("v %.9g %.9g %.9g\n", vertices)
        + _rows("vn %.4f %.4f %.4f\n", np.concatenate((normals, -normals)))
        + _rows("f %d//%d %d//%d %d//%d\n", np.concatenate((fronts[outside], backs[inside])))
    )


def objects(pieces: list[tuple[Rows, Rows]], scale: float) -> str:
    """Write OBJ text with one object for each piece, of which PyBullet computes convex hulls.

    Parameters
    ----------
    pieces : list[tuple[Rows, Rows]]
        Vertices (n, 3) and triangles (m, 3) of each piece.
    scale : float
        The ratio by which volumes are scaled.

    Returns
    -------
    str
        The text, in metres. Faces are triangles: PyBullet reads larger polygons incorrectly.
    """
    text, first = [], 1
    for vertices, faces in pieces:
        text.append("o piece\n")
        text.append(_rows("v %.9g %.9g %.9g\n", vertices * (np.cbrt(scale) * UNIT)))
        text.append(_rows("f %d %d %d\n", faces + first))
        first += len(vertices)
    return "".join(text)


def _sides(mesh: trimesh.Trimesh) -> tuple[Rows, Rows]:
    """Return two bool arrays (m,): triangles whose front, and whose back, may be visible.

    Only the outer side is visible of a part in which each edge has as many triangles in either
    direction.
    """
    edge = mesh.edges_unique_inverse
    signs = np.where(mesh.edges[:, 0] < mesh.edges[:, 1], 1, -1)
    count = len(mesh.faces)
    ends = (mesh.edges_face, count + edge)
    nodes = count + len(mesh.edges_unique)
    graph = coo_array((np.ones(len(edge)), ends), shape=(nodes, nodes))
    parts, label = connected_components(graph, directed=False)
    unbalanced = np.bincount(edge, weights=signs, minlength=nodes - count) != 0
    is_open = np.zeros(parts, dtype=bool)
    is_open[label[count:][unbalanced]] = True
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    volumes = np.bincount(label[:count], np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=parts)
    sides = is_open | (volumes >= 0), is_open | (volumes < 0)
    return sides[0][label[:count]], sides[1][label[:count]]


def _rows(pattern: str, rows: Rows) -> str:
    return pattern * len(rows) % tuple(rows.ravel().tolist())
