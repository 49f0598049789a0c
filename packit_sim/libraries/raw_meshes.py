"""Meshes and parts as in their files."""

from __future__ import annotations

from dataclasses import dataclass

import trimesh


@dataclass(frozen=True, eq=False)
class RawMesh:
    """A mesh as in its file; the meshes of a scene are joined, with their nodes' transforms.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        The mesh, in the file's coordinates.
    up : str
        The axis that points up, "x", "y" or "z".
    unit_cm : float, optional
        Centimetres in the file's unit of length, if the file or its format defines it.
    parts : int
        The number of meshes in the file's scene, counting every instance.
    notes : tuple of str
        What the user should know about how the file was understood.
    deviation : float
        No point of the file's surface is farther from the mesh: that of a tessellation.
    """

    mesh: trimesh.Trimesh
    up: str = "z"
    unit_cm: float | None = None
    parts: int = 1
    notes: tuple[str, ...] = ()
    deviation: float = 0.0


@dataclass(frozen=True, eq=False)
class RawPart:
    """A part of a scene, as in its file, with the transform of its first instance.

    Attributes
    ----------
    name : str
        The name of its node, or that of its mesh if there are several instances.
    raw : RawMesh
        Its mesh, in the scene's coordinates.
    count : int
        The number of its instances in the same orientation.
    node : str, optional
        What finds it again in the file: a node, if the file has other parts, or the number of the
        first item in the build of a 3MF file.
    """

    name: str
    raw: RawMesh
    count: int = 1
    node: str | None = None
