"""Shape libraries: shapes by id and category, all of them or those of one split."""

from __future__ import annotations

import difflib
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import MappingProxyType
from typing import Any

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.assets import assets_folder
from packit_sim.core.choices import SPLITS, Split
from packit_sim.core.entry_points import announced, load
from packit_sim.core.errors import LibraryError, MeshError, UnknownShapeError
from packit_sim.core.files import exists
from packit_sim.core.plain_text import listed
from packit_sim.core.suggestions import did_you_mean
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.folder import MeshFolder
from packit_sim.libraries.shapenet import TAXONOMY, ShapeNet
from packit_sim.libraries.sources import ShapeInfo, Source
from packit_sim.libraries.stored import CATALOGUE, StoredLibrary

SCHEMES = ("folder", "shapenet")
"""Prefixes of a path, followed by a colon, that name the kind of library."""

SOURCES = "packit_sim.shape_sources"
"""Entry points of other packages: a scheme, and a function of a path that returns a `Source`."""


class ShapeLibrary:
    """Shapes by id, in categories: `library[id]` is a Shape; iterates over ids.

    A library is safe to share among threads, and cheap to send to another process, which opens it
    again.

    Parameters
    ----------
    source : Source
        The source; `open` finds it by name or path.
    split : str, optional
        The split to which the library is restricted.
    unreadable : mapping of str to str, optional
        Ids to leave out, with the reasons; see `readable`.

    Attributes
    ----------
    ids : tuple of str
        The ids, sorted.
    categories : mapping of str to tuple of str
        The ids of each category, both sorted.

    Examples
    --------
    >>> from packit_sim import ShapeLibrary
    >>> library = ShapeLibrary.open("everyday")
    >>> len(library), len(library.categories)
    (628, 72)
    >>> library[library.categories["mug"][0]]
    Shape('beer-mug', 'mug', 2371 triangles)
    >>> len(library.split("test"))
    209
    """

    def __init__(
        self, source: Source, split: str | None = None, unreadable: Mapping[str, str] | None = None
    ) -> None:
        self.source = source
        self._split: Any = split
        self._unreadable = dict(unreadable or {})
        ids = source.splits[split] if split else source.categories
        self.ids = tuple(sorted(id for id in ids if id not in self._unreadable))
        self._ids = frozenset(self.ids)
        members: dict[str, list[str]] = defaultdict(list)
        for id in self.ids:
            members[source.categories[id]].append(id)
        self.categories: Mapping[str, tuple[str, ...]] = MappingProxyType(
            {name: tuple(ids) for name, ids in sorted(members.items())}
        )

    @staticmethod
    def open(source: str | Path, *, seed: int = 0) -> ShapeLibrary:
        """Open a library by name or path.

        Parameters
        ----------
        source : str or Path
            The name of a built-in library ("everyday"); the path of a stored library or of a folder
            of mesh files; or "SCHEME:PATH", where the scheme is "folder", "shapenet" or that of an
            installed package.
        seed : int, default: 0
            The seed of ShapeNet's splits; other libraries store theirs or have none.

        Returns
        -------
        ShapeLibrary
            The library. In a folder of mesh files the id is the path without its suffix, and the
            category is the subfolder.

        Raises
        ------
        LibraryError
            If there is no such library, or it is damaged.
        """
        return ShapeLibrary(_source(source, seed))

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> ShapeLibrary:
        """Open the library that `to_json` recorded.

        Parameters
        ----------
        values : Mapping
            The record.

        Returns
        -------
        ShapeLibrary
            The library, or its recorded split.

        Raises
        ------
        LibraryError
            If it is no record of a library, or the library is not where it was, or has changed.
        """
        record = typed_json.convert(dict(values), _Record, LibraryError, "a library")
        opened = ShapeLibrary.open(record.source, seed=record.seed)
        if opened.digest != record.digest:
            raise LibraryError(
                f"{record.source} is not the recorded library {record.name!r} {record.version}: "
                f"its digest is {opened.digest:.12}, not {record.digest:.12}"
            )
        return ShapeLibrary(opened.source, record.split, record.unreadable)

    def to_json(self) -> dict[str, Any]:
        """Return a record in JSON's types: name, version and digest, and what opens it here."""
        facts = self.name, self.version, self.digest, self.locator
        record = _Record(*facts, self.source.seed, self._split, self._unreadable)
        return dict(typed_json.builtins(record))

    def split(self, name: str) -> ShapeLibrary:
        """Restrict the library to one split.

        Parameters
        ----------
        name : str
            One of "train", "test" and "validation".

        Returns
        -------
        ShapeLibrary
            A library with the shapes of the split only.

        Raises
        ------
        LibraryError
            If there is no such split, or the library has none: folders of mesh files must be
            imported first, so that duplicates are found.
        """
        if name not in SPLITS:
            raise LibraryError(f"no split {name!r}: choose from {', '.join(SPLITS)}")
        return ShapeLibrary(self.source, name, self._unreadable)

    def readable(self, on_shape: Callable[[str], None] = lambda id: None) -> ShapeLibrary:
        """Read all shapes, and leave out those whose mesh files can't be used.

        Parameters
        ----------
        on_shape : callable
            Called with the id of each shape before it is read.

        Returns
        -------
        ShapeLibrary
            The library without these shapes; its `missing` has their ids and the reasons. Name and
            digest stay the same. A catalogued library is returned as it is: its meshes were
            checked when it was written.

        Raises
        ------
        LibraryError
            If no shape is left.
        """
        if self.source.is_catalogued:
            return self
        unreadable = dict(self._unreadable)
        for id in self.ids:
            on_shape(id)
            try:
                self.source.shape(id)
            except MeshError as error:
                unreadable[id] = str(error)
        left = ShapeLibrary(self.source, self._split, unreadable)
        if not left.ids:
            raise LibraryError(
                f"none of the {len(self)} mesh files of {self.path} can be used; "
                f"{unreadable[self.ids[0]]}"
            )
        return left

    @property
    def name(self) -> str:
        """The name to which packs refer, the same for all splits."""
        return self.source.name

    @property
    def version(self) -> str:
        """The version to which packs refer."""
        return self.source.version

    @property
    def path(self) -> Path:
        """The folder of the library."""
        return self.source.path

    @property
    def locator(self) -> str:
        """The argument of `open` in any working directory: a built-in name or an absolute path."""
        if self.path.parent == assets_folder():
            return self.path.name
        scheme = self.source.locator.removesuffix(str(self.path))
        return f"{scheme}{self.path.absolute()}"

    @property
    def missing(self) -> Mapping[str, str]:
        """Reasons why expected shapes are missing, by id."""
        return MappingProxyType({**self.source.missing, **self._unreadable})

    @property
    def digest(self) -> str:
        """The SHA-256, in hex, of everything that can change a result.

        It covers the ids, geometry, volumes, categories, groups and splits of a stored library, and
        the ids and mesh files of others.
        """
        return self.source.digest

    def info(self, id: str) -> ShapeInfo:
        """Return the metadata of a shape; errors are those of `library[id]`."""
        self._require(id)
        return self.source.info(id)

    def __getitem__(self, id: str) -> Shape:
        """Return the shape of an id.

        Returns
        -------
        Shape
            The shape.

        Raises
        ------
        UnknownShapeError
            If there is no such shape.
        MeshError
            If its mesh file is not a shape.
        LibraryError
            If its stored mesh is damaged.
        """
        self._require(id)
        return self.source.shape(str(id))  # NumPy's strings are others in records

    def __contains__(self, id: object) -> bool:
        return id in self._ids

    def __iter__(self) -> Iterator[str]:
        return iter(self.ids)

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        split = f", {self._split}" if self._split else ""
        return (
            f"ShapeLibrary({self.name!r}{split}, {len(self)} shapes "
            f"in {len(self.categories)} categories)"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Open it again in any working directory; a built-in one in any installation."""
        return _reopened, (self.locator, self.source.seed, self._split, self._unreadable)

    def _require(self, id: str) -> None:
        if id in self._ids:
            return
        if id in self.missing:
            raise UnknownShapeError(f"no shape {id!r}: {self.missing[id]}")
        close = difflib.get_close_matches(str(id), self.ids, n=3, cutoff=0.4)
        hint = f"did you mean {listed(close)}?" if close else f"it holds {listed(self.ids)}"
        split = f" {self._split} of" if self._split else ""
        raise UnknownShapeError(f"no shape {id!r} in{split} library {self.name!r}: {hint}")


class _Record(Struct, frozen=True, forbid_unknown_fields=True):
    """A library as recorded: its identity, and the arguments that open it again."""

    name: str
    version: str
    digest: str
    source: str
    seed: int = 0
    split: Split | None = None
    unreadable: dict[str, str] = {}


def builtin_names() -> tuple[str, ...]:
    """Return the names of the built-in libraries."""
    return tuple(sorted(file.parent.name for file in assets_folder().glob(f"*/{CATALOGUE}")))


@cache
def _builtin(folder: Path) -> StoredLibrary:
    """Open a built-in library once per process: those who open it share its cached shapes."""
    return StoredLibrary(folder)


if sys.platform != "win32":
    os.register_at_fork(after_in_child=_builtin.cache_clear)  # a thread may hold its lock


def _source(source: str | Path, seed: int) -> Source:
    if isinstance(source, str) and source in builtin_names():
        return _builtin(assets_folder() / source)
    scheme, colon, path = str(source).partition(":")
    if not (colon and isinstance(source, str)):
        scheme, path = "", str(source)
    elif scheme not in SCHEMES:
        if path and scheme in (installed := announced(SOURCES)):
            return _installed(installed[scheme], Path(path))
        scheme, path = "", str(source)
    folder = Path(path)
    if not path or not exists(folder) or not folder.is_dir():
        raise LibraryError(
            f"no shape library {str(source)!r}: it is neither built in "
            f"({', '.join(builtin_names())}) nor a folder"
            f"{': ' if (hint := did_you_mean(str(source), builtin_names())) else ''}{hint.strip()}"
        )
    if scheme == "shapenet":
        return ShapeNet(folder, seed)
    if scheme == "folder":
        return MeshFolder(folder)
    if (folder / CATALOGUE).exists():
        return StoredLibrary(folder)
    if (folder / TAXONOMY).exists():
        raise LibraryError(f"{folder}: looks like ShapeNet: open it as 'shapenet:{folder}'")
    return MeshFolder(folder)


def _installed(found: EntryPoint, path: Path) -> Source:
    """Open a source of another package."""
    if not exists(path):
        raise LibraryError(f"no shape library '{found.name}:{path}': there is no {path}")
    source: Source = load(found, "shape source")(path)
    return source


def _reopened(
    locator: str, seed: int, split: str | None, unreadable: Mapping[str, str]
) -> ShapeLibrary:
    return ShapeLibrary(ShapeLibrary.open(locator, seed=seed).source, split, unreadable)
