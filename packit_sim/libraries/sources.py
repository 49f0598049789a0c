"""Sources of shapes, and the metadata of shapes.

A package adds a source by a subclass of `Source`, announced as an entry point of the group
"packit_sim.shape_sources". Its name is the scheme in `ShapeLibrary.open("SCHEME:PATH")`.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from multiprocessing import current_process
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from packit_sim.core.caches import bounded_cache
from packit_sim.core.errors import LibraryError, MeshError, located
from packit_sim.core.plain_text import plain_logger
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.raw_meshes import RawMesh

__all__ = ["Candidate", "RawMesh", "ShapeInfo", "Source"]

_log = plain_logger(__name__)

SHAPES_BUDGET = 208 * 2**20
"""Maximum size of all cached shapes of the process: bytes of their vertices and faces."""

SizeCm = tuple[float, float, float]


@dataclass(frozen=True)
class ShapeInfo:
    """The metadata of a shape in a library.

    Attributes
    ----------
    title : str
        A name for people.
    licence : str
        The SPDX identifier of the licence.
    source : str
        The origin of the mesh.
    size_cm : tuple of float, optional
        The object's real extents along x, y, z in cm, if known.
    watertight : bool
        Whether every edge has two triangles.
    solid : bool
        Whether the mesh is watertight and one body of consistent winding.
    volume : float
        The volume in canonical units.
    error_bound : float
        The largest distance, in canonical units, from the mesh that was imported.
    group : str
        The same for all shapes of one object.
    digest : str
        The SHA-256 of the geometry, in hex.
    """

    id: str
    category: str
    title: str
    author: str
    licence: str
    source: str
    size_cm: SizeCm | None
    triangles: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    watertight: bool
    solid: bool
    volume: Annotated[float, Meta(gt=0, le=1)]
    error_bound: float
    group: str
    digest: str


@dataclass(frozen=True)
class Candidate:
    """A mesh that may become a shape, before it is read, with its source's metadata.

    Attributes
    ----------
    read : callable
        Returns the `RawMesh`; it can be sent to another process.
    title : str
        A name for people.
    licence : str
        The SPDX identifier of the licence.
    source : str
        The origin of the mesh.
    size_cm : tuple of float, optional
        The object's real extents along x, y, z in cm, if known.
    group : str, optional
        The same for all candidates of one object, if known.
    """

    id: str
    category: str
    read: Callable[[], RawMesh]
    title: str = ""
    author: str = ""
    licence: str = ""
    source: str = ""
    size_cm: SizeCm | None = None
    group: str | None = None

    def info(self, shape: Shape, error_bound: float = 0.0) -> ShapeInfo:
        """Return the metadata of the shape that the candidate has become."""
        return ShapeInfo(
            id=shape.id,
            category=shape.category,
            title=self.title,
            author=self.author,
            licence=self.licence,
            source=self.source,
            size_cm=self.size_cm,
            triangles=len(shape.mesh.faces),
            watertight=bool(shape.mesh.is_watertight),
            solid=shape.is_solid,
            volume=shape.volume,
            error_bound=float(error_bound),
            group=self.group or shape.id,
            digest=shape.digest,
        )


class Source(ABC):
    """The origin of a library's shapes.

    Parameters
    ----------
    path : Path
        Its folder.
    name : str
        The name to which packs refer.
    version : str
        The version to which packs refer.
    categories : mapping of str to str
        The category of each id.
    missing : mapping of str to str, optional
        Why there is no shape, for ids that one would expect.
    seed : int, default: 0
        The seed of the splits, if they are drawn on opening.
    """

    is_catalogued = False
    """True if `info` need not read a mesh."""

    def __init__(
        self,
        path: Path,
        name: str,
        version: str,
        categories: Mapping[str, str],
        missing: Mapping[str, str] | None = None,
        seed: int = 0,
    ) -> None:
        self.path = path
        self.name = name
        self.version = version
        self.categories = dict(categories)
        self.missing = dict(missing or {})
        self.seed = seed
        self._loading = threading.RLock()

    @property
    @abstractmethod
    def locator(self) -> str:
        """The argument with which `ShapeLibrary.open` opens the same source."""

    @property
    @abstractmethod
    def digest(self) -> str:
        """The SHA-256 of the content, in hex."""

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        """The ids of each split, or LibraryError if there are none."""
        raise LibraryError(f"{self.path}: {self.name!r} has no splits: `packit shapes import` it")

    @abstractmethod
    def candidate(self, id: str) -> Candidate:
        """Return the candidate of an id."""

    def info(self, id: str) -> ShapeInfo:
        """Return the metadata of a shape, loading it if necessary."""
        return self.candidate(id).info(self.shape(id))

    def shape(self, id: str) -> Shape:
        """Return the shape of an id, from the cache or loaded.

        Returns
        -------
        Shape
            The shape.

        Raises
        ------
        MeshError
            If its mesh is not a shape.
        """
        with self._loading:
            return _kept_shape(self, id)

    def load(self, id: str) -> Shape:
        """Load the shape of an id without the cache."""
        candidate = self.candidate(id)
        raw = candidate.read()
        if raw.parts > 1:
            _warn_of_parts(candidate.source, raw.parts)
        with located(candidate.source, MeshError):
            return Shape.from_mesh(raw.mesh, id, candidate.category, up=raw.up)


@cache
def _warn_of_parts(file: str, parts: int) -> None:
    """Log once, and not in each worker, that a file's meshes are joined."""
    if current_process().name == "MainProcess":
        _log.warning(
            "%s: its %d parts become one rigid shape; to pack them separately, write each part to "
            "a separate file",
            file,
            parts,
        )


@bounded_cache(
    "shapes",
    SHAPES_BUDGET,
    "bytes",
    size=lambda shape: shape.mesh.vertices.nbytes + shape.mesh.faces.nbytes,
    key=lambda source, id: (source, id),
)
def _kept_shape(source: Source, id: str) -> Shape:
    return source.load(id)
