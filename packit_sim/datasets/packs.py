"""Packs and tasks: a packed box as text, and the same unpacked for an agent to pack again.

A dataset is a JSON Lines file, one pack a line, next to a manifest with its number of packs and its
SHA-256.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from packit_sim import placement
from packit_sim._version import __version__
from packit_sim.box import Box
from packit_sim.core import typed_json
from packit_sim.core.errors import (
    ArgumentError,
    InfeasibleError,
    PackFormatError,
    UnknownShapeError,
)
from packit_sim.core.files import replace_text
from packit_sim.datasets import format_1
from packit_sim.datasets.provenance import UNKNOWN, Count, Provenance, RotationIndex
from packit_sim.engine.base_box import BaseBox
from packit_sim.geometry.lattice import CELL, CELLS_PER_UNIT, MAX_CELLS, Triple, box_cells
from packit_sim.geometry.poses import Pose, Quaternion
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary, assets_folder
from packit_sim.libraries.splits import Split
from packit_sim.physics.settings import INSIDE
from packit_sim.placement import BoxState, ItemInBox, PlacedItem, PosedItem

FORMAT = 2
"""Version of the format of packs, results and manifests that this module writes."""

FORMATS = (format_1.FORMAT, FORMAT)
"""The versions that this module reads."""

MAX_SCALE = (MAX_CELLS / CELLS_PER_UNIT) ** 3 * 3**1.5
"""Of an item that any box can hold: a shape's longest extent is at least 1 / sqrt(3)."""

STARTER_PACKS = "starter"
"""Name of the dataset that comes with the package."""

WHOLE = "packs"
"""The split of a dataset that has none: the name of its file."""

DENSITY_SLACK = 1e-9
"""How far a recorded density may be from the replayed one: rounding of sums."""

Scale = Annotated[float, Meta(gt=0, le=MAX_SCALE)]


@dataclass(frozen=True)
class LibraryRef:
    """Which shape library a pack's ids are of."""

    name: str
    version: str
    digest: str

    @classmethod
    def of(cls, library: ShapeLibrary) -> LibraryRef:
        return cls(library.name, library.version, library.digest)


class FreePose(Struct, frozen=True):
    """A rigid pose off the grid, as recorded.

    Attributes
    ----------
    position : tuple of float
        The translation x, y, z in box units.
    wxyz : Quaternion
        The rotation from the canonical shape, as a unit quaternion w, x, y, z.
    """

    position: tuple[float, float, float]
    wxyz: Quaternion


class ItemRecord(Struct, frozen=True):
    """One item of a task that is not in the box.

    Attributes
    ----------
    shape : str
        The id of its shape.
    scale : float
        Its scale, a ratio of volumes.
    """

    shape: str
    scale: Scale


class PackedItem(ItemRecord, frozen=True, omit_defaults=True):
    """One item of a pack: on the grid at a location, or off the grid with a pose.

    Attributes
    ----------
    rotation : int
        The index of the rotation in which it was placed, 0 to 23.
    location : tuple of int, optional
        The grid node of its cell box's minimum corner, for an item on the grid.
    pose : FreePose, optional
        Where it came to rest, for an item that settled.
    counted : bool
        Whether its volume counts for the density: items that settled count while they are inside
        the box and stable.
    """

    rotation: RotationIndex
    location: Triple | None = None
    pose: FreePose | None = None
    counted: bool = True

    def __post_init__(self) -> None:
        if (self.location is None) == (self.pose is None):
            raise ArgumentError("an item must have either a location or a pose")

    @classmethod
    def of(cls, inside: ItemInBox) -> PackedItem:
        """Record an item that is in a box."""
        item = inside.item
        fields = item.shape.id, item.scale, item.rotation
        if isinstance(inside, PlacedItem):
            return cls(*fields, inside.location)
        x, y, z = inside.pose.position.tolist()
        counted = bool(getattr(inside, "counts", True))
        return cls(*fields, None, FreePose((x, y, z), inside.pose.wxyz), counted)

    def placed(self, item: Item) -> PlacedItem | PosedItem:
        """Return the given item where this record says."""
        if self.location is not None:
            return PlacedItem(item, self.location)
        assert self.pose is not None
        return PosedItem.at(item, Pose(np.array(self.pose.position), self.pose.wxyz))


class _Header(Struct):
    format: Any = None


