"""Where shapes come from: the built-in library, stored libraries, and folders of mesh files.

A stored library is a folder with a `library.json` (its name, version and digest, and a line of
metadata a shape) and `meshes/<id>.npz` files, each a mesh on a lattice of its bounding box. Shapes
are loaded when they are first asked for, and kept.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import re
import tempfile
import threading
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zipfile import BadZipFile

import trimesh

from packit_sim.caches import cached_property
from packit_sim.errors import LibraryError, MeshError, UnknownShapeError
from packit_sim.quantized import QuantizedMesh
from packit_sim.shapes import Shape

FORMAT = 1
"""Number of the stored format that this module writes, and the only one it reads."""

MESH_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")
"""Mesh files that a folder may hold. GLB is y up by its standard; the others are taken as z up."""

UNCATEGORISED = "uncategorised"
"""Category of mesh files that are in no subfolder."""

_CATALOGUE = "library.json"
_MESHES = "meshes"
_JSON_TYPES: dict[Any, type] = {"str": str, "int": int, "bool": bool, "float": float}
_UNREADABLE = (OSError, EOFError, KeyError, TypeError, ValueError, BadZipFile, zlib.error)
_ID = re.compile(r"[A-Za-z0-9][\w.-]*(/[A-Za-z0-9][\w.-]*)*", re.ASCII)


def assets_folder() -> Path:
    """The folder of the data that comes with PackIt-Sim, in a wheel or in a checkout.

    Raises LibraryError where there is neither.
    """
    package = Path(__file__).resolve().parent
    candidates = (package / "assets", package.parent / "assets")
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise LibraryError(f"the installation is incomplete: found neither of {_listed(candidates)}")


@dataclass(frozen=True)
class ShapeInfo:
    """What a library tells about a shape without loading its mesh.

    licence: SPDX identifier. source: where the mesh is from. size_cm: the object's real extents
    along x, y, z, where known. triangles: how many. solid: whether the mesh is one closed body.
    volume: in canonical units. error_bound: how far, in canonical units, the mesh may be from the
    one it was made of.
    """

    id: str
    category: str
    title: str
    author: str
    licence: str
    source: str
    size_cm: tuple[float, float, float] | None
    triangles: int
    solid: bool
    volume: float
    error_bound: float


@dataclass(frozen=True)
class Entry:
    """A shape to store, and what only its maker knows about it (see `ShapeInfo`)."""

    shape: Shape
    title: str = ""
    author: str = ""
    licence: str = ""
    source: str = ""
    size_cm: tuple[float, float, float] | None = None
    error_bound: float = 0.0


class ShapeLibrary(ABC):
    """Shapes by id, in categories: `library[id]` is a Shape, loaded once; iterates over ids.

    name, version: what packs refer to (a folder of meshes has no version). path: its folder.
    ids: sorted. categories: the ids of each category, both sorted. Safe to share among threads,
    and cheap to send to another process, which opens it again.
    """

    def __init__(self, path: Path, name: str, version: str, categories: Mapping[str, str]) -> None:
        """Takes the category of each id; `open` finds out which library a source is."""
        self.path = path
        self.name = name
        self.version = version
        self.ids = tuple(sorted(categories))
        self.categories: Mapping[str, tuple[str, ...]] = MappingProxyType(
            {
                category: tuple(id for id in self.ids if categories[id] == category)
                for category in sorted(set(categories.values()))
            }
        )
        self._category = dict(categories)
        self._shapes: dict[str, Shape] = {}
        self._lock = threading.RLock()

    @staticmethod
    def open(source: str | Path) -> ShapeLibrary:
        """The library of this name or at this path.

        source: the name of a built-in library ("everyday"), or a folder that holds a stored library
        or mesh files. In a folder of mesh files the id is the path without its suffix, and the
        category the subfolder. Raises LibraryError where there is no such library or it is damaged.
        """
        folder = Path(source)
        if isinstance(source, str) and source in builtin_names():
            folder = assets_folder() / source
        elif source == "" or not folder.is_dir():
            raise LibraryError(
                f"no shape library {str(source)!r}: it is neither built in "
                f"({', '.join(builtin_names())}) nor a folder"
            )
        if (folder / _CATALOGUE).exists():
            return _StoredLibrary(folder)
        return _MeshFolder(folder)

    @staticmethod
    def write(path: str | Path, name: str, version: str, entries: Iterable[Entry]) -> None:
        """Store a library at path, all of it or nothing; an older one there is replaced.

        Raises LibraryError where an id is doubled or no plain path, where there is nothing to
        store, or where path holds anything but a stored library; MeshError for a flat mesh.
        """
        path = Path(path).absolute()
        _require_replaceable(path)
        infos: dict[str, tuple[ShapeInfo, str]] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as staging:
            new, old = Path(staging) / "new", Path(staging) / "old"
            new.mkdir()
            for entry in entries:
                _require_new_id(entry.shape.id, infos)
                mesh = QuantizedMesh.of(entry.shape)
                mesh.save(new / _MESHES / f"{entry.shape.id}.npz")
                shape = Shape(mesh.mesh(), entry.shape.id, entry.shape.category)
                infos[shape.id] = _info(shape, entry), shape.digest
            if not infos:
                raise LibraryError(f"{path}: a library needs at least one shape")
            (new / _CATALOGUE).write_text(_catalogue(name, version, infos), encoding="utf-8")
            if path.exists():
                path.rename(old)
            try:
                new.rename(path)
            except OSError:
                if old.exists():
                    old.rename(path)
                raise

    @property
    @abstractmethod
    def digest(self) -> str:
        """SHA-256, in hex, of the ids and the digests of their geometry, or of their mesh files."""

    @abstractmethod
    def info(self, id: str) -> ShapeInfo:
        """What is known about a shape. Raises UnknownShapeError, and whatever loading it raises."""

    @abstractmethod
    def _load(self, id: str) -> Shape: ...

    def __getitem__(self, id: str) -> Shape:
        """The shape of this id.

        Raises UnknownShapeError where there is none, MeshError where its mesh file is no shape, and
        LibraryError where its stored mesh is not the one that was written.
        """
        self._require(id)
        with self._lock:
            if id not in self._shapes:
                self._shapes[id] = self._load(id)
            return self._shapes[id]

    def __contains__(self, id: object) -> bool:
        return id in self._category

    def __iter__(self) -> Iterator[str]:
        return iter(self.ids)

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return (
            f"ShapeLibrary({self.name!r}, {len(self)} shapes in {len(self.categories)} categories)"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return ShapeLibrary.open, (self.path,)

    def _require(self, id: str) -> None:
        if id not in self._category:
            close = difflib.get_close_matches(str(id), self.ids, n=3, cutoff=0.4)
            hint = f"did you mean {_listed(close)}?" if close else f"it holds {_listed(self.ids)}"
            raise UnknownShapeError(f"no shape {id!r} in library {self.name!r}: {hint}")


class _StoredLibrary(ShapeLibrary):
    """A folder that `ShapeLibrary.write` wrote."""

    def __init__(self, folder: Path) -> None:
        catalogue = folder / _CATALOGUE
        try:
            content = json.loads(catalogue.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise LibraryError(f"{catalogue}: can't be read as a shape library: {error}") from error
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            found = content.get("format") if isinstance(content, dict) else content
            raise LibraryError(
                f"{catalogue}: not a shape library of format {FORMAT}, its format is {found!r:.40}"
            )
        try:
            pairs = [_parsed(line) for line in content["shapes"]]
            digests = {info.id: digest for info, digest in pairs}
            name, version, self._digest = (content[k] for k in ("name", "version", "digest"))
            if not (isinstance(name, str) and isinstance(version, str)):
                raise TypeError(f"name {name!r}, version {version!r}")
        except (KeyError, TypeError, ValueError) as error:
            raise LibraryError(f"{catalogue}: damaged: {error!r}") from error
        if not digests or len(digests) < len(pairs) or _digest(digests) != self._digest:
            raise LibraryError(
                f"{catalogue}: damaged: its shapes don't match its digest {self._digest!r:.70}"
            )
        self._infos = {info.id: info for info, _ in pairs}
        self._digests = digests
        super().__init__(folder, name, version, {i.id: i.category for i in self._infos.values()})

    @property
    def digest(self) -> str:
        return self._digest

    def info(self, id: str) -> ShapeInfo:
        self._require(id)
        return self._infos[id]

    def _load(self, id: str) -> Shape:
        file = self.path / _MESHES / f"{id}.npz"
        info = self._infos[id]
        try:
            shape = Shape(QuantizedMesh.load(file).mesh(), id, info.category, info.volume)
        except _UNREADABLE as error:
            raise LibraryError(f"{file}: not the mesh of {id!r}: {error!r}") from error
        if shape.digest != self._digests[id]:
            raise LibraryError(
                f"{file}: not the mesh of {id!r}: its digest is {shape.digest}, "
                f"not {self._digests[id]}"
            )
        return shape


class _MeshFolder(ShapeLibrary):
    """A folder of mesh files, as they come."""

    def __init__(self, folder: Path) -> None:
        self._files: dict[str, Path] = {}
        for file in sorted(folder.rglob("*")):
            inside = file.relative_to(folder)
            hidden = any(part.startswith(".") for part in inside.parts)
            if hidden or file.suffix.lower() not in MESH_SUFFIXES or not file.is_file():
                continue
            id = inside.with_suffix("").as_posix()
            if id in self._files:
                raise LibraryError(
                    f"{folder}: {self._files[id].name} and {file.name} "
                    f"would both be shape {id!r}: rename one"
                )
            self._files[id] = file
        if not self._files:
            raise LibraryError(
                f"{folder}: neither {_CATALOGUE} nor a mesh file ({', '.join(MESH_SUFFIXES)})"
            )
        categories = {id: id.rpartition("/")[0] or UNCATEGORISED for id in self._files}
        super().__init__(folder, folder.resolve().name, "", categories)

    @cached_property
    def digest(self) -> str:
        return _digest(
            {id: hashlib.sha256(file.read_bytes()).hexdigest() for id, file in self._files.items()}
        )

    def info(self, id: str) -> ShapeInfo:
        shape = self[id]
        return _info(shape, Entry(shape, self._files[id].stem, source=str(self._files[id])))

    def _load(self, id: str) -> Shape:
        file = self._files[id]
        up = "y" if file.suffix.lower() == ".glb" else "z"
        try:
            mesh = trimesh.load_scene(file, process=False, skip_materials=True).to_mesh()
            return Shape.from_mesh(mesh, id, self._category[id], up=up)
        except MeshError as error:
            raise MeshError(f"{file}: {error}") from error
        except Exception as error:  # trimesh's readers raise whatever a broken file makes them hit
            raise MeshError(f"{file}: can't be read as a mesh: {error!r}") from error


def builtin_names() -> tuple[str, ...]:
    """Names of the libraries that come with PackIt-Sim."""
    return tuple(sorted(file.parent.name for file in assets_folder().glob(f"*/{_CATALOGUE}")))


def _info(shape: Shape, entry: Entry) -> ShapeInfo:
    return ShapeInfo(
        id=shape.id,
        category=shape.category,
        title=entry.title,
        author=entry.author,
        licence=entry.licence,
        source=entry.source,
        size_cm=entry.size_cm,
        triangles=len(shape.mesh.faces),
        solid=shape.is_solid,
        volume=shape.volume,
        error_bound=float(entry.error_bound),
    )


def _digest(digests: Mapping[str, str]) -> str:
    lines = "".join(f"{id} {digests[id]}\n" for id in sorted(digests))
    return hashlib.sha256(lines.encode()).hexdigest()


def _catalogue(name: str, version: str, infos: Mapping[str, tuple[ShapeInfo, str]]) -> str:
    """The content of `library.json`, with each shape on a line of its own."""
    digest = _digest({id: digest for id, (_, digest) in infos.items()})
    head = json.dumps(
        {"format": FORMAT, "name": name, "version": version, "digest": digest}, indent=1
    )
    shapes = ",\n".join(
        json.dumps({**asdict(infos[id][0]), "digest": infos[id][1]}, ensure_ascii=False)
        for id in sorted(infos)
    )
    return f'{head[:-2]},\n "shapes": [\n{shapes}\n ]\n}}\n'


def _parsed(line: dict[str, Any]) -> tuple[ShapeInfo, str]:
    """A shape's metadata and digest. Raises KeyError, TypeError or ValueError where it is none."""
    values = {field.name: line[field.name] for field in fields(ShapeInfo)}
    for field in fields(ShapeInfo):
        if field.type in _JSON_TYPES and type(values[field.name]) is not _JSON_TYPES[field.type]:
            raise TypeError(f"{field.name} {values[field.name]!r} of {values['id']!r}")
    if values["size_cm"] is not None:
        x, y, z = map(float, values["size_cm"])
        values["size_cm"] = (x, y, z)
    info = ShapeInfo(**values)
    if not _ID.fullmatch(info.id):
        raise ValueError(f"shape id {info.id!r}")
    if not (math.isfinite(info.volume) and 0 < info.volume <= 1):
        raise ValueError(f"volume {info.volume!r} of {info.id!r}")
    return info, line["digest"]


def _require_new_id(id: str, taken: Iterable[str]) -> None:
    if not _ID.fullmatch(id):
        raise LibraryError(
            f"shape id {id!r} can't be stored: letters, digits, '_', '-', '.' and '/' only, "
            "each part beginning with a letter or a digit"
        )
    if id.casefold() in (other.casefold() for other in taken):
        raise LibraryError(f"shape id {id!r} is there twice")


def _require_replaceable(path: Path) -> None:
    if path.is_dir():
        strange = sorted({file.name for file in path.iterdir()} - {_CATALOGUE, _MESHES})
        if not strange:
            return
        raise LibraryError(f"{path}: won't be replaced, it holds more than a library: {strange[0]}")
    if path.exists():
        raise LibraryError(f"{path}: won't be replaced, it is a file")


def _listed(values: Iterable[object], most: int = 8) -> str:
    """Values for a message, not too many of them."""
    texts = [str(value) for value in values]
    more = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {more} more" if more > 0 else "")
