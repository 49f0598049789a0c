"""A folder of mesh files as a source of shapes, without repairs."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import LibraryError
from packit_sim.core.files import digest_of
from packit_sim.libraries import mesh_files
from packit_sim.libraries.sources import Candidate, Source

UNCATEGORISED = "uncategorised"
"""Category of mesh files that are not in a subfolder."""

MAX_ENTRIES = 100_000
"""Maximum number of files and folders in a folder: a manifest may refer to any, even to the root of
a disk."""


class MeshFolder(Source):
    """Mesh files in a folder: the id is the path without its suffix, the category the subfolder.

    If two files would have the same id, as mug.obj and mug.stl, each keeps its suffix. Hidden files
    and folders are ignored. The digest is of the files' content.

    Raises
    ------
    LibraryError
        If there is no mesh file, or there are more than `MAX_ENTRIES` files and folders.
    """

    def __init__(self, folder: Path) -> None:
        files = sorted(_mesh_files(folder))
        if not files:
            raise LibraryError(
                f"{folder}: neither library.json nor a mesh file ({', '.join(mesh_files.SUFFIXES)})"
            )
        count = Counter(file.with_suffix("") for file in files)
        self._files = {
            (file.with_suffix("") if count[file.with_suffix("")] == 1 else file)
            .relative_to(folder)
            .as_posix(): file
            for file in files
        }
        categories = {id: id.rpartition("/")[0] or UNCATEGORISED for id in self._files}
        super().__init__(folder, folder.resolve().name, "", categories)

    @property
    def locator(self) -> str:
        return f"folder:{self.path}"

    @cached_property
    def digest(self) -> str:
        sha = hashlib.sha256()
        for id, file in sorted(self._files.items()):
            content = digest_of(file)
            sha.update(f"{id} {content}\n".encode())
        return sha.hexdigest()

    def candidate(self, id: str) -> Candidate:
        file = self._files[id]
        read = partial(mesh_files.read, file)
        return Candidate(id, self.categories[id], read, title=file.stem, source=str(file))


def _mesh_files(folder: Path) -> Iterator[Path]:
    """Yield the mesh files of a folder that are not hidden."""
    entries = 0
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        entries += len(folders) + len(files)
        if entries > MAX_ENTRIES:
            raise LibraryError(
                f"{folder}: has more than {MAX_ENTRIES:,} files: open a folder in it"
            )
        for name in files:
            file = Path(path, name)
            if (
                not name.startswith(".")
                and file.suffix.lower() in mesh_files.SUFFIXES
                and file.is_file()
            ):
                yield file
