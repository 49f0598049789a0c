"""What a shape library is made of: where meshes come from, and what is known of them."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from packit_sim.core.caches import bounded_cache
from packit_sim.core.errors import LibraryError, MeshError
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.mesh_files import RawMesh

SHAPES_BUDGET = 2 * 2**30
"""Bytes of vertices and faces that the process keeps of all libraries' shapes."""

SizeCm = tuple[float, float, float]


@dataclass(frozen=True)
class ShapeInfo:
    """What a library tells about a shape.

    licence: SPDX identifier. source: where the mesh is from. size_cm: the object's real extents
    along x, y, z, where known. triangles: how many. watertight: whether every edge has two
    triangles; solid: whether the mesh is, besides, one body of consistent winding. volume: in
    canonical units. error_bound: how far, in canonical units, the mesh may be from the one it was
    made of. group: the same for shapes that are the same object. digest: SHA-256 of the geometry,
    in hex.
    """

    id: str
    category: str
    title: str
    author: str
    licence: str
    source: str
    size_cm: SizeCm | None
    triangles: int
    watertight: bool
    solid: bool
    volume: Annotated[float, Meta(gt=0, le=1)]
    error_bound: float
    group: str
    digest: str


@dataclass(frozen=True)
class Candidate:
    """A mesh that may become a shape, before it is read, and what its source tells about it.

    read: returns the mesh; it can be sent to another process. group: which candidates are the same
    object, where that is known. For the rest see `ShapeInfo`.
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
        """What is known once it is a shape."""
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
    """Where a library's shapes come from.

    path: its folder. name, version: what packs refer to. categories: the category of each id.
    missing: why there is no shape, for ids that one would expect. seed: of the splits, where they
    are made on opening. is_catalogued: whether `info` needs no mesh to be read.
    """

    is_catalogued = False

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
        """What `ShapeLibrary.open` takes to open the same once more."""

    @property
    @abstractmethod
    def digest(self) -> str:
        """SHA-256, in hex, of what there is."""

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        """The ids of each split. Raises LibraryError where there are none."""
        raise LibraryError(f"{self.path}: {self.name!r} has no splits: `packit shapes import` it")

    @abstractmethod
    def candidate(self, id: str) -> Candidate:
        """The mesh of an id as the source has it."""

    def info(self, id: str) -> ShapeInfo:
        """What is known about a shape. Raises whatever loading it raises."""
        return self.candidate(id).info(self.shape(id))

    def shape(self, id: str) -> Shape:
        """The shape of an id: kept, as far as the budget of all goes.

        Raises MeshError where its mesh is no shape.
        """
        with self._loading:
            return _kept_shape(self, id)

    def load(self, id: str) -> Shape:
        """The shape of an id, read anew."""
        candidate = self.candidate(id)
        raw = candidate.read()
        try:
            return Shape.from_mesh(raw.mesh, id, candidate.category, up=raw.up)
        except MeshError as error:
            raise MeshError(f"{candidate.source}: {error}") from error


@bounded_cache(
    "shapes",
    SHAPES_BUDGET,
    "bytes",
    size=lambda shape: shape.mesh.vertices.nbytes + shape.mesh.faces.nbytes,
    key=lambda source, id: (source, id),
)
def _kept_shape(source: Source, id: str) -> Shape:
    return source.load(id)


def listed(values: Iterable[object], most: int = 8) -> str:
    """Values for a message, not too many of them."""
    texts = [str(value) for value in values]
    more = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {more} more" if more > 0 else "")