@dataclass(frozen=True)
class Pack:
    """A packed box: what was placed where, in the order of placing, and where it comes from.

    Attributes
    ----------
    library : LibraryRef
        The library of its shapes.
    cells : tuple of int
        The box's cells along x, y and z.
    items : tuple of PackedItem
        The placed items, in the order of placing.
    density : float
        The volume of the items that count over the box's volume.
    provenance : Provenance
        How the pack came to be.
    outside : tuple of ItemRecord
        What its task holds besides its items: all, where no pack is known, as of the original
        PackIt's tasks.
    """

    library: LibraryRef
    cells: Triple
    items: tuple[PackedItem, ...]
    density: Annotated[float, Meta(ge=0)]
    provenance: Provenance = UNKNOWN
    outside: tuple[ItemRecord, ...] = ()

    @classmethod
    def of(cls, box: BaseBox[Any], library: LibraryRef, provenance: Provenance = UNKNOWN) -> Pack:
        """Record what is in a box now.

        Parameters
        ----------
        box : BaseBox
            A `Box`, or a `SettlingBox`, whose items get poses instead of locations.
        library : LibraryRef
            The library of the items' shapes.
        provenance : Provenance
            How the pack came to be.

        Returns
        -------
        Pack
            The pack, whose density is the box's.
        """
        items = tuple(PackedItem.of(inside) for inside in box.placed)
        return cls(library, box.cells, items, float(box.density), provenance)

    @property
    def is_on_grid(self) -> bool:
        """Whether all items have a location on the grid."""
        return all(item.location is not None for item in self.items)

    def placed(self, library: ShapeLibrary) -> tuple[PlacedItem | PosedItem, ...]:
        """Return the items in their places, unchecked.

        Parameters
        ----------
        library : ShapeLibrary
            The pack's library.

        Returns
        -------
        tuple of PlacedItem or PosedItem
            The items on the grid, or off it, in the order of placing.

        Raises
        ------
        PackFormatError
            If the library is not the pack's.
        UnknownShapeError
            If the library does not have a shape.
        """
        if self.library != LibraryRef.of(library):
            raise PackFormatError(
                f"the pack was made with library {self.library.name!r} {self.library.version} "
                f"({self.library.digest[:12]}), this is {library.name!r} {library.version} "
                f"({library.digest[:12]})"
            )
        return tuple(i.placed(Item(library[i.shape], i.scale, i.rotation)) for i in self.items)

    def contents(self, library: ShapeLibrary) -> BoxState[PlacedItem]:
        """Return the box's state on the grid, unchecked.

        Parameters
        ----------
        library : ShapeLibrary
            The pack's library.

        Returns
        -------
        BoxState
            What is in the box.

        Raises
        ------
        PackFormatError
            If items settled off the grid, and whatever `placed` raises.
        """
        placed = self.placed(library)
        on_grid = tuple(one for one in placed if isinstance(one, PlacedItem))
        if len(on_grid) < len(placed):
            raise PackFormatError(
                f"{len(placed) - len(on_grid)} of the pack's {len(placed)} items settled off the "
                "grid: this needs a pack whose items are on the grid"
            )
        return BoxState(self.cells, on_grid)

    def replay(self, library: ShapeLibrary) -> Box:
        """Pack a box anew, item by item.

        Parameters
        ----------
        library : ShapeLibrary
            The pack's library.

        Returns
        -------
        Box
            The packed box.

        Raises
        ------
        InfeasibleError
            At the first item that is not feasible.
        PackFormatError
            If items settled off the grid, and whatever `placed` raises.
        """
        box = Box(self.cells)
        for placed in self.contents(library).placed:
            box.place(placed.item, placed.location)
        return box

    def task(self, library: ShapeLibrary) -> Task:
        """Return the task of the pack, its items in an order independent of the pack's."""
        items = [p.item.turned(0) for p in self.placed(library)]
        items += [Item(library[i.shape], i.scale) for i in self.outside]
        order = sorted(range(len(items)), key=lambda n: (items[n].shape.id, items[n].scale, n))
        steps = tuple(
            (order.index(n), item.rotation, item.location)
            for n, item in enumerate(self.items)
            if item.location is not None
        )
        return Task(
            items=tuple(items[n] for n in order),
            pack=self,
            solution=steps if self.is_on_grid else (),
        )

    def to_json(self) -> str:
        """Write the pack as one line of JSON; floats keep every bit."""
        fields = {
            "format": FORMAT,
            "version": __version__,
            "library": self.library,
            "cells": self.cells,
            "items": self.items,
            "density": self.density,
            "provenance": self.provenance,
        }
        if self.outside:
            fields["outside"] = self.outside
        return typed_json.encode(fields)

    @classmethod
    def from_json(cls, line: bytes | str) -> Pack:
        """Read one line, of this format or of version 1.

        Parameters
        ----------
        line : bytes | str
            The JSON text of a pack.

        Returns
        -------
        Pack
            The pack, whose fields are in range by themselves.

        Raises
        ------
        PackFormatError
            If the line is no pack: the message names the field that is wrong.
        """
        number = typed_json.decode(line, _Header, PackFormatError, "a pack").format
        if number not in FORMATS or isinstance(number, bool):
            known = " and ".join(map(str, FORMATS))
            raise PackFormatError(f"field 'format' is {number!r:.40}: this version reads {known}")
        if number == FORMAT:
            pack = typed_json.decode(line, cls, PackFormatError, "a pack")
        else:
            raw = typed_json.decode(line, dict[str, Any], PackFormatError, "a pack")
            pack = typed_json.convert(format_1.pack(raw), cls, PackFormatError, "a pack")
        pack._check()
        return pack

    def _check(self) -> None:
        """Raises PackFormatError where cells or locations are not possible."""
        try:
            box_cells(self.cells)
        except ValueError as error:
            raise PackFormatError(f"field 'cells': {error}") from None
        for n, item in enumerate(self.items):
            if item.location is None:
                continue
            try:
                placement.checked_location(self.cells, item.location)
            except InfeasibleError as error:
                raise PackFormatError(f"field 'items[{n}].location': {error}") from None


