"""STEP files, tessellated by OpenCASCADE (cascadio) in a child process: broken files crash it."""

from __future__ import annotations

import importlib.util
import io
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Container, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.core.extras import needed_for
from packit_sim.core.files import naming
from packit_sim.geometry.arrays import Ints
from packit_sim.geometry.deviation import Surface
from packit_sim.geometry.deviation_kernels import farthest
from packit_sim.geometry.parts import by_part, part_numbers
from packit_sim.libraries.mesh_limits import check_instances

SUFFIXES = (".step", ".stp")

ACCURACY = 0.001
"""Largest deviation of a tessellation by default, relative to a solid's diagonal."""

SECONDS = 300
"""CPU time of a tessellation."""

MEMORY = 8 * 2**30
"""Address space of the child process, in bytes."""

MM = 1000.0
"""Millimetres in the unit of cascadio's results, metres."""

_TRIES = (0.5, 0.1, 0.02)
"""Tolerances that are tried, relative to the largest deviation. OpenCASCADE's are no bounds."""

_FINER = 4
"""How much finer the tessellation is with which another one is compared."""

_SAFETY = 2.0
"""The deviation from the surface, relative to that of the finer tessellation's vertices: those are
on the surface, and at least one is in the middle half of each edge or triangle that is curved."""

_ROUNDING = 1e-7
"""Largest rounding, relative to the diagonal: cascadio writes 32-bit floats."""

_RUN = """
import sys
try:
    import resource
except ImportError:  # Windows, where only the time of the clock is limited
    resource = None
sys.modules["trimesh"] = None  # cascadio would import it, which takes seconds, for what is not used
import cascadio
path, seconds, memory, *tolerances = sys.argv[1:]
limits = {"RLIMIT_CORE": 0, "RLIMIT_CPU": int(seconds), "RLIMIT_AS": int(memory)}
for name, limit in limits.items() if resource else ():
    kind = getattr(resource, name)
    now = resource.getrlimit(kind)[1]  # may be lower in an import, and can't be raised
    limit = limit if now == resource.RLIM_INFINITY else min(limit, now)
    resource.setrlimit(kind, (limit, limit))
data = open(path, "rb").read()
for n, tolerance in enumerate(tolerances):
    linear, angular, relative = tolerance.split(":")
    found = cascadio.load(
        data, tol_linear=float(linear), tol_angular=float(angular), tol_relative=relative == "True"
    )
    if not found:
        break
    open(f"{path}.{n}", "wb").write(found)
"""


def tessellated(content: bytes, tolerances: Sequence[tuple[float, float, bool]]) -> list[bytes]:
    """Tessellate a STEP file.

    Parameters
    ----------
    content : bytes
        The file.
    tolerances : sequence of (float, float, bool)
        For each result: the largest distance to the surface, in mm, or if the last is true relative
        to the size of edges and faces; and the largest angle between normals, in radians.

    Returns
    -------
    list of bytes
        A GLB file of each, in metres, with the product structure.

    Raises
    ------
    MeshError
        If it can't be read.
    MissingPackageError
        If cascadio is not installed.
    """
    with needed_for("STEP files", "export as 3MF or STL"):
        if importlib.util.find_spec("cascadio") is None:
            raise ModuleNotFoundError(name="cascadio")
    with tempfile.TemporaryDirectory(prefix="packit-step-") as folder:
        path = Path(folder, "file.step")
        with naming(path):
            path.write_bytes(content)
        options = [f"{linear!r}:{angular!r}:{relative}" for linear, angular, relative in tolerances]
        try:
            run = subprocess.run(
                [sys.executable, "-P", "-c", _RUN, path, str(SECONDS), str(MEMORY), *options],
                env=dict(os.environ),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=4 * SECONDS,
            )
        except subprocess.TimeoutExpired:
            raise MeshError(f"OpenCASCADE took more than {4 * SECONDS} s for it") from None
        if run.returncode:
            why = f"signal {-run.returncode}" if run.returncode < 0 else f"status {run.returncode}"
            raise MeshError(f"OpenCASCADE crashes on it ({why}): export it again, or as 3MF or STL")
        if problem := _problem(run.stdout.decode("utf-8", "replace")):
            raise MeshError(f"it is no valid STEP file: {problem:.200}")
        results = [Path(f"{path}.{n}") for n in range(len(tolerances))]
        if not all(result.exists() for result in results):
            raise MeshError("OpenCASCADE finds no shape in it")
        return [result.read_bytes() for result in results]


def _problem(printed: str) -> str | None:
    """Return the first error in what OpenCASCADE prints, if there is one."""
    for line in printed.splitlines():
        _, found, text = line.partition("Incorrect syntax: ")
        if not found:  # such as "**** ERR StepFile : Incorrect Syntax : Fails Count : 1 ****"
            _, _, text = line.partition(" ERR ")[2].partition(" : ")
            text, found, _ = text.partition(" : Fails")
        if found:
            return text.partition("*")[0].strip()
    return None


