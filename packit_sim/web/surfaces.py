"""Shapes as web pages show them: with fewer triangles, smoothly shaded."""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache

import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.geometry.shading import CREASE
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import collapsed

MAX_TRIANGLES = 2000
"""Maximum number of triangles of a shape on any page: fifty such shapes rotate smoothly."""


@lru_cache(maxsize=512)
def reduced(shape: Shape) -> Shape:
    """Return a shape with at most `MAX_TRIANGLES` triangles, or as few as possible."""
    if len(shape.mesh.faces) > MAX_TRIANGLES:
        with suppress(MeshError):  # nothing solid would be left
            mesh = collapsed(shape.mesh, MAX_TRIANGLES)
            return Shape.from_mesh(mesh, shape.id, shape.category)
    return shape


def surface(shape: Shape) -> trimesh.Trimesh:
    """Duplicate the vertices of a reduced shape along sharp edges, for smooth shading.

    Returns
    -------
    trimesh.Trimesh
        The mesh in the canonical frame.
    """
    mesh = reduced(shape).mesh
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return trimesh.graph.smooth_shade(mesh, angle=CREASE, facet_minarea=None)
