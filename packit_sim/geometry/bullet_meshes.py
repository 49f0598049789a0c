"""Meshes as text that PyBullet reads correctly: Collada for pictures, OBJ for contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.shading import ShadedMesh

Rows = npt.NDArray[Any]

UNIT = 100.0
"""Metres in PyBullet's worlds for a box unit; relative to it, PyBullet's tolerances are small."""

_ACCESSOR = '<technique_common><accessor stride="3"/></technique_common>'

_COLLADA = (
    "<COLLADA><asset><unit meter='1'/><up_axis>Z_UP</up_axis></asset>"
    "<library_geometries><geometry id='mesh'><mesh>"
    "<source id='positions'><float_array {}</float_array>" + _ACCESSOR + "</source>"
    "<source id='normals'><float_array {}</float_array>" + _ACCESSOR + "</source>"
    "<vertices id='vertices'><input semantic='POSITION' source='#positions'/></vertices>"
    "<triangles count='{}'><input semantic='VERTEX' source='#vertices' offset='0'/>"
    "<input semantic='NORMAL' source='#normals' offset='0'/><p>{}</p></triangles>"
    "</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id='scene'>"
    "<node><instance_geometry url='#mesh'/></node></visual_scene></library_visual_scenes>"
    "<scene><instance_visual_scene url='#scene'/></scene></COLLADA>"
)
"""The subset that PyBullet reads; the gaps are the positions, the normals, the number of triangles
and their vertices."""


def convex_pieces(mesh: trimesh.Trimesh) -> list[tuple[Rows, Rows]]:
    """Split a mesh's surface into convex pieces: vertices (n, 3) and faces (m, 3) of each."""
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)  # its caches are freed
    pieces: list[tuple[Rows, Rows]] = []
    for part in mesh.split(only_watertight=False, repair=False):
        with np.errstate(divide="ignore", invalid="ignore"):  # of a part without volume
            convex = part.is_volume and part.is_convex
        if convex:
            pieces.append((part.vertices, part.faces))
        else:
            pieces += [(corners, np.arange(3)[None]) for corners in part.triangles]
    return pieces


def collada(mesh: trimesh.Trimesh, scale: float) -> str:
    """Write the Collada text of a mesh for pictures, in metres.

    PyBullet draws the front of a triangle only, and parts that are open show their backs, so their
    triangles are written twice. It is not OBJ, because PyBullet's EGL plugin keeps each OBJ file
    that it read in memory until the process ends.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The canonical mesh.
    scale : float
        The ratio by which its volume is scaled.

    Returns
    -------
    str
        The text. Without triangles it has one of no size, because PyBullet crashes otherwise.
    """
    if not len(mesh.faces):
        mesh = trimesh.Trimesh(np.zeros((3, 3)), [(0, 1, 2)], process=False)
    shaded = ShadedMesh.of(mesh)
    vertices = shaded.vertices * (np.cbrt(scale) * UNIT)
    fronts = shaded.faces[shaded.fronts]
    backs = shaded.faces[shaded.backs][:, ::-1] + len(vertices)
    faces = np.concatenate((fronts, backs))
    return _COLLADA.format(
        _floats("%.9g", np.concatenate((vertices, vertices))),
        _floats("%.4f", np.concatenate((shaded.normals, -shaded.normals))),
        len(faces),
        _numbers("%d", faces),
    )


def obj(pieces: list[tuple[Rows, Rows]], scale: float) -> str:
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


def _floats(pattern: str, rows: Rows) -> str:
    return f'count="{rows.size}">{_numbers(pattern, rows)}'


def _numbers(pattern: str, rows: Rows) -> str:
    return " ".join([pattern] * rows.size) % tuple(rows.ravel().tolist())


def _rows(pattern: str, rows: Rows) -> str:
    return pattern * len(rows) % tuple(rows.ravel().tolist())
