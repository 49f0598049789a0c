"""Bodies around surfaces: what is around a container in its bounding box, and thickened items.

The only module that imports manifold3d, an optional package.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from packit_sim.core.errors import ArgumentError
from packit_sim.core.extras import needed_for
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.deviation import deviation
from packit_sim.geometry.simplification import collapsed

_THIN = 1e-7
"""Thickness of a body, relative to the longest side, below which it is rounding."""

MAX_THICKENED = 1200
"""Most triangles to which a distance is added exactly, in about 2 s; of more, a simplified surface
is taken, and its deviation is added to the distance."""

MOST_CUTS = 1000
"""Most pieces that are looked at for cavities: a surface that crosses itself has no end of them."""

CROSSES = "its surface crosses itself, or a wall inside faces outwards"
"""What is wrong with a closed surface that is not that of a solid."""


def complement(vertices: Floats, faces: Ints, margin: float) -> list[tuple[Floats, Ints]]:
    """Return bodies that fill the bounding box of a closed surface around it.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        The vertices of the surface.
    faces : ndarray of int64, shape (m, 3)
        Its triangles, as indices of vertices, seen from outside anticlockwise.
    margin : float
        The bodies also fill what is nearer to the surface than this, and a little more.

    Returns
    -------
    list of (ndarray of float64, ndarray of int64)
        The vertices and triangles of each body. None has a cavity: bodies around a space are cut
        into two.

    Raises
    ------
    ArgumentError
        If the surface crosses itself.
    MissingPackageError
        If manifold3d is not installed.
    """
    with needed_for("containers with a mesh"):
        import manifold3d
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    longest = float((high - low).max())
    scaled = (vertices - low) / longest
    inside = manifold3d.Manifold(manifold3d.Mesh64(scaled, faces.astype(np.uint64)))
    if inside.status() != manifold3d.Error.NoError:
        raise ArgumentError(f"its surface is no solid ({inside.status().name})")
    box = manifold3d.Manifold.cube(((high - low) / longest).tolist())
    around = box - inside
    if margin > 0:
        fewer, error = _simplified(scaled, faces)
        around += _thickened(manifold3d, fewer, margin / longest + error) ^ box
    bodies = [body for body in _without_cavities(around) if _thickness(body) > _THIN]
    meshes = (body.to_mesh64() for body in bodies)
    return [
        (np.asarray(mesh.vert_properties)[:, :3] * longest + low, np.asarray(mesh.tri_verts, int))
        for mesh in meshes
    ]


def thickened(vertices: Floats, faces: Ints, distance: float) -> tuple[Floats, Ints]:
    """Return the surface of all that is in a body, or nearer to its surface than a distance.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        The vertices of the body's surface.
    faces : ndarray of int64, shape (m, 3)
        Its triangles, as indices of vertices.
    distance : float
        The distance; the body reaches a little farther.

    Returns
    -------
    (ndarray of float64, ndarray of int64)
        The vertices and triangles.

    Raises
    ------
    MissingPackageError
        If manifold3d is not installed.
    """
    with needed_for("parts with a clearance of their own"):
        import manifold3d
    low = vertices.min(axis=0)
    longest = float(np.ptp(vertices, axis=0).max())
    scaled = (vertices - low) / longest
    fewer, error = _simplified(scaled, faces)
    around = _thickened(manifold3d, fewer, distance / longest + error)
    inside = manifold3d.Manifold(manifold3d.Mesh64(scaled, faces.astype(np.uint64)))
    if inside.status() == manifold3d.Error.NoError:
        around += inside
    mesh = around.to_mesh64()
    found = np.asarray(mesh.vert_properties)[:, :3] * longest + low
    return found, np.asarray(mesh.tri_verts, np.int64)


def _simplified(vertices: Floats, faces: Ints) -> tuple[Floats, float]:
    """Return triangles (n, 3, 3), fewer if there are many, and their deviation from the surface."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if len(faces) <= MAX_THICKENED:
        return np.asarray(mesh.triangles), 0.0
    fewer = collapsed(mesh, MAX_THICKENED)
    return np.asarray(fewer.triangles), deviation(mesh, fewer)


def _thickened(manifold3d: Any, triangles: Floats, distance: float) -> Any:
    """Return all that is nearer to triangles (n, 3, 3) than a distance, and a little more."""
    ball = trimesh.creation.icosphere(subdivisions=0)
    inner = float((ball.face_normals * ball.triangles[:, 0]).sum(axis=1).min())
    corners = np.asarray(ball.vertices) * (distance / inner)  # the ball is inside this polyhedron
    hulls = (
        manifold3d.Manifold.hull_points((each[:, None] + corners).reshape(-1, 3))
        for each in triangles
    )
    return manifold3d.Manifold.batch_boolean(list(hulls), manifold3d.OpType.Add)


def _without_cavities(body: Any) -> list[Any]:
    """Cut a body until the surface of no piece has a part that faces inwards."""
    found: list[Any] = []
    left = [body]
    for _ in range(MOST_CUTS):
        if not left:
            return found
        piece = left.pop()
        parts = piece.decompose()
        cavity = next((part for part in parts if part.volume() < 0), None)
        if cavity is None:
            found += parts
            continue
        low, high = np.array(cavity.bounding_box()).reshape(2, 3)
        axis = int(np.argmax(high - low))
        normal, middle = np.eye(3)[axis].tolist(), float((low + high)[axis] / 2)
        left += piece.split_by_plane(normal, middle)
    raise ArgumentError(CROSSES)


def _thickness(body: Any) -> float:
    return 2 * float(body.volume()) / max(float(body.surface_area()), 1e-300)
