"""Stored libraries: compact, checked, and the same on every machine.

A stored library is a folder with `library.json` (name, version, digest, and a line of metadata for
each shape), `splits.json` (the ids of each split) and `meshes/<id>.npz`, each a mesh on a lattice
of its bounding box.
"""

from __future__ import annotations

import glob
import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TypeVar

from msgspec import Struct, structs

from packit_sim.core import typed_json
from packit_sim.core.choices import SPLITS
from packit_sim.core.errors import LibraryError, MeshError, located
from packit_sim.core.files import exchange, naming, read_whole
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries import splits
from packit_sim.libraries.raw_meshes import RawMesh
from packit_sim.libraries.sources import Candidate, ShapeInfo, SizeCm, Source

FORMAT = 2
"""The version of the stored format, the only one that this module reads."""

FORMER_DIGESTS = {
    "f6967b831781d63b62a9c6c01185d18b792fcbedb13159eb36715bea2c11d681": (
        "b520704631d3fd27a346d763acc9566aab1a4e36c6b593a5df0e700b902265cc"
    ),
}
"""Digests by which packs and results know the same content since before digests covered volumes,
categories, groups and splits: of the built-in library."""

CATALOGUE = "library.json"

_SPLITS = "splits.json"
_MESHES = "meshes"
_ID = re.compile(r"\w[\w.-]*(/\w[\w.-]*)*")
_UNFIT = re.compile(r"[^\w./-]+")


T = TypeVar("T")


class _Catalogue(Struct):
    """The content of `library.json`."""

    name: str
    version: str
    digest: str
    shapes: tuple[ShapeInfo, ...]

    def __post_init__(self) -> None:
        for info in self.shapes:
            if not is_id(info.id):
                raise ValueError(f"shape id {info.id!r} is not possible")


class _Splits(Struct):
    """The content of `splits.json`: the ids of each split."""

    train: tuple[str, ...]
    test: tuple[str, ...]
    validation: tuple[str, ...]


class StoredLibrary(Source):
    """A folder that `write` wrote.

    Raises
    ------
    LibraryError
        If its catalogue is damaged or has another format.
    """

    is_catalogued = True

    def __init__(self, folder: Path) -> None:
        catalogue = folder / CATALOGUE
        content = _read(catalogue, _Catalogue)
        infos = content.shapes
        name, version, self._digest = content.name, content.version, content.digest
        self._infos = {info.id: info for info in infos}
        self._splits = _read_splits(folder / _SPLITS, self._infos)
        unique = len(self._infos) == len(infos) > 0
        if not unique or not _is_digest(self._digest, self._infos, self._splits):
            raise LibraryError(
                f"{catalogue}: damaged: its shapes don't match its digest {self._digest!r:.70}"
            )
        super().__init__(folder, name, version, {info.id: info.category for info in infos})

    @property
    def locator(self) -> str:
        return str(self.path)

    @property
    def digest(self) -> str:
        return self._digest

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        return self._splits

    def candidate(self, id: str) -> Candidate:
        info = self._infos[id]
        return Candidate(
            id,
            info.category,
            partial(_raw, self._file(id)),
            title=info.title,
            author=info.author,
            licence=info.licence,
            source=info.source,
            size_cm=info.size_cm,
            group=info.group,
        )

    def info(self, id: str) -> ShapeInfo:
        return self._infos[id]

    def load(self, id: str) -> Shape:
        """Load the shape of an id without the cache, or raise LibraryError if it is damaged."""
        file, info = self._file(id), self._infos[id]
        try:
            shape = Shape(QuantizedMesh.load(file).mesh(), id, info.category, info.volume)
        except MeshError as error:
            raise LibraryError(f"{file}: not the mesh of {id!r}: {error}") from error
        if shape.digest != info.digest:
            raise LibraryError(
                f"{file}: not the mesh of {id!r}: its digest is {shape.digest}, not {info.digest}"
            )
        return shape

    def _file(self, id: str) -> Path:
        return self.path / _MESHES / f"{id}.npz"


