"""Surfaces of shapes for web pages: simplified, with smooth shading."""

from __future__ import annotations

import trimesh

from packit_sim.geometry.shading import CREASE
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import collapsed

MAX_TRIANGLES = 4000
"""Maximum number of triangles of a shape: fifty such shapes rotate smoothly, and look the same."""


def surface(shape: Shape) -> trimesh.Trimesh:
    """Simplify the canonical mesh for display, and duplicate vertices along sharp edges.

    Parameters
    ----------
    shape : Shape
        The shape.

    Returns
    -------
    trimesh.Trimesh
        A mesh of at most `MAX_TRIANGLES` triangles, or as few as possible.
    """
    mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
    if len(mesh.faces) > MAX_TRIANGLES:
        mesh = collapsed(mesh, MAX_TRIANGLES)
    return trimesh.graph.smooth_shade(mesh, angle=CREASE, facet_minarea=None)
