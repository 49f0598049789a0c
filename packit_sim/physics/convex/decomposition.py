"""Shapes as convex pieces, which is what can be let fall: by CoACD, and where it fails by halving.

CoACD (Wei, Liu, Ling and Su, 2022) remeshes what is no closed body and makes it thicker by that, so
that its hulls reach out of the shape on all sides; and they have few corners, so that they fall
short of what is round. They serve as regions only: the pieces are the hulls of what of the shape's
own surface is in each, or nearest to it where it is in none.
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
from importlib import metadata
from pathlib import Path

import numpy as np

from packit_sim.core.caches import bounded_cache
from packit_sim.core.errors import PhysicsError
from packit_sim.geometry.shapes import Shape
from packit_sim.physics.convex import disk_cache
from packit_sim.physics.convex.bisection import bisected
from packit_sim.physics.convex.pieces import Floats, MassProperties, Piece, covering, within
from packit_sim.physics.convex.solids import Solid
from packit_sim.physics.settings import DecompositionSettings

PIECES_BUDGET = 200_000
"""Pieces that the process's cache of decompositions holds, roughly 5 kB each."""

_FORMAT = 2
"""Of what is kept on disk: one more wherever pieces come out otherwise."""

_PATIENCE = 20
"""How many times its seconds of a processor CoACD may take by the clock."""

_RUN = """
import json, resource, sys
import numpy as np
settings, seconds = json.loads(sys.argv[2]), int(sys.argv[3])
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
    """A shape as convex pieces, in its canonical frame; none reaches out of the shape's own hull.

    overhangs: how far each reaches out of the shape (see `Solid`). method: "convex" for a shape
    that is its own hull, "coacd" or "bisection". problem: why CoACD failed, where it did.
    volume_error: of all pieces together, relative to the shape's volume: 0.1 is 10% too much.
    """

    pieces: tuple[Piece, ...]
    overhangs: tuple[float, ...]
    method: str
    problem: str | None
    volume_error: float


def decompose(shape: Shape, settings: DecompositionSettings | None = None) -> Decomposition:
    """A shape's pieces: those that are kept (see `store`), or new ones, which take a while.

    A shape whose hull fills nothing hollow is one piece. Others are CoACD's, in a process of its
    own; where that fails, of whatever kind, halving does it, and `problem` says why. Raises
    PhysicsError where CoACD is asked for and not installed.
    """
    return _kept(shape, settings or DecompositionSettings())


def require(settings: DecompositionSettings) -> None:
    """Raises PhysicsError where what makes the pieces is not installed: to ask before there is
    work.
    """
    _version(settings)


def decompose_all(
    shapes: Sequence[Shape],
    settings: DecompositionSettings | None = None,
    workers: int | None = None,
    done: Callable[[Shape, Decomposition], None] | None = None,
) -> list[Decomposition]:
    """The pieces of many shapes, several at a time, by default one a core.

    done: called after each, in the order of shapes.
    """
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        found = []
        for shape, one in zip(
            shapes, pool.map(lambda shape: decompose(shape, settings), shapes), strict=True
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
    path = disk_cache.entry("decompositions", shape.digest, _FORMAT, settings, _version(settings))
    kept = disk_cache.load(path, _read)
    if kept is None:
        kept = made(shape, settings)
        disk_cache.save(path, _arrays(kept))
    return kept


def _version(settings: DecompositionSettings) -> str:
    """Of CoACD, whose pieces may change with it."""
    if settings.method != "coacd":
        return ""
    try:
        return metadata.version("coacd")
    except metadata.PackageNotFoundError:
        raise PhysicsError(
            "convex pieces need CoACD, which is not installed: pip install 'packit-sim[physics]', "
            "or choose method 'bisection'"
        ) from None


def made(shape: Shape, settings: DecompositionSettings) -> Decomposition:
    """As `decompose`, and made anew in any case."""
    solid = Solid(shape)
    whole = Piece.around(np.asarray(shape.mesh.vertices))
    pieces, method, problem = [whole], "convex", None
    if solid.overhang(whole) > 0:
        method = settings.method
        if method == "coacd":
            pieces, problem = _by_coacd(shape, settings)
        if method == "bisection" or problem is not None:
            pieces = bisected(shape, solid, settings.overhang, settings.most)
            method = "bisection"
    return Decomposition(
        tuple(pieces),
        tuple(solid.overhang(piece) for piece in pieces),
        method,
        problem,
        MassProperties.of(pieces).volume / shape.volume - 1,
    )


def _by_coacd(shape: Shape, settings: DecompositionSettings) -> tuple[list[Piece], str | None]:
    """The pieces, or why there are none."""
    hulls, problem = _hulls(shape, settings)
    triangles = np.asarray(shape.mesh.triangles)
    inside = [within(triangles, Piece.around(hull)) for hull in hulls]
    pieces = [Piece.around(points) for points in inside if len(points)]
    if not pieces:
        return [], problem or "it found no pieces"
    return covering(pieces, triangles), problem


def _hulls(shape: Shape, settings: DecompositionSettings) -> tuple[list[Floats], str | None]:
    """The corners (n, 3) of each of CoACD's hulls, or why there are none."""
    names = ("threshold", "preprocess_resolution", "mcts_iterations", "mcts_nodes")
    told = {name: getattr(settings, name) for name in (*names, "mcts_max_depth", "seed")}
    with tempfile.TemporaryDirectory(prefix="packit-coacd-") as folder:
        np.savez(Path(folder) / "mesh.npz", vertices=shape.mesh.vertices, faces=shape.mesh.faces)
        try:
            run = subprocess.run(
                [sys.executable, "-P", "-c", _RUN, folder, json.dumps(told), str(settings.seconds)],
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_PATIENCE * settings.seconds,
            )
        except subprocess.TimeoutExpired:
            return [], f"it took more than {_PATIENCE * settings.seconds} s"
        if run.returncode == -signal.SIGXCPU:
            return [], f"it took more than {settings.seconds} s of a processor"
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
        "overhangs": np.array(decomposition.overhangs),
        "told": np.array([decomposition.method, decomposition.problem or ""]),
        "volume_error": np.array(decomposition.volume_error),
    }


def _read(arrays: disk_cache.Arrays) -> Decomposition:
    ends = np.cumsum(arrays["counts"], axis=0)[:-1]
    vertices = np.split(arrays["vertices"], ends[:, 0])
    faces = np.split(arrays["faces"], ends[:, 1])
    method, problem = arrays["told"].tolist()
    return Decomposition(
        tuple(Piece(*both) for both in zip(vertices, faces, strict=True)),
        tuple(arrays["overhangs"].tolist()),
        method,
        problem or None,
        float(arrays["volume_error"]),
    )