class Manifest(Struct, frozen=True, omit_defaults=True):
    """What is recorded next to a file of packs.

    Attributes
    ----------
    format : int
        The version of the file's format.
    version : str
        The version of PackIt-Sim that wrote the file.
    packs : int
        The number of packs.
    sha256 : str
        The SHA-256 of the file.
    libraries : tuple of LibraryRef
        The libraries of the packs, in the order of their first pack.
    split : Split, optional
        The split of the library whose shapes the packs hold.
    """

    format: int
    version: str
    packs: Count
    sha256: str
    libraries: tuple[LibraryRef, ...]
    split: Split | None = None

    @classmethod
    def read(cls, path: Path) -> Manifest:
        """Read a manifest.

        Parameters
        ----------
        path : Path
            The file.

        Returns
        -------
        Manifest
            What it records.

        Raises
        ------
        PackFormatError
            If it can't be read, or is no manifest; the message does not name the file.
        """
        try:
            data = path.read_bytes()
        except OSError as error:
            raise PackFormatError(str(error.strerror)) from None
        return typed_json.decode(data, cls, PackFormatError, "a manifest")


@dataclass(frozen=True)
class Task:
    """A pack unpacked: items outside the box, in canonical orientation.

    Attributes
    ----------
    items : tuple of Item
        The items, sorted by shape and scale.
    pack : Pack
        The ground truth.
    solution : tuple of tuple
        (index into items, rotation, location) for each of the pack's items, in its order; empty
        where items settled off the grid.
    """

    items: tuple[Item, ...]
    pack: Pack
    solution: tuple[tuple[int, int, Triple], ...]

    @property
    def cells(self) -> Triple:
        """Of the box to pack."""
        return self.pack.cells

    @property
    def volume(self) -> float:
        """Total volume of the items, in box units cubed."""
        return sum(item.volume for item in self.items)

    @property
    def digest(self) -> str:
        """The digest of the library, the box's cells and the items: different for other tasks."""
        items = [(item.shape.id, item.scale) for item in self.items]
        facts = (self.pack.library.digest, self.cells, items)
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


def verify(pack: Pack, library: ShapeLibrary) -> list[str]:
    """Check a pack.

    Items on the grid are replayed one by one against the oracle, without the engine that packed
    them. Of items that settled off the grid it is checked that those that count are inside the
    box; whether they overlap, or rest, is not judged.

    Parameters
    ----------
    pack : Pack
        The pack to check.
    library : ShapeLibrary
        The library of its shapes.

    Returns
    -------
    list of str
        A sentence for each problem; empty for a pack that holds.
    """
    try:
        items = pack.placed(library)
    except (PackFormatError, UnknownShapeError) as error:
        return [str(error)]
    problems = []
    before: dict[int, PlacedItem] = {}
    size = np.array(pack.cells) * CELL
    for n, candidate in enumerate(items):
        what = f"item {n} ({candidate.item.shape.id!r})"
        if isinstance(candidate, PosedItem):
            vertices = candidate.vertices
            inside = (vertices > -INSIDE).all() and (vertices < size + INSIDE).all()
            if pack.items[n].counted and not inside:
                problems.append(f"{what} is not inside the box, within {INSIDE} box units")
            continue
        if not placement.is_inside(pack.cells, candidate):
            problems.append(f"{what} is not inside the box")
            continue
        blocking = [n for n, other in before.items() if placement.conflicts(other, candidate)]
        if blocking:
            problems.append(f"{what} is in conflict with items {blocking}")
        before[n] = candidate
    volume = sum(
        p.item.volume for p, record in zip(items, pack.items, strict=True) if record.counted
    )
    density = volume / (math.prod(pack.cells) / CELLS_PER_UNIT**3)
    if not abs(density - pack.density) <= DENSITY_SLACK:
        problems.append(f"density is recorded as {pack.density!r}, replayed it is {density!r}")
    return problems


