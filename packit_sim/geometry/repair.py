"""Repairs of meshes, each counted: duplicate vertices and triangles, winding, small holes."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.parts import part_numbers

MAX_HOLE = 0.02
"""Longest diagonal of a hole that is filled in any case, relative to the bounding box's diagonal.
Larger holes may be intended: the mouth of a bag, an open box."""

MAX_PATCHES = 0.1
"""Largest area of the patches that close a part of a surface, relative to that part's area: one
triangle of a cube's twelve is 1/11 of the others."""

MAX_BEND = 60.0
"""Largest angle between a patch and the surface that it continues, in degrees. The lid of an open
box is at right angles to the walls."""

MIN_CONTINUED = 1 / 3
"""Smallest share of a rim's length along which a patch continues the surface: the diagonal of a
cube's face is 0.41 of the rim of half the face."""

_APEXES = 64
"""Vertices of a rim that are tried as the apex of a patch."""


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
        The repaired mesh, or the same one if it needs no repair: the same vertices, and the same
        triangles followed by those that fill holes.
    repairs : Repairs
        The numbers of flipped triangles and of filled holes.

    Notes
    -----
    As few triangles are flipped as make a component consistent, or as make it face outwards if it
    is closed; a one-sided component (a Moebius strip) stays as it is. A hole is filled with a fan
    of triangles. Larger holes than `max_hole` are filled too where this closes a connected part of
    the surface that was nearly closed: each patch continues the surface around it (`MAX_BEND`,
    `MIN_CONTINUED`), and all patches are a small share of its area (`MAX_PATCHES`). So a block
    without one of its triangles is a block, and a box without a lid stays open.
    """
    faces = np.array(mesh.faces)
    flip = _inconsistent(mesh)
    faces[flip] = faces[flip, ::-1]
    turned = trimesh.Trimesh(mesh.vertices, faces, process=False) if flip.any() else mesh
    fans = [] if turned.is_watertight else _fans(turned, max_hole * mesh.scale)
    whole = turned
    if fans:
        whole = trimesh.Trimesh(mesh.vertices, np.concatenate([faces, *fans]), process=False)
    return whole, Repairs(flipped_triangles=int(flip.sum()), filled_holes=len(fans))


def _fans(mesh: trimesh.Trimesh, max_hole: float) -> list[Ints]:
    """Return the triangles that fill each hole which is small or keeps a part nearly closed."""
    edges, vertices = np.asarray(mesh.edges), np.asarray(mesh.vertices)
    part = part_numbers(np.asarray(mesh.faces), len(vertices))
    normals = np.asarray(mesh.face_normals)
    areas = np.bincount(part, mesh.area_faces)
    patches = np.zeros(len(areas))
    closable = np.ones(len(areas), dtype=bool)
    rims, others = _rims(mesh)
    closable[part[others]] = False
    fans, parts, small = [], [], []
    for size in sorted({len(rim) for rim in rims}):  # many at a time
        own = np.array([rim for rim in rims if len(rim) == size])
        corners, owner = edges[own, 1], part[own[:, 0] // 3]
        fan = _fan_of_least_area(vertices, corners)
        area = np.linalg.norm(_normals(vertices[fan]), axis=2) / 2
        points = vertices[corners]
        steps = np.roll(points, -1, axis=1) - points
        lengths = np.linalg.norm(steps, axis=2)
        normal = np.cross(points - points[:, :1], steps).sum(axis=1)
        least = np.cos(np.radians(MAX_BEND)) * np.linalg.norm(normal, axis=1)
        bends = np.einsum("knd,kd->kn", normals[own // 3], normal) <= least[:, None]
        continued = np.where(bends, 0.0, lengths).sum(axis=1)
        closable[owner[continued < MIN_CONTINUED * lengths.sum(axis=1)]] = False
        np.add.at(patches, owner, area.sum(axis=1))
        fans += [each[flat > 0] for each, flat in zip(fan, area, strict=True)]
        parts += owner.tolist()
        small += (np.linalg.norm(np.ptp(points, axis=1), axis=1) <= max_hole).tolist()
    closable &= patches <= MAX_PATCHES * areas
    found = zip(fans, parts, small, strict=True)
    return [fan for fan, own, is_small in found if len(fan) and (is_small or closable[own])]


def _fan_of_least_area(vertices: Floats, rims: Ints) -> Ints:
    """Return the triangles (k, n - 2, 3) of a fan in each rim (k, n)."""
    count = rims.shape[1]
    if count > 3:
        points = vertices[rims]
        apexes = np.unique(np.linspace(0, count - 1, min(count, _APEXES)).astype(int))
        sides = points[:, None] - points[:, apexes, None]
        areas = np.linalg.norm(np.cross(sides, np.roll(sides, -1, axis=2)), axis=3).sum(axis=2)
        is_least = areas <= areas.min(axis=1, keepdims=True) * (1 + 1e-9)
        first = apexes[is_least.argmax(axis=1)]
        rims = np.take_along_axis(rims, (first[:, None] + np.arange(count)) % count, axis=1)
    apex = np.broadcast_to(rims[:, :1], (len(rims), count - 2))
    return np.stack([apex, rims[:, 1:-1], rims[:, 2:]], axis=2)


def _normals(triangles: Floats) -> Floats:
    """Return the normals (..., 3), twice as long as the areas, of triangles (..., 3, 3)."""
    a, b, c = np.moveaxis(triangles, -2, 0)
    return np.cross(b - a, c - a)


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


def _rims(mesh: trimesh.Trimesh) -> tuple[list[Ints], Ints]:
    """Return the edges of each hole's rim, a simple loop, and the triangles with edges in none.

    An edge is a row of `mesh.edges`. Rims run in the winding of what fills the hole, so each edge
    is followed from its end to its start.
    """
    alone = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
    starts, ends = mesh.edges[alone].T.tolist()
    after = defaultdict(list)
    for edge, start, end in zip(alone.tolist(), starts, ends, strict=True):
        after[end].append((edge, start))
    rims, left = [], []
    for first in ends:
        here = first
        path: list[int] = []
        passed = {here: 0}  # where the path was at a vertex
        while after[here]:
            edge, here = after[here].pop()
            path.append(edge)
            begin = passed.get(here)
            if begin is not None:  # holes may meet at a vertex
                rims.append(np.array(path[begin:]))
                del path[begin:]
                passed = {vertex: n for vertex, n in passed.items() if n <= begin}
            else:
                passed[here] = len(path)
        left += path
    return rims, np.array(left, dtype=np.int64) // 3
