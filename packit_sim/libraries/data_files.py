"""Reading of data files, such as packs and manifests; `mesh_files` reads meshes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from packit_sim.core.errors import PackFormatError
from packit_sim.core.files import exists, read_whole
from packit_sim.libraries.mesh_files import SUFFIXES as MESH_SUFFIXES


def read_bytes(path: Path) -> bytes:
    """Read a file, or raise PackFormatError; a mesh file is refused by its name."""
    if path.suffix.lower() in MESH_SUFFIXES and exists(path) and path.is_file():
        raise PackFormatError(
            f"{path} is a mesh file, not a dataset: datasets are .jsonl files, or folders of such; "
            "`packit generate --library FOLDER` makes one of a folder of meshes, and "
            "`packit pack` packs meshes at their real sizes"
        )
    try:
        return read_whole(path)
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else error
        raise PackFormatError(f"data can't be read from {path}: {problem}") from None


def numbered_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the lines that are not blank, with their numbers from 1."""
    for number, line in enumerate(data.split(b"\n"), start=1):
        if line.strip():
            yield number, line
