"""Meshes with fewer triangles, and a bound of their deviation from the original."""

from __future__ import annotations

import math
from dataclasses import dataclass

import meshoptimizer
import numpy as np
import trimesh

from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import MeshError
from packit_sim.geometry.deviation import deviation
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Shape

TOLERANCES = (1e-3, 3e-4, 1e-4)
"""Errors to simplify to, in canonical units. A mesh is reduced to about the first of them, and
further only if it still has too many triangles; the next is tried if the deviation is more than
`GOOD_ERROR`."""

GOOD_ERROR = 0.005
"""In canonical units: half a cell for an item as long as the box."""


@dataclass(frozen=True)
class Simplification:
    """How far meshes may be reduced.

    Parameters
    ----------
    max_triangles : int | None
        Meshes with more triangles are reduced; None leaves all as they are.
    max_error : float
        Largest deviation, in canonical units (a shape's diagonal is 1).
    eager : bool
        Whether to reduce meshes with fewer triangles too, as far as `TOLERANCES` allow.

    Raises
    ------
    ArgumentError
        If a value is out of range.
    """

    max_triangles: int | None = 4000
    max_error: float = 0.01
    eager: bool = False

    def __post_init__(self) -> None:
        if self.max_triangles is not None:
            check_range("max_triangles", self.max_triangles, Range(4))
        check_range("max_error", self.max_error, Range(0, 1, "(]"))

    def __call__(self, shape: Shape) -> tuple[QuantizedMesh, float]:
        """Simplify a shape's mesh.

        Parameters
        ----------
        shape : Shape
            The shape.

        Returns
        -------
        mesh : QuantizedMesh
            The mesh to store.
        error : float
            A bound of its deviation from the shape's mesh (see `deviation.deviation`).

        Raises
        ------
        MeshError
            If so few triangles are not possible within `max_error`.
        """
        limit = math.inf if self.max_triangles is None else self.max_triangles
        if len(shape.mesh.faces) <= limit and not self.eager:
            kept, error = self._unreduced(shape)
        else:
            kept, error = self._reduced(shape, limit)
        if error > self.max_error:
            raise MeshError(
                f"its {len(shape.mesh.faces):,} triangles can't be reduced to {len(kept.faces):,} "
                f"without being {error:.4f} of the diagonal off: at most {self.max_error:g}"
            )
        return kept, error

    def _unreduced(self, shape: Shape) -> tuple[QuantizedMesh, float]:
        kept = QuantizedMesh.of(shape)
        return kept, deviation(shape.mesh, kept.mesh())

    def _reduced(self, shape: Shape, limit: float) -> tuple[QuantizedMesh, float]:
        best: tuple[float, QuantizedMesh] | None = None
        for tolerance in TOLERANCES:
            mesh = collapsed(shape.mesh, 0, tolerance)
            if len(mesh.faces) > limit:
                mesh = collapsed(shape.mesh, int(limit), 1.0)
            if len(mesh.faces) > limit:
                raise MeshError(
                    f"its {len(shape.mesh.faces):,} triangles can't be reduced to {limit:,}: "
                    f"{len(mesh.faces):,} are left"
                )
            kept = QuantizedMesh.of(Shape.from_mesh(mesh, shape.id, shape.category))
            error = deviation(shape.mesh, kept.mesh())
            if best is None or error < best[0]:
                best = error, kept
            if best[0] <= GOOD_ERROR or len(mesh.faces) > 0.9 * limit:
                break
        assert best is not None
        error, kept = best
        if error > GOOD_ERROR and len(shape.mesh.faces) <= limit:
            return self._unreduced(shape)
        return kept, error


def collapsed(mesh: trimesh.Trimesh, triangles: int, error: float) -> trimesh.Trimesh:
    """Simplify a mesh by collapsing edges.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The mesh.
    triangles : int
        Number of triangles to stop at.
    error : float
        Error to stop at, in the mesh's unit.

    Returns
    -------
    trimesh.Trimesh
        A mesh with as few triangles as both allow.

    Notes
    -----
    The method is that of Garland and Heckbert (1997), as implemented in meshoptimizer.
    """
    indices = np.ascontiguousarray(mesh.faces, dtype=np.uint32).ravel()
    kept = np.empty_like(indices)
    count = meshoptimizer.simplify(
        kept,
        indices,
        np.ascontiguousarray(mesh.vertices, dtype=np.float32),
        target_index_count=3 * triangles,
        target_error=error,
        options=meshoptimizer.SIMPLIFY_ERROR_ABSOLUTE,
    )
    return trimesh.Trimesh(mesh.vertices, kept[:count].reshape(-1, 3).astype(int), process=False)