class Solids(NamedTuple):
    """The solids of a STEP file.

    Attributes
    ----------
    scene : trimesh.Scene
        A node in mm for each solid of each product, with the name of its product.
    deviations : dict of str to float
        No point of the surface of each mesh of the scene is farther from it, in mm.
    notes : list of str
        What is not as in the product structure.
    """

    scene: trimesh.Scene
    deviations: dict[str, float]
    notes: list[str]


def solids(content: bytes, accuracy: float | None) -> Solids:
    """Read the solids of a STEP file.

    Parameters
    ----------
    content : bytes
        The file.
    accuracy : float, optional
        Largest deviation of their tessellation, in mm; by default `ACCURACY`.

    Returns
    -------
    Solids
        Its solids. OpenCASCADE promises no bound of a deviation: here it is twice that from a
        tessellation with a quarter of the tolerance.

    Raises
    ------
    MeshError
        If it can't be read, or not as accurately.
    MissingPackageError
        If cascadio is not installed.
    """
    for share in _TRIES:
        tolerance = ACCURACY * share if accuracy is None else accuracy * share
        pair = [
            (tolerance / finer, 0.5 / np.sqrt(finer).item(), accuracy is None)
            for finer in (1, _FINER)
        ]
        coarse, fine = (
            trimesh.load_scene(io.BytesIO(glb), file_type="glb", process=False)
            for glb in tessellated(content, pair)
        )
        check_instances(len(coarse.graph.nodes_geometry))
        scene, deviations = _measured(coarse, fine)
        wrong = ""
        for name, error in deviations.items():
            limit = accuracy or ACCURACY * float(np.linalg.norm(scene.geometry[name].extents))
            if error > limit:
                wrong = f"its solid {name!r} is tessellated to {error:.3g} mm, not {limit:.3g} mm"
        if not wrong:
            return Solids(scene, deviations, _notes(content, coarse, scene))
    raise MeshError(wrong)


def bodies(mesh: Any) -> list[trimesh.Trimesh]:
    """Return the solids of a product's tessellation, in mm; one has its cavities."""
    points, numbers = np.unique(np.asarray(mesh.vertices) * MM, axis=0, return_inverse=True)
    faces: Ints = numbers.reshape(-1)[np.asarray(mesh.faces, dtype=np.int64)]
    parts = part_numbers(faces, len(points))
    found = []
    for own in by_part(faces, parts):
        used, corners = np.unique(own, return_inverse=True)
        found.append(trimesh.Trimesh(points[used], corners.reshape(-1, 3), process=False))
    if any(not each.is_watertight or each.volume <= 0 for each in found):
        return [trimesh.Trimesh(points, faces, process=False)]
    return found


def _measured(coarse: trimesh.Scene, fine: trimesh.Scene) -> tuple[trimesh.Scene, dict[str, float]]:
    """Return the solids of the first, with their deviations by the second."""
    scene = trimesh.Scene()
    deviations: dict[str, float] = {}
    known: dict[bytes, list[str]] = {}
    for node in coarse.graph.nodes_geometry:
        matrix, geometry = coarse.graph[node]
        mesh = coarse.geometry[geometry]
        key = sha256(np.ascontiguousarray(mesh.vertices).tobytes()).digest()
        if key not in known:
            own, finer = bodies(mesh), bodies(fine.geometry[fine.graph[node][1]])
            known[key] = []
            for n, body in enumerate(own):
                other: Any = finer[n] if len(own) == len(finer) else trimesh.util.concatenate(finer)
                name = _numbered(str(geometry), n, deviations)
                deviations[name] = _SAFETY * _distance(other, body)
                scene.geometry[name] = body
                known[key].append(name)
        pose = np.array(matrix)
        pose[:3, 3] *= MM
        for n, name in enumerate(known[key]):
            label = _numbered(str(node), n, scene.graph.nodes)
            scene.graph.update(label, geometry=name, matrix=pose)
    return scene, deviations


def _numbered(name: str, number: int, taken: Container[str]) -> str:
    """Return a name for a solid of a product, from 0; a product may have such a name, too."""
    name = name if number == 0 else f"{name}#{number + 1}"
    while name in taken:
        name += "#"
    return name


def _distance(fine: trimesh.Trimesh, coarse: trimesh.Trimesh) -> float:
    """Return how far the vertices of the first are from the second; 0 but for rounding."""
    distance = farthest(np.ascontiguousarray(fine.vertices), Surface.of(coarse), 0.0)
    return float(distance) if distance > _ROUNDING * np.linalg.norm(coarse.extents) else 0.0


def _notes(content: bytes, coarse: trimesh.Scene, scene: trimesh.Scene) -> list[str]:
    """Return notes on what is not as in the product structure."""
    notes = []
    products, found = len(coarse.graph.nodes_geometry), len(scene.graph.nodes_geometry)
    if found > products:
        notes.append(
            f"its {products} products have {found} solids: each is a part (--joined packs the file "
            "as one)"
        )
    listed = len(re.findall(rb"=\s*(?:MANIFOLD_SOLID_BREP|BREP_WITH_VOIDS)\s*\(", content))
    if len(scene.geometry) < listed:
        notes.append(
            f"it lists {listed} solids, but {len(scene.geometry)} were found: those that touch "
            "are one, others may be missing"
        )
    return notes
