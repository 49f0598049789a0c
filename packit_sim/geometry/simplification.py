"""Meshes with fewer triangles, and a bound of their deviation from the original."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import fast_simplification
import numpy as np
import trimesh

from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import MeshError
from packit_sim.geometry.deviation import deviation
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Shape

GOOD_ERROR = 0.005
"""A good error, in canonical units: half a cell for an item as long as the box. If the first
simplification has a larger one, others are tried."""

EAGER_ERROR = 0.001
"""The error up to which eager simplification goes, in canonical units."""

FEWEST = 50
"""Triangles below which no mesh is reduced to share a total with others: all look alike there."""

_AGGRESSIVENESS = (7.0, 3.0, 1.0)
"""Growth rates of the tolerance of edge collapses, in the order in which they are tried. The
default of the library is 7; slower growth gives a smaller error for some meshes of many parts."""


@dataclass(frozen=True)
class Simplification:
    """Limits of the reduction of meshes.

    Parameters
    ----------
    max_triangles : int | None
        Meshes with more triangles are reduced; None leaves all as they are.
    max_error : float
        Largest deviation, in canonical units (a shape's diagonal is 1).
    eager : bool
        Whether to reduce meshes further, by halves, as long as the error is below `EAGER_ERROR`.

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
        count = len(shape.mesh.faces)
        if self.max_triangles is not None and count > self.max_triangles:
            kept, error = _reduced(shape, self.max_triangles)
        else:
            kept = QuantizedMesh.of(shape)
            error = deviation(shape.mesh, kept.mesh())
        while self.eager and len(kept.faces) > 8:
            try:
                fewer, more_error = _reduced(shape, len(kept.faces) // 2)
            except MeshError:
                break
            if more_error > EAGER_ERROR:
                break
            kept, error = fewer, more_error
        if error > self.max_error:
            raise MeshError(
                f"its {count:,} triangles can't be reduced to {len(kept.faces):,} "
                f"without being {error:.4f} of the diagonal off: at most {self.max_error:g}"
            )
        return kept, error


def _reduced(shape: Shape, triangles: int) -> tuple[QuantizedMesh, float]:
    """Reduce a mesh to a number of triangles; return the best mesh and a bound of its error."""
    best: tuple[float, QuantizedMesh] | None = None
    fewest = len(shape.mesh.faces)
    for aggressiveness in _AGGRESSIVENESS:
        mesh = collapsed(shape.mesh, triangles, aggressiveness)
        fewest = min(fewest, len(mesh.faces))
        if len(mesh.faces) > triangles:
            continue
        kept = QuantizedMesh.of(Shape.from_mesh(mesh, shape.id, shape.category))
        error = deviation(shape.mesh, kept.mesh())
        if best is None or error < best[0]:
            best = error, kept
        if best[0] <= GOOD_ERROR:
            break
    if best is None:
        raise MeshError(
            f"its {len(shape.mesh.faces):,} triangles can't be reduced to {triangles:,}: "
            f"{fewest:,} are left"
        )
    error, kept = best
    return kept, error


@lru_cache(maxsize=1024)
def reduced(shape: Shape, triangles: int) -> Shape:
    """Reduce a shape for display: to some triangles, or as few as possible.

    Its volume and its bounding box are kept: with few triangles, collapsed edges may lead far out
    of the box.
    """
    if len(shape.mesh.faces) > triangles:
        with suppress(MeshError):  # nothing solid would be left
            found = Shape.from_mesh(collapsed(shape.mesh, triangles), shape.id, shape.category).mesh
            (low, high), (own_low, own_high) = shape.mesh.bounds, found.bounds
            places = low + (found.vertices - own_low) * ((high - low) / (own_high - own_low))
            mesh = trimesh.Trimesh(places, found.faces, process=False)
            return Shape(mesh, shape.id, shape.category, shape.volume)
    return shape


def triangle_limit(counts: Sequence[int], total: int) -> int:
    """Return the largest number of triangles that each mesh may have, for all to share a total.

    Parameters
    ----------
    counts : sequence of int
        The triangles of each mesh.
    total : int
        The largest number of triangles of all meshes after the reduction.

    Returns
    -------
    int
        At least `FEWEST`. Meshes that have fewer leave the rest to the others.

    Examples
    --------
    >>> triangle_limit([100, 5000, 9000], 8100)
    4000
    """
    left = total
    for n, count in enumerate(sorted(counts)):
        share = left // (len(counts) - n)
        if count > share:
            return max(share, FEWEST)
        left -= count
    return max(counts, default=FEWEST)


def collapsed(
    mesh: trimesh.Trimesh, triangles: int, aggressiveness: float = _AGGRESSIVENESS[0]
) -> trimesh.Trimesh:
    """Simplify a mesh by collapsing edges.

    Parameters
    ----------
    triangles : int
        Number of triangles to reduce it to.
    aggressiveness : float
        The growth rate of the tolerance while too many triangles are left.

    Returns
    -------
    trimesh.Trimesh
        A mesh with at most that many triangles, or with more if no further edge can be collapsed.

    Notes
    -----
    The method is that of Garland and Heckbert (1997), as implemented in fast-simplification.
    """
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)
    before = len(faces) + 1
    while triangles < len(faces) < before:  # a further pass starts with a small tolerance again
        before = len(faces)
        vertices, faces = fast_simplification.simplify(
            vertices, faces, target_count=triangles, agg=aggressiveness
        )
    return trimesh.Trimesh(vertices, faces, process=False)
