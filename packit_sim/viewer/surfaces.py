"""What a page shows of a shape: its triangles, fewer where it has very many, smoothly shaded."""

from __future__ import annotations

import numpy as np
import trimesh

from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import collapsed

MOST_TRIANGLES = 4000
"""Of a shape on a page: fifty of them turn smoothly, and no pixel tells the difference."""

_CREASE = np.radians(35)
"""Edges sharper than this are shown as edges."""


def surface(shape: Shape) -> trimesh.Trimesh:
    """The canonical mesh, reduced to `MOST_TRIANGLES`, its vertices doubled along sharp edges.

    For looking at alone: nothing is placed by it.
    """
    mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
    if len(mesh.faces) > MOST_TRIANGLES:
        mesh = collapsed(mesh, MOST_TRIANGLES, 1.0)
    return trimesh.graph.smooth_shade(mesh, angle=_CREASE, facet_minarea=None)