def write(
    path: str | Path,
    name: str,
    version: str,
    shapes: Iterable[tuple[QuantizedMesh, ShapeInfo]],
    split: Callable[[Mapping[str, ShapeInfo]], Mapping[str, tuple[str, ...]]] | None = None,
) -> None:
    """Store a library, completely or not at all.

    Parameters
    ----------
    path : str or Path
        The folder; a stored library there is replaced.
    name : str
        The library's name.
    shapes : iterable of tuple
        The mesh and the metadata of each shape (see `entry`).
    split : callable, optional
        Returns the ids of each split; by default `divide` with seed 0.

    Raises
    ------
    LibraryError
        If an id occurs twice or is not `is_id`, if there are no shapes, or if the path has anything
        but a stored library.
    """
    path = Path(path).absolute()
    require_replaceable(path)
    infos: dict[str, ShapeInfo] = {}
    taken: set[str] = set()
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=_staging_prefix(path), dir=path.parent) as staging:
        new, old = Path(staging) / "new", Path(staging) / "old"
        new.mkdir()
        for mesh, info in shapes:
            _require_new_id(info.id, taken)
            taken.add(info.id.casefold())
            mesh.save(new / _MESHES / f"{info.id}.npz")
            infos[info.id] = info
        if not infos:
            raise LibraryError(f"{path}: a library needs at least one shape")
        divided = (split or divide)(infos)
        text = json.dumps({"format": FORMAT, **divided}, ensure_ascii=False, indent=1)
        with naming(path):
            catalogue = _catalogue(name, version, infos, divided)
            (new / CATALOGUE).write_text(catalogue, encoding="utf-8")
            (new / _SPLITS).write_text(text + "\n", encoding="utf-8")
        if path.exists():
            try:
                exchange(new, path)
            except OSError:
                _replace_in_steps(path, new, old)
        else:
            new.rename(path)


def remove_unfinished(path: Path) -> None:
    """Remove what killed processes left when they wrote a library; the caller has its lock.

    Where folders can't be exchanged in one step, a library that was about to be replaced is
    restored.

    Parameters
    ----------
    path : Path
        The library's folder.
    """
    path = path.absolute()
    for staging in path.parent.glob(f"{glob.escape(_staging_prefix(path))}*"):
        if (staging / "old").exists() and not path.exists():
            (staging / "old").rename(path)
        shutil.rmtree(staging, ignore_errors=True)


def _replace_in_steps(path: Path, new: Path, old: Path) -> None:
    """Replace a folder where the file system can't exchange two."""
    path.rename(old)
    try:
        new.rename(path)
    except OSError:
        old.rename(path)
        raise


def _staging_prefix(path: Path) -> str:
    """Return the prefix of the names of folders in which a library is written."""
    return f".{path.name}.importing-"


def entry(
    shape: Shape,
    title: str = "",
    author: str = "",
    licence: str = "",
    source: str = "",
    size_cm: SizeCm | None = None,
    error_bound: float = 0.0,
) -> tuple[QuantizedMesh, ShapeInfo]:
    """Return the mesh and the metadata of a shape (see `ShapeInfo`) for `write`."""
    mesh = QuantizedMesh.of(shape)
    kept = Shape(mesh.mesh(), shape.id, shape.category)
    read = partial(RawMesh, kept.mesh)
    candidate = Candidate(shape.id, shape.category, read, title, author, licence, source, size_cm)
    return mesh, candidate.info(kept, error_bound)


def divide(infos: Mapping[str, ShapeInfo], seed: int = 0) -> dict[str, tuple[str, ...]]:
    """Divide all shapes of a library into splits."""
    return splits.divide(
        {id: info.category for id, info in infos.items()},
        {id: info.group for id, info in infos.items()},
        seed,
        max_shapes=max(1, len(infos)),
    )


def is_id(id: str) -> bool:
    """Return whether a shape can be stored under an id.

    Parameters
    ----------
    id : str
        The id. Letters and digits of any script, `_`, `-`, `.` and `/` are valid, and each part
        begins with a letter, a digit or `_`.

    Returns
    -------
    bool
        Whether the id is valid.
    """
    return _ID.fullmatch(id) is not None


