"""Convex decomposition of shapes for physics: by CoACD, or by bisection if CoACD fails.

CoACD (Wei, Liu, Ling and Su, 2022) remeshes open surfaces and thickens them, so that its hulls
protrude from the shape on all sides; and its hulls have few corners, so that they cut off round
parts. They are therefore used as regions only: each piece is the convex hull of the shape's surface
inside one region, and of the surface outside all regions that is nearest to it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

import numpy as np

from packit_sim.core.caches import bounded_cache
from packit_sim.core.extras import needed_for
from packit_sim.core.plain_text import plain_logger
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.shapes import Shape
from packit_sim.physics.convex import disk_cache
from packit_sim.physics.convex.bisection import bisect
from packit_sim.physics.convex.pieces import MassProperties, Piece, covering, within
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.convex.solids import Solid

_log = plain_logger(__name__)

PIECES_BUDGET = 200_000
"""Pieces in the process's cache of decompositions, roughly 5 kB each."""

_FORMAT = 3
"""Version of the entries on disk, raised when their arrays or the pieces change."""

_PATIENCE = 20
"""Limit of CoACD's wall-clock time, relative to that of its CPU time."""

_RUN = """
import json, sys
import numpy as np
settings, seconds = json.loads(sys.argv[2]), int(sys.argv[3])
try:
    import resource
except ImportError:  # Windows, where only the time of the clock is limited
    pass
else:
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import coacd
coacd.set_log_level("off")
with np.load(sys.argv[1] + "/mesh.npz") as mesh:
    body = coacd.Mesh(mesh["vertices"], mesh["faces"])
hulls = [vertices for vertices, _ in coacd.run_coacd(body, **settings)]
np.savez(sys.argv[1] + "/hulls.npz", *hulls)
"""


@dataclass(frozen=True, eq=False)
class Decomposition:
    """A shape decomposed into convex pieces, in its canonical frame, all inside the shape's hull.

    Attributes
    ----------
    distances : tuple[float, ...]
        One-sided Hausdorff distance of each piece from the shape (see `Solid.hausdorff`).
    method : str
        "convex" for a shape that is its own hull, "coacd" or "bisection".
    problem : str | None
        Why CoACD failed, if it did.
    volume_error : float
        Error of the pieces' total volume, relative to the shape's: 0.1 is 10% too much.
    """

    pieces: tuple[Piece, ...]
    distances: tuple[float, ...]
    method: str
    problem: str | None
    volume_error: float


def decompose(shape: Shape, settings: DecompositionSettings | None = None) -> Decomposition:
    """Decompose a shape into convex pieces, or load them from the caches.

    Parameters
    ----------
    shape : Shape
        The shape. One that is as good as convex is one piece; others are decomposed by CoACD in a
        separate process, and by bisection if that fails in any way.
    settings : DecompositionSettings | None
        Settings; None for the defaults.

    Returns
    -------
    Decomposition
        The pieces.

    Raises
    ------
    MissingPackageError
        If CoACD is chosen and not installed.
    """
    settings = settings or DecompositionSettings()
    known = _kept.peek(shape, settings)
    if known is None and not is_cached(shape, settings):
        _announce()
    return known or _kept(shape, settings)


@cache
def _announce() -> None:
    """Log once in a process why a simulation takes long."""
    _log.warning(
        "new shapes are decomposed into convex pieces, which takes seconds for each, once; "
        "`packit prepare DATASET --physics` does it beforehand"
    )


def require(settings: DecompositionSettings) -> None:
    """Check before any work that the chosen method is installed.

    Parameters
    ----------
    settings : DecompositionSettings
        The settings that will be used.

    Raises
    ------
    MissingPackageError
        If CoACD is chosen and not installed.
    """
    _version(settings)


def is_cached(shape: Shape, settings: DecompositionSettings | None = None) -> bool:
    """Return whether `decompose` finds a shape in the disk cache, and so takes no time."""
    return _path(shape, settings or DecompositionSettings()).exists()


def decompose_all(
    shapes: Sequence[Shape],
    settings: DecompositionSettings | None = None,
    workers: int | None = None,
    done: Callable[[Shape, Decomposition], None] | None = None,
) -> list[Decomposition]:
    """Decompose many shapes in parallel.

    Parameters
    ----------
    settings : DecompositionSettings | None
        Settings; None for the defaults.
    workers : int | None
        Number of shapes at a time; None for one per core.
    done : Callable[[Shape, Decomposition], None] | None
        Called after each shape, in their order.

    Returns
    -------
    list[Decomposition]
        The decompositions, in the order of shapes.
    """
    settings = settings or DecompositionSettings()
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        found = []
        for shape, one in zip(
            shapes, pool.map(lambda shape: _kept(shape, settings), shapes), strict=True
        ):
            found.append(one)
            if done is not None:
                done(shape, one)
        return found


