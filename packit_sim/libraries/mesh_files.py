"""Reading of mesh files in nine formats.

lib3mf reads 3MF, `step_files` tessellates STEP, and trimesh reads the others, after the checks of
`mesh_limits`. A file is read completely or not at all, and may not refer to others outside its
folder.
"""

from __future__ import annotations

import io
import stat
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import trimesh
from trimesh.resolvers import FilePathResolver

from packit_sim.core.errors import MeshError
from packit_sim.core.extras import MissingPackageError
from packit_sim.core.length_units import UNITS_CM
from packit_sim.libraries import gltf_files, mesh_limits, step_files
from packit_sim.libraries.mesh_3mf import Plate, read_plate
from packit_sim.libraries.mesh_scenes import MeshScene
from packit_sim.libraries.obj_faces import simple_faces
from packit_sim.libraries.raw_meshes import RawMesh, RawPart

SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".step", ".stl", ".stp")
"""Suffixes of the files that can be read, in lower case."""

_T = TypeVar("_T")

Keep = Callable[[str, bytes], object]
"""Called with the name and the content of a file, and then of each other one that it refers to."""


def _no_copy(name: str, content: bytes) -> None:
    """Keep no copy of what is read."""


def read(file: Path, accuracy: float | None = None, keep: Keep = _no_copy) -> RawMesh:
    """Read a mesh file.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.
    accuracy : float, optional
        Largest deviation of the tessellation of STEP, in mm; by default `step_files.ACCURACY`.
    keep : callable, optional
        Called with what is read, for copies: each file is read only once.

    Returns
    -------
    RawMesh
        The mesh. glTF is y up and in metres, 3MF is z up, COLLADA defines both, and the others are
        assumed to be z up.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    MissingPackageError
        If it is STEP, and cascadio is not installed.
    """
    return _taken(file, accuracy, keep, lambda scene: scene.joined())


def read_parts(file: Path, accuracy: float | None = None, keep: Keep = _no_copy) -> list[RawPart]:
    """Read each part of a mesh file's scene.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.
    accuracy : float, optional
        Largest deviation of the tessellation of STEP, in mm; by default `step_files.ACCURACY`.
    keep : callable, optional
        As for `read`.

    Returns
    -------
    list of RawPart
        The scene's parts: its uppermost nodes with meshes below them, or the items of a 3MF file. A
        file without a scene has one part.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    MissingPackageError
        If it is STEP, and cascadio is not installed.
    """
    return _taken(file, accuracy, keep, lambda scene: scene.separate())


def _taken(
    file: Path, accuracy: float | None, keep: Keep, taken: Callable[[MeshScene | Plate], _T]
) -> _T:
    """Open a file's scene and apply a function to it; every error is a MeshError."""
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise MeshError(f"{file}: not a mesh file: its name must end in {', '.join(SUFFIXES)}")
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):
            raise MeshError("it is not a regular file")
        if status.st_size > mesh_limits.MAX_BYTES:
            raise MeshError(
                f"{status.st_size:,} bytes are too many: at most {mesh_limits.MAX_BYTES:,}"
            )
        content = file.read_bytes()
        keep(file.name, content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numpy and trimesh; the result is checked
            return taken(_read(content, suffix, file.parent, accuracy, keep))
    except MissingPackageError:
        raise
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from error
    except Exception as error:  # trimesh's readers raise any error for a broken file
        text = (error.strerror if isinstance(error, OSError) else None) or str(error)
        problem = text.strip() or type(error).__name__
        raise MeshError(f"{file}: can't be read as {suffix[1:].upper()}: {problem:.200}") from error


def _read(
    content: bytes, suffix: str, folder: Path, accuracy: float | None, keep: Keep
) -> MeshScene | Plate:
    if not content.strip():
        raise MeshError("the file is empty")
    if suffix in step_files.SUFFIXES:
        found = step_files.solids(content, accuracy)
        tessellation = MeshScene(
            found.scene, "z", UNITS_CM["mm"], tuple(found.notes), found.deviations
        )
        return _checked(tessellation, 0)
    expected = mesh_limits.CHECKS[suffix](content) if suffix in mesh_limits.CHECKS else 0
    if suffix == ".3mf":
        return read_plate(content)
    up, unit_cm = "z", None
    resolver = _FolderResolver(folder, keep)
    notes: list[str] = []
    if suffix in (".glb", ".gltf"):
        up, unit_cm = "y", UNITS_CM["m"]
        content, notes = gltf_files.expanded(content, suffix, resolver.get)
    elif suffix == ".dae":
        up, unit_cm = _dae_asset(content)
    elif suffix == ".obj":
        content = simple_faces(content)
    options: dict[str, Any] = {"ignore_broken": False} if suffix == ".dae" else {}
    scene = trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix[1:],
        resolver=resolver if suffix == ".gltf" else None,
        process=False,
        skip_materials=True,
        **options,
    )
    return _checked(MeshScene(scene, up, unit_cm, tuple(notes)), expected)


def _checked(found: MeshScene, expected: int) -> MeshScene:
    """Refuse a scene with too many or too few triangles, or too many meshes."""
    scene = found.scene
    meshes = {n: m for n, m in scene.geometry.items() if isinstance(m, trimesh.Trimesh)}
    placed = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
    triangles = sum(len(meshes[name].faces) for name in placed if name in meshes)
    if triangles == 0:
        raise MeshError("the file holds no triangles")
    if triangles > mesh_limits.MAX_TRIANGLES:
        raise MeshError(
            f"{triangles:,} triangles are too many: at most {mesh_limits.MAX_TRIANGLES:,}"
        )
    if triangles < expected:
        raise MeshError(f"only {triangles:,} of its {expected:,} triangles could be read")
    mesh_limits.check_instances(len(placed))
    return found


class _FolderResolver(FilePathResolver):
    """Reads the files that a glTF refers to, if they are in its folder; trimesh 4 reads any."""

    def __init__(self, folder: Path, keep: Keep) -> None:
        super().__init__(str(folder))
        self._keep = keep
        self._known: dict[str, bytes] = {}

    def get(self, name: str) -> bytes:
        folder = Path(self.parent).resolve()
        for path in (folder / name.strip(), folder / Path(name).name):
            if not path.resolve().is_relative_to(folder):
                raise MeshError(f"it refers to {name!r}, which is not in its folder")
        if name not in self._known:
            self._known[name] = super().get(name)
            self._keep(name, self._known[name])
        return self._known[name]


def _dae_asset(content: bytes) -> tuple[str, float]:
    """Return the up axis and the unit in cm of a COLLADA file, or the format's defaults."""
    root = mesh_limits.parsed(content)
    axis = root.findtext("{*}asset/{*}up_axis", "Y_UP").strip()
    if axis not in ("X_UP", "Y_UP", "Z_UP"):
        raise MeshError(f"its up axis {axis!r:.20} is none of X_UP, Y_UP, Z_UP")
    unit = root.find("{*}asset/{*}unit")
    return axis[0].lower(), UNITS_CM["m"] * float(1 if unit is None else unit.get("meter", 1))
