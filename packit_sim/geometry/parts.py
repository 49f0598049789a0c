"""The connected parts of a surface, and which of them are closed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.arrays import Floats, Ints


class Parts(NamedTuple):
    """The connected parts of a surface; triangles that share a vertex are connected.

    Attributes
    ----------
    vertices : Ints
        (p,) the vertex of each part that is farthest from the origin.
    closed : Ints
        (m, 3) the triangles of the closed parts, those of a part next to each other.
    starts : Ints
        (q + 1,) where the triangles of each closed part start.
    """

    vertices: Ints
    closed: Ints
    starts: Ints

    @classmethod
    def of(cls, vertices: Floats, faces: Ints) -> Parts:
        """Find the parts of a surface.

        Parameters
        ----------
        vertices : ndarray of float64, shape (n, 3)
            Its vertices.
        faces : ndarray of int64, shape (m, 3)
            Its triangles, as indices of vertices.

        Returns
        -------
        Parts
            Its parts.
        """
        part = part_numbers(faces, len(vertices))
        order = np.argsort(part, kind="stable")
        distances = (vertices**2).sum(axis=1)
        corners, of_part = faces[order].ravel(), part[order].repeat(3)
        by_distance = np.lexsort((corners, distances[corners], of_part))
        last = np.flatnonzero(np.diff(of_part, append=-1))  # the sort keeps the parts' order
        kept = order[closed_parts(faces, part)[part[order]]]
        sizes = np.unique(part[kept], return_counts=True)[1]
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        return cls(corners[by_distance][last], faces[kept], starts)

    @property
    def shells(self) -> list[Ints]:
        """The triangles (m, 3) of each closed part."""
        return np.split(self.closed, self.starts[1:-1]) if len(self.closed) else []


def part_numbers(faces: Ints, vertices: int) -> Ints:
    """Find the connected part of each triangle of a surface.

    Parameters
    ----------
    faces : ndarray of int64, shape (m, 3)
        Its triangles, as indices of vertices.
    vertices : int
        Number of vertices.

    Returns
    -------
    ndarray of int64, shape (m,)
        The number of each triangle's part, from 0.
    """
    edges = trimesh.geometry.faces_to_edges(faces)
    labels = trimesh.graph.connected_component_labels(edges, node_count=vertices)
    return np.unique(labels[faces[:, 0]], return_inverse=True)[1].astype(np.int64)


def closed_parts(faces: Ints, part: Ints) -> npt.NDArray[np.bool_]:
    """Find the parts that are closed: watertight, with consistent winding.

    Parameters
    ----------
    faces : ndarray of int64, shape (m, 3)
        The triangles, as indices of vertices.
    part : ndarray of int64, shape (m,)
        The number of each triangle's part.

    Returns
    -------
    ndarray of bool, shape (p,)
        Whether the triangles of the part run through each edge equally often in both directions.
    """
    edges = trimesh.geometry.faces_to_edges(faces).astype(np.int64)
    low, high = edges.min(axis=1), edges.max(axis=1)
    edge = np.unique(low * (faces.max() + 1) + high, return_inverse=True)[1].ravel()
    balance = np.bincount(edge, np.sign(edges[:, 1] - edges[:, 0]))
    rims = np.bincount(part.repeat(3), balance[edge] != 0)
    return np.asarray(rims == 0)