@bounded_cache(
    "decompositions",
    PIECES_BUDGET,
    "pieces",
    size=lambda decomposition: len(decomposition.pieces),
    key=lambda shape, settings: (shape.digest, settings),
)
def _kept(shape: Shape, settings: DecompositionSettings) -> Decomposition:
    path = _path(shape, settings)
    kept = disk_cache.load(path, _read)
    if kept is None:
        kept = decompose_anew(shape, settings)
        disk_cache.save(path, _arrays(kept))
    return kept


def _path(shape: Shape, settings: DecompositionSettings) -> Path:
    version = _version(settings)
    return disk_cache.entry("decompositions", shape.digest, _FORMAT, settings, version)


def _version(settings: DecompositionSettings) -> str:
    """Return the version of CoACD, on which its pieces may depend."""
    if settings.method != "coacd":
        return ""
    with needed_for(
        "convex pieces",
        "choose bisection (`--decomposition bisection`, or method='bisection' in Python)",
    ):
        return metadata.version("coacd")


def decompose_anew(shape: Shape, settings: DecompositionSettings) -> Decomposition:
    """Decompose a shape without looking into the caches."""
    solid = Solid(shape)
    whole = Piece.around(np.asarray(shape.mesh.vertices))
    pieces, method, problem = [whole], "convex", None
    if solid.hausdorff(whole) > 0:
        method = settings.method
        if method == "coacd":
            pieces, problem = by_coacd(shape, settings)
        if method == "bisection" or problem is not None:
            pieces = bisect(shape, solid, settings.hausdorff, settings.max_pieces)
            method = "bisection"
    return Decomposition(
        tuple(pieces),
        tuple(solid.hausdorff(piece) for piece in pieces),
        method,
        problem,
        MassProperties.of(pieces).volume / shape.volume - 1,
    )


def by_coacd(shape: Shape, settings: DecompositionSettings) -> tuple[list[Piece], str | None]:
    """Return the pieces, and why there are none."""
    hulls, problem = _hulls(shape, settings)
    triangles = np.asarray(shape.mesh.triangles)
    inside = [within(triangles, Piece.around(hull)) for hull in hulls]
    pieces = [Piece.around(points) for points in inside if len(points)]
    if not pieces:
        return [], problem or "it found no pieces"
    return covering(pieces, triangles), problem


def _hulls(shape: Shape, settings: DecompositionSettings) -> tuple[list[Floats], str | None]:
    """Return the corners (n, 3) of each of CoACD's hulls, and why there are none."""
    names = ("threshold", "preprocess_resolution", "mcts_iterations", "mcts_nodes")
    options = {name: getattr(settings, name) for name in (*names, "mcts_max_depth", "seed")}
    with tempfile.TemporaryDirectory(prefix="packit-coacd-") as folder:
        np.savez(Path(folder) / "mesh.npz", vertices=shape.mesh.vertices, faces=shape.mesh.faces)
        try:
            run = subprocess.run(
                [
                    sys.executable,
                    "-P",
                    "-c",
                    _RUN,
                    folder,
                    json.dumps(options),
                    str(settings.seconds),
                ],
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_PATIENCE * settings.seconds,
            )
        except subprocess.TimeoutExpired:
            return [], f"it took more than {_PATIENCE * settings.seconds} s"
        if sys.platform != "win32" and run.returncode == -signal.SIGXCPU:
            return [], f"it took more than {settings.seconds} s of CPU time"
        if run.returncode:
            return [], f"it ended with status {run.returncode}"
        with np.load(Path(folder) / "hulls.npz") as hulls:
            return [hulls[name] for name in hulls.files], None


def _arrays(decomposition: Decomposition) -> disk_cache.Arrays:
    pieces = decomposition.pieces
    return {
        "vertices": np.concatenate([piece.vertices for piece in pieces]),
        "faces": np.concatenate([piece.faces for piece in pieces]),
        "counts": np.array([(len(piece.vertices), len(piece.faces)) for piece in pieces]),
        "distances": np.array(decomposition.distances),
        "outcome": np.array([decomposition.method, decomposition.problem or ""]),
        "volume_error": np.array(decomposition.volume_error),
    }


def _read(arrays: disk_cache.Arrays) -> Decomposition:
    ends = np.cumsum(arrays["counts"], axis=0)[:-1]
    vertices = np.split(arrays["vertices"], ends[:, 0])
    faces = np.split(arrays["faces"], ends[:, 1])
    method, problem = arrays["outcome"].tolist()
    return Decomposition(
        tuple(Piece(*both) for both in zip(vertices, faces, strict=True)),
        tuple(arrays["distances"].tolist()),
        method,
        problem or None,
        float(arrays["volume_error"]),
    )
