"""Meshes as OBJ text that PyBullet reads correctly."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.shading import ShadedMesh

Rows = npt.NDArray[Any]

UNIT = 100.0
"""Metres in PyBullet's worlds for a box unit; relative to it, PyBullet's tolerances are small."""


def convex_pieces(mesh: trimesh.Trimesh) -> list[tuple[Rows, Rows]]:
    """Split a mesh's surface into convex pieces: vertices (n, 3) and faces (m, 3) of each."""
    pieces: list[tuple[Rows, Rows]] = []
    for part in mesh.split(only_watertight=False, repair=False):
        with np.errstate(divide="ignore", invalid="ignore"):  # of a part without volume
            convex = part.is_volume and part.is_convex
        if convex:
            pieces.append((part.vertices, part.faces))
        else:
            pieces += [(corners, np.arange(3)[None]) for corners in part.triangles]
    return pieces


def drawn(mesh: trimesh.Trimesh, scale: float) -> str:
    """Write the OBJ text of a mesh for pictures, in metres.

    PyBullet draws the front of a triangle only, and parts that are open show their backs, so their
    triangles are written twice.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The canonical mesh.
    scale : float
        The ratio by which its volume is scaled.

    Returns
    -------
    str
        The text.
    """
    shaded = ShadedMesh.of(mesh)
    fronts = np.repeat(shaded.faces + 1, 2, axis=1)
    backs = fronts[:, ::-1] + np.tile((0, len(shaded.vertices)), 3)
    normals = np.concatenate((shaded.normals, -shaded.normals))
    return (
        _rows("v %.9g %.9g %.9g\n", shaded.vertices * (np.cbrt(scale) * UNIT))
        + _rows("vn %.4f %.4f %.4f\n", normals)
        + _rows(
            "f %d//%d %d//%d %d//%d\n",
            np.concatenate((fronts[shaded.fronts], backs[shaded.backs])),
        )
    )


def objects(pieces: list[tuple[Rows, Rows]], scale: float) -> str:
    """Write OBJ text with one object for each piece, of which PyBullet computes convex hulls.

    Parameters
    ----------
    pieces : list[tuple[Rows, Rows]]
        Vertices (n, 3) and triangles (m, 3) of each piece.
    scale : float
        The ratio by which volumes are scaled.

    Returns
    -------
    str
        The text, in metres. Faces are triangles: PyBullet reads larger polygons incorrectly.
    """
    text, first = [], 1
    for vertices, faces in pieces:
        text.append("o piece\n")
        text.append(_rows("v %.9g %.9g %.9g\n", vertices * (np.cbrt(scale) * UNIT)))
        text.append(_rows("f %d %d %d\n", faces + first))
        first += len(vertices)
    return "".join(text)


def _rows(pattern: str, rows: Rows) -> str:
    return pattern * len(rows) % tuple(rows.ravel().tolist())
