"""The connected parts of a surface, and which of them are closed."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.triangle_trees import tree_order

Value = TypeVar("Value", bound=np.generic)


class Parts(NamedTuple):
    """The connected parts of a surface; triangles that share a vertex are connected.

    Attributes
    ----------
    vertices : Ints
        (p,) the vertex of each part that is farthest from the origin.
    extremes : Ints
        (p, 2, 3) the vertices of each part that are lowest and highest along x, y and z.
    closed : Ints
        (m, 3) the triangles of the closed parts, those of a part next to each other.
    starts : Ints
        (q + 1,) where the triangles of each closed part start.
    order : Ints
        (m,) the order of the closed parts' triangles in a tree (see `triangle_trees`).
    """

    vertices: Ints
    extremes: Ints
    closed: Ints
    starts: Ints
    order: Ints

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
        first = np.flatnonzero(np.diff(of_part, prepend=-1))
        last = np.flatnonzero(np.diff(of_part, append=-1))  # sorting keeps the parts' order
        by_distance = np.lexsort((corners, distances[corners], of_part))
        along = [corners[np.lexsort((vertices[corners, d], of_part))] for d in range(3)]
        extremes = np.stack([[each[first], each[last]] for each in along]).transpose(2, 1, 0)
        kept = order[closed_parts(faces, part)[part[order]]]
        sizes = np.unique(part[kept], return_counts=True)[1]
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        closed = faces[kept]
        farthest = corners[by_distance][last]
        return cls(farthest, extremes, closed, starts, tree_order(vertices[closed]))

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

    Returns
    -------
    ndarray of int64, shape (m,)
        The number of each triangle's part, from 0.
    """
    edges = trimesh.geometry.faces_to_edges(faces)
    labels = trimesh.graph.connected_component_labels(edges, node_count=vertices)
    return np.unique(labels[faces[:, 0]], return_inverse=True)[1].astype(np.int64)


def by_part(values: npt.NDArray[Value], part: Ints) -> list[npt.NDArray[Value]]:
    """Divide what is given for each triangle, such as its corners, by the triangles' parts.

    Parameters
    ----------
    values : ndarray, shape (m, ...)
        What is given.
    part : ndarray of int64, shape (m,)
        The number of each triangle's part (see `part_numbers`).

    Returns
    -------
    list of ndarray
        What is given for the triangles of each part, in their order.
    """
    order = np.argsort(part, kind="stable")
    return np.split(values[order], np.cumsum(np.bincount(part))[:-1])


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
