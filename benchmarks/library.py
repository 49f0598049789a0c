"""Measure opening, importing and voxelising of shapes, and the accuracy of volumes.

    .venv/bin/python -m benchmarks.library

Medians of one run. Prints a table, and writes `benchmarks/results/library.json`.
"""

from __future__ import annotations

import resource
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from rich.console import Console
from trimesh import creation

from benchmarks.common import (
    argument_parser,
    machine,
    milliseconds,
    summaries,
    summary_table,
    write_json,
)
from packit_sim import Item, Shape, ShapeLibrary
from packit_sim.game.datasets.evolution_settings import SCALES
from packit_sim.geometry.deviation import deviation
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.simplification import Simplification
from packit_sim.geometry.voxels import Voxels
from packit_sim.libraries import mesh_files
from packit_sim.libraries.importer import ImportSettings, import_library
from packit_sim.libraries.sources import Candidate

HUGE = 8
"""Subdivisions of the imported icosphere: 1,310,720 triangles."""


def time_everyday(library: ShapeLibrary) -> dict[str, list[float]]:
    """Time opening the library, loading each shape, and voxelising it at each scale."""
    ShapeLibrary.open("everyday")
    times = {
        "open": [milliseconds(lambda: ShapeLibrary.open("everyday")) for _ in range(21)],
        "open, and a split": [
            milliseconds(lambda: ShapeLibrary.open("everyday").split("train")) for _ in range(21)
        ],
        "load a shape": [milliseconds(partial(library.source.load, id)) for id in library],
    }
    for scale in SCALES:
        items = [Item(library[id], scale) for id in library]
        triangles = [item.mesh.triangles for item in items]
        times[f"voxelise at scale {scale:g}"] = [
            milliseconds(partial(Voxels.of, corners, item.cells))
            for corners, item in zip(triangles, items, strict=True)
        ]
    return times


def bumpy(subdivisions: int) -> trimesh.Trimesh:
    """Create a ball with waves on it, without two equal triangles."""
    ball = creation.icosphere(subdivisions=subdivisions)
    x, y, z = ball.vertices.T
    waves = 1 + 0.05 * np.sin(9 * x) * np.sin(11 * y) * np.sin(7 * z)
    return trimesh.Trimesh(ball.vertices * waves[:, None], ball.faces, process=False)


def time_import_steps(mesh: trimesh.Trimesh, folder: Path) -> dict[str, list[float]]:
    """Time each step of an import."""
    file = folder / "mesh.ply"
    mesh.export(file)
    shape, _ = Shape.repaired(mesh, "mesh")
    kept, _ = Simplification(eager=True)(shape)
    return {
        "read": [milliseconds(partial(mesh_files.read, file))],
        "repair": [milliseconds(partial(Shape.repaired, mesh, "mesh"))],
        "reduce and bound": [milliseconds(partial(Simplification(eager=True), shape))],
        "bound alone": [milliseconds(partial(deviation, shape.mesh, kept.mesh()))],
    }


def import_huge(folder: Path) -> dict[str, Any]:
    """Import a mesh of more than a million triangles, in a separate process."""
    result = {}
    mesh = bumpy(HUGE)
    for suffix in ("ply", "stl", "obj"):
        file = folder / f"huge.{suffix}"
        mesh.export(file)
        candidate = Candidate("huge", "ball", partial(mesh_files.read, file))
        settings = ImportSettings(workers=1, timeout=900)
        started = time.perf_counter()
        (outcome,) = import_library([candidate], folder / "lib", "huge", "", settings)
        seconds = time.perf_counter() - started
        assert outcome.info is not None, outcome.problem
        result[suffix] = {
            "triangles": outcome.triangles_read,
            "kept": outcome.info.triangles,
            "error bound": outcome.info.error_bound,
            "file, MB": file.stat().st_size / 2**20,
            "seconds": seconds,
        }
        file.unlink()
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return result | {"peak memory, MB": peak}


def volume_errors(library: ShapeLibrary) -> dict[str, Any]:
    """Measure errors of volumes by voxels, for shapes whose exact volume is known."""
    ids = [id for id in library if library.info(id).solid]
    errors = {id: sum(library[id].volume_bounds) / 2 / library[id].volume - 1 for id in ids}
    worst = max(errors, key=lambda id: abs(errors[id]))
    sizes = np.abs(list(errors.values()))
    return {
        "shapes": len(ids),
        "median": float(np.median(sizes)),
        "p90": float(np.quantile(sizes, 0.9)),
        "worst": float(sizes.max()),
        "worst of": worst,
        "mean, signed": float(np.mean(list(errors.values()))),
    }


def main() -> None:
    parser = argument_parser(__doc__)
    arguments = parser.parse_args()
    console = Console(width=100)
    library = ShapeLibrary.open("everyday")
    with console.status("measuring"), tempfile.TemporaryDirectory() as folder:
        Voxels.of(creation.box().triangles * 0.1, (12, 12, 12))  # compiles
        QuantizedMesh.of(library[library.ids[0]])
        times = summaries(time_everyday(library))
        step_times = {
            f"{20 * 4**subdivisions:,} triangles": summaries(
                time_import_steps(bumpy(subdivisions), Path(folder))
            )
            for subdivisions in (4, 6, HUGE)
        }
        result = {
            "command": "python -m benchmarks.library",
            "library": {"name": library.name, "shapes": len(library), "digest": library.digest},
            "machine": machine(),
            "everyday, ms": times,
            "import steps, ms": step_times,
            "huge": import_huge(Path(folder)),
            "volume by voxels, relative error": volume_errors(library),
        }
    console.print(summary_table(times, "measure", "median, ms", ".2f"))
    for part in ("import steps, ms", "huge", "volume by voxels, relative error"):
        console.print(part, result[part])
    write_json(arguments.out / "library.json", result)


if __name__ == "__main__":
    main()
