"""Shapes as web pages show them: with fewer triangles, smoothly shaded."""

from __future__ import annotations

import trimesh

from packit_sim.geometry.shading import ShadedMesh
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import reduced

MAX_TRIANGLES = 2000
"""Maximum number of triangles of a shape on any page: fifty such shapes rotate smoothly."""


def surface(shape: Shape) -> trimesh.Trimesh:
    """Duplicate the vertices of a reduced shape along sharp edges, for smooth shading.

    Returns
    -------
    trimesh.Trimesh
        The mesh in the canonical frame.
    """
    shaded = ShadedMesh.of(reduced(shape, MAX_TRIANGLES).mesh)
    return trimesh.Trimesh(shaded.vertices, shaded.faces, process=False)
