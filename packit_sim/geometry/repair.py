"""Repairs of meshes, each counted: duplicate vertices and triangles, winding, small holes."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

MAX_HOLE = 0.02
"""Longest diagonal of a hole that is filled, relative to the bounding box's diagonal. Larger holes
may be intended: the mouth of a bag, an open box."""


@dataclass(frozen=True)
class Repairs:
    """Counts of the repairs of a mesh.

    Attributes
    ----------
    merged_vertices : int
        Vertices merged with another at the same position.
    duplicate_triangles : int
        Triangles dropped because another has the same corners.
    flat_triangles : int
        Triangles dropped because they have no area.
    flipped_triangles : int
        Triangles whose winding was reversed to agree with their neighbours.
    filled_holes : int
        Holes closed with triangles.
    """

    merged_vertices: int = 0
    duplicate_triangles: int = 0
    flat_triangles: int = 0
    flipped_triangles: int = 0
    filled_holes: int = 0

    def __bool__(self) -> bool:
        return any(asdict(self).values())


def clean_mesh(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, Repairs]:
    """Remove duplicate vertices, duplicate triangles and triangles without area.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        A mesh about one unit in size: vertices nearer than trimesh's `tol.merge` (1e-8) are merged.

    Returns
    -------
    clean : trimesh.Trimesh
        A mesh with the same surface.
    repairs : Repairs
        Counts of what was removed.
    """
    clean = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    clean.remove_unreferenced_vertices()
    vertices, triangles = len(clean.vertices), len(clean.faces)
    clean.merge_vertices(merge_tex=True, merge_norm=True)
    merged = vertices - len(clean.vertices)
    corners = np.sort(clean.faces, axis=1)
    clean.update_faces((np.diff(corners, axis=1) > 0).all(axis=1))
    clean.update_faces(clean.area_faces > 0)
    flat = triangles - len(clean.faces)
    clean.update_faces(clean.unique_faces())
    duplicate = triangles - flat - len(clean.faces)
    clean.remove_unreferenced_vertices()
    return clean, Repairs(merged, duplicate, flat)


def repair_mesh(
    mesh: trimesh.Trimesh, max_hole: float = MAX_HOLE
) -> tuple[trimesh.Trimesh, Repairs]:
    """Make the winding of a clean mesh consistent, and fill its small holes.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        A mesh as `clean_mesh` returns it.
    max_hole : float
        Longest diagonal of a hole to fill, relative to the mesh's (see `MAX_HOLE`).

    Returns
    -------
    whole : trimesh.Trimesh
        The repaired mesh.
    repairs : Repairs
        The numbers of flipped triangles and of filled holes.

    Notes
    -----
    As few triangles are flipped as make a component consistent, or as make it face outwards if it
    is closed; a one-sided component (a Moebius strip) stays as it is. A hole whose rim is one loop
    is filled with a fan of triangles.
    """
    faces = np.array(mesh.faces)
    flip = _inconsistent(mesh)
    faces[flip] = faces[flip, ::-1]
    turned = trimesh.Trimesh(mesh.vertices, faces, process=False)
    fans = [
        np.column_stack([np.full(len(rim) - 2, rim[0]), rim[1:-1], rim[2:]])
        for rim in _rims(turned)
        if np.linalg.norm(np.ptp(turned.vertices[rim], axis=0)) <= max_hole * mesh.scale
    ]
    whole = trimesh.Trimesh(turned.vertices, np.concatenate([faces, *fans]), process=False)
    return whole, Repairs(flipped_triangles=int(flip.sum()), filled_holes=len(fans))


def _inconsistent(mesh: trimesh.Trimesh) -> npt.NDArray[np.bool_]:
    """Return bool (m,): the triangles to flip.

    Each triangle is two nodes of a graph, as it is and flipped. Two triangles that run through a
    common edge in opposite directions join like nodes, others unlike ones. The graph's two
    components of a part of the mesh are its two consistent windings; if they are one, it has none.
    """
    count = len(mesh.faces)
    if mesh.is_winding_consistent:
        return np.zeros(count, dtype=bool)
    pairs, edges = mesh.face_adjacency, mesh.face_adjacency_edges
    forward = np.stack([_runs_forward(mesh.faces[side], edges) for side in pairs.T])
    same = np.equal(*forward).astype(int)
    one, other = pairs.T
    rows = np.concatenate([one, one + count])
    columns = np.concatenate([other + same * count, other + (1 - same) * count])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    labels = connected_components(graph, directed=False)[1]
    kept, turned = labels[:count], labels[count:]
    parts = np.minimum(kept, turned)
    flip = kept > turned
    flips, sizes = np.bincount(parts, flip), np.bincount(parts)
    flip ^= (flips > sizes / 2)[parts]
    flip &= kept != turned
    order = np.argsort(parts, kind="stable")
    sorted_parts = parts[order]
    for part in np.unique(parts[flip]):
        start, stop = np.searchsorted(sorted_parts, (part, part + 1))
        of_part = order[start:stop]
        faces = mesh.faces[of_part]
        faces[flip[of_part]] = faces[flip[of_part], ::-1]
        alone = trimesh.Trimesh(mesh.vertices, faces, process=False)
        if alone.is_watertight and alone.volume < 0:
            flip[of_part] ^= True
    return flip


def _runs_forward(
    faces: npt.NDArray[np.int64], edges: npt.NDArray[np.int64]
) -> npt.NDArray[np.bool_]:
    """Return bool (n,): whether each triangle runs through its edge from the first end on."""
    starts = faces == edges[:, :1]
    ends = np.roll(faces, -1, axis=1) == edges[:, 1:]
    return (starts & ends).any(axis=1)


def _rims(mesh: trimesh.Trimesh) -> list[npt.NDArray[np.int64]]:
    """Return the vertices around each hole whose rim is a simple loop, in the mesh's winding."""
    edges = mesh.edges
    alone = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
    after: dict[int, int] = {}
    forked = set()
    for start, end in edges[alone].tolist():
        if end in after:
            forked.add(end)
        after[end] = start
    rims = []
    while after:
        first, here = after.popitem()
        rim = [first]
        while here in after:
            rim.append(here)
            here = after.pop(here)
        if here == first and len(rim) > 2 and not forked.intersection(rim):
            rims.append(np.array(rim))
    return rims