def as_id(text: str) -> str:
    """Return the id that is most similar to a text, or "" if no character of it is valid."""
    parts = (part.strip("-.") for part in _UNFIT.sub("-", text).split("/"))
    return "/".join(part for part in parts if part)


def require_replaceable(path: Path) -> None:
    """Raise LibraryError if there is anything but a stored library at a path."""
    if path.is_dir():
        known = {CATALOGUE, _SPLITS, _MESHES}
        strange = sorted({file.name for file in path.iterdir()} - known)
        if not strange:
            return
        raise LibraryError(f"{path}: won't be replaced, it holds more than a library: {strange[0]}")
    if path.exists():
        raise LibraryError(f"{path}: won't be replaced, it is a file")


def _raw(file: Path) -> RawMesh:
    try:
        return RawMesh(QuantizedMesh.load(file).mesh())
    except MeshError as error:
        raise LibraryError(f"{file}: {error}") from error


def _read(file: Path, kind: type[T]) -> T:
    """Read a file of this format, or raise LibraryError that names it and the wrong field."""
    try:
        data = read_whole(file)
    except OSError as error:
        raise LibraryError(f"{file}: can't be read as a shape library: {error.strerror}") from error
    with located(f"{file}: damaged", LibraryError):
        number = typed_json.format_of(data, LibraryError, "a library")
        if number == FORMAT:
            return typed_json.decode(data, kind, LibraryError, "a library")
    raise LibraryError(
        f"{file}: not a shape library of format {FORMAT}, its format is {number!r:.40}"
    )


def _read_splits(file: Path, infos: Mapping[str, ShapeInfo]) -> dict[str, tuple[str, ...]]:
    """Read `splits.json`, or raise LibraryError if it is not of the library's shapes."""
    found = structs.asdict(_read(file, _Splits))
    strange = [id for ids in found.values() for id in ids if id not in infos]
    if strange:
        raise LibraryError(f"{file}: damaged: the library has no shape {strange[0]!r}")
    groups = [{infos[id].group for id in ids} for ids in found.values()]
    if sum(map(len, groups)) > len(set().union(*groups)):
        raise LibraryError(f"{file}: damaged: it has an object in two splits")
    return found


def _digest(infos: Mapping[str, ShapeInfo], divided: Mapping[str, Sequence[str]]) -> str:
    """Compute the digest of everything that changes a result."""
    shapes = [
        (info.id, info.category, info.group, info.volume, info.digest)
        for _, info in sorted(infos.items())
    ]
    facts = [shapes, {name: list(divided[name]) for name in SPLITS}]
    digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()
    return FORMER_DIGESTS.get(digest, digest)


def _is_digest(
    digest: str, infos: Mapping[str, ShapeInfo], divided: Mapping[str, Sequence[str]]
) -> bool:
    """Return whether a digest is that of a library, by this version or a former one."""
    if digest == _digest(infos, divided):
        return True
    lines = "".join(f"{id} {infos[id].digest}\n" for id in sorted(infos))
    geometry = hashlib.sha256(lines.encode()).hexdigest()
    return digest == geometry and geometry not in FORMER_DIGESTS.values()


def _catalogue(
    name: str,
    version: str,
    infos: Mapping[str, ShapeInfo],
    divided: Mapping[str, Sequence[str]],
) -> str:
    """Return the content of `library.json`, with a line for each shape."""
    digest = _digest(infos, divided)
    head = json.dumps(
        {"format": FORMAT, "name": name, "version": version, "digest": digest}, indent=1
    )
    shapes = ",\n".join(
        json.dumps(asdict(info), ensure_ascii=False) for _, info in sorted(infos.items())
    )
    return f'{head[:-2]},\n "shapes": [\n{shapes}\n ]\n}}\n'


def _require_new_id(id: str, taken: Container[str]) -> None:
    if not is_id(id):
        raise LibraryError(
            f"shape id {id!r} can't be stored: letters, digits, '_', '-', '.' and '/' only, "
            "each part beginning with a letter, a digit or '_'"
        )
    if id.casefold() in taken:
        raise LibraryError(f"shape id {id!r} occurs twice")