def load_tasks(
    source: Path | str, library: ShapeLibrary, split: str | None = None
) -> tuple[Task, ...]:
    """The tasks of a dataset, or of one of its splits (see `dataset_file`)."""
    return tuple(pack.task(library) for pack in read_packs(dataset_file(source, split)))


def dataset_file(source: Path | str, split: str | None = None) -> Path:
    """The JSON Lines file of a dataset.

    source: the name of one that comes with the package, such as "starter", or a path, of the file
    itself or of a folder. split: which of the folder's files; "packs" where it has that one alone.
    Raises PackFormatError where the split does not go with it.
    """
    path = dataset_path(source)
    if not path.exists():
        raise PackFormatError(
            f"packs can't be read from {path}: No such file or directory; "
            f"datasets that come with the package: {', '.join(builtin_datasets())}"
        )
    if not path.is_dir():
        if split:
            raise PackFormatError(f"{path} has no splits: there is no {split!r} in it")
        return path
    splits = sorted(file.stem for file in path.glob("*.jsonl"))
    if split is None and splits == [WHOLE]:
        split = WHOLE
    if split not in splits:
        raise PackFormatError(
            f"{path} is a folder with the splits {', '.join(splits) or 'none'}: "
            f"{'choose one' if split is None else f'there is no {split!r}'}"
        )
    return path / f"{split}.jsonl"


def dataset_path(source: Path | str) -> Path:
    """The folder of a dataset that comes with the package, or the path itself."""
    built_in = assets_folder() / "packs" / str(source)
    return built_in if str(source) in builtin_datasets() else Path(source)


def builtin_datasets() -> tuple[str, ...]:
    """Names of the datasets that come with PackIt-Sim."""
    return tuple(sorted(path.name for path in (assets_folder() / "packs").iterdir()))


def write_packs(path: Path | str, packs: Iterable[Pack]) -> None:
    """Writes a dataset, whole or not at all: the JSON Lines file and its manifest beside it."""
    path = Path(path)
    packs = list(packs)
    text = "".join(pack.to_json() + "\n" for pack in packs)
    libraries = tuple(dict.fromkeys(pack.library for pack in packs))
    digest = hashlib.sha256(text.encode()).hexdigest()
    manifest = Manifest(FORMAT, __version__, len(packs), digest, libraries)
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_text(path, text)
    replace_text(manifest_path(path), json.dumps(typed_json.builtins(manifest), indent=1) + "\n")


def read_packs(path: Path | str, *, manifest: bool = True) -> list[Pack]:
    """Reads a dataset. Raises PackFormatError that names the file, the line and what is wrong.

    manifest: whether the file must be the one that its manifest describes, where it has one.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PackFormatError(f"packs can't be read from {path}: {error.strerror}") from None
    packs = []
    for number, line in enumerate(data.split(b"\n"), start=1):
        if not line.strip():
            continue
        try:
            packs.append(Pack.from_json(line))
        except PackFormatError as error:
            raise PackFormatError(f"{path}, line {number}: {error}") from None
    if not packs:
        raise PackFormatError(f"{path} holds no packs")
    if manifest and manifest_path(path).exists():
        _check_manifest(manifest_path(path), path, data)
    return packs


def _check_manifest(manifest: Path, path: Path, data: bytes) -> None:
    try:
        digest = Manifest.read(manifest).sha256
    except PackFormatError as error:
        raise PackFormatError(f"{manifest} is no manifest: {error}") from None
    if digest != hashlib.sha256(data).hexdigest():
        raise PackFormatError(
            f"{path} is not the file that {manifest.name} describes: its SHA-256 differs"
        )


def manifest_path(path: Path) -> Path:
    """Where the manifest of a dataset stands."""
    return path.with_suffix(".manifest.json")
