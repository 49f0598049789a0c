"""Meshes for pictures: normals that keep sharp edges, and the sides that may be visible."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from packit_sim.geometry.arrays import Floats

CREASE = np.radians(35)
"""Edges sharper than this angle are shown as edges, in radians."""


class ShadedMesh(NamedTuple):
    """Triangles with a normal for each vertex; vertices are duplicated along sharp edges.

    Attributes
    ----------
    vertices : ndarray of float64, shape (n, 3)
        Positions.
    normals : ndarray of float64, shape (n, 3)
        Unit vectors: the mean over the faces that are joined by edges other than sharp ones,
        weighted by area.
    faces : ndarray of int64, shape (m, 3)
        Vertices of each triangle.
    fronts, backs : ndarray of bool, shape (m,)
        Whether the side of a triangle that its normal points to, and the other one, may be
        visible: of a closed part only the outer one.
    """

    vertices: Floats
    normals: Floats
    faces: npt.NDArray[np.int64]
    fronts: npt.NDArray[np.bool_]
    backs: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> ShadedMesh:
        """Compute the normals and visible sides of a mesh."""
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)  # its caches are freed
        joined = mesh.face_adjacency[mesh.face_adjacency_angles <= CREASE]
        group = trimesh.graph.connected_component_labels(joined, node_count=len(mesh.faces))
        corners = mesh.faces + group[:, None].astype(np.int64) * len(mesh.vertices)
        _, first, faces = np.unique(corners.ravel(), return_index=True, return_inverse=True)
        crosses = np.repeat(mesh.triangles_cross, 3, axis=0)
        sums = [np.bincount(faces, weights=cross) for cross in crosses.T]
        return cls(
            mesh.vertices[mesh.faces.ravel()[first]],
            trimesh.unitize(np.stack(sums, axis=1)),
            faces.reshape(-1, 3),
            *_sides(mesh),
        )


def _sides(mesh: trimesh.Trimesh) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
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
