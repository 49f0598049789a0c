"""Pack files of the original PackIt (Goyal and Deng, 2020), read as tasks of a shape library.

The meaning of their fields follows from the Unity scripts that write them (github.com/princeton-vl/
PackIt_Extra); `docs/paper-compat.md` lists how their packs differ from ours.
"""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, field, structs

from packit_sim.core import typed_json
from packit_sim.core.errors import (
    MeshError,
    PackFormatError,
    PackItError,
    UnknownShapeError,
    located,
)
from packit_sim.datasets.pack_files import read_bytes
from packit_sim.datasets.packs import ItemRecord, LibraryRef, Pack, Task
from packit_sim.datasets.provenance import FromOriginal
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import BOX_CELLS, CELL
from packit_sim.geometry.poses import Pose
from packit_sim.geometry.shapes import Item
from packit_sim.libraries import mesh_files
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.shapenet import CATEGORIES
from packit_sim.libraries.sources import listed

SMALLEST, LARGEST = CELL, 1.75
"""Range of linear factors: a diagonal of one cell, and a little more than the box's diagonal."""

MOST = 1e6
"""Bound on the absolute value of other numbers."""

UNEQUAL = 1e-4
"""Largest relative difference between the factors along the three axes: rounding of their text."""

SKEW = 1e-3
"""Largest error of a rotation matrix's entry: rounding of single precision."""

_UNITY_TO_OURS = np.array(((-1, 0, 0), (0, 0, -1), (0, 1, 0)))
"""From Unity's left-handed, y-up axes to a canonical shape's: Unity reads an OBJ file with its x
reversed, and we turn the file's y up."""

_LOG = "_log"
"""Ending of the log file next to a pack file."""


@dataclass(frozen=True)
class Unresolved:
    """An item of a pack whose shape the library does not have.

    Attributes
    ----------
    file : str
        The name of the pack file.
    pack : int
        The number of the pack in the file, from 0.
    item : int
        The number of the item in the pack, from 0.
    source : str
        The shape's name in the file.
    reason : str
        Why there is no shape.
    """

    file: str
    pack: int
    item: int
    source: str
    reason: str


@dataclass(frozen=True)
class Original:
    """The tasks of one file or folder, and the items without a shape.

    Attributes
    ----------
    tasks : tuple of Task
        One for each pack that was kept, in order.
    packs : int
        The number of packs that were read.
    unresolved : tuple of Unresolved
        Every item without a shape, in order.
    """

    tasks: tuple[Task, ...]
    packs: int
    unresolved: tuple[Unresolved, ...]

    COLUMNS = ("file", "pack", "item", "source", "reason")
    """Headings of `rows`."""

    def rows(self) -> list[tuple[str, ...]]:
        """Return a row of text for each item without a shape; unprintable text is escaped."""
        return [tuple(_printable(str(value)) for value in astuple(u)) for u in self.unresolved]

    def summary(self) -> str:
        """Say in one line how many packs were read, kept whole, kept in part and left out."""
        origins = [task.pack.provenance for task in self.tasks]
        partial = sum(isinstance(one, FromOriginal) and one.left_out > 0 for one in origins)
        counts = {
            "whole": len(self.tasks) - partial,
            "without some of their items": partial,
            "left out": self.packs - len(self.tasks),
        }
        outcome = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        items = len(self.unresolved)
        return f"{_count(self.packs, 'pack')}: {outcome}; {_count(items, 'item')} without a shape"

    def report(self) -> str:
        """Return the summary, and below it a line for each item without a shape."""
        lines = (
            f"{file}, pack {pack}, item {item}: {source}: {reason}"
            for file, pack, item, source, reason in self.rows()
        )
        return "\n".join((self.summary(), *lines))


def read_original(
    path: Path | str,
    library: ShapeLibrary,
    *,
    partial: bool = False,
    on_pack: Callable[[str, int], None] = lambda file, pack: None,
) -> Original:
    """Read a pack file of the original PackIt, or all in a folder, as tasks.

    Parameters
    ----------
    path : Path or str
        The file or the folder.
    library : ShapeLibrary
        The library of its shapes, ShapeNetCore for the paper's packs.
    partial : bool, default: False
        Whether to keep a pack if some of its items have no shape; otherwise it is left out.
    on_pack : callable
        Called with the name of the file and the number of each pack that was read.

    Returns
    -------
    Original
        The tasks, and the items without a shape.

    Raises
    ------
    PackFormatError
        If a file is not of this form; the message names the file, the pack, the field and its
        value.

    Notes
    -----
    A task has our items in canonical orientation, and the benchmark's box. It has no solution, and
    all items of its pack are outside, because the original's locations are not on our grid. The
    pack's provenance, `FromOriginal`, has what else was recorded. `write_packs` writes the packs of
    the tasks as a dataset that `load_tasks` reads.

    An item's scale is the product of its three recorded factors. Their generator writes the whole
    linear factor, 2^((g - 2) / 3) * shapeScale with g in 0..4, so shapeScale must not be applied
    again; and it applies it to the mesh of ShapeNetCore, assumed to have a bounding-box diagonal of
    1, as our canonical shapes have.
    """
    shapes = _Shapes(library)
    tasks: list[Task] = []
    unresolved: list[Unresolved] = []
    packs = 0
    for file in _files(Path(path)):
        for number, raw in enumerate(_raw_packs(file)):
            packs += 1
            with located(f"{file}, pack {number}", PackFormatError):
                recorded = typed_json.convert(raw, _RecordedPack, PackFormatError, "a pack")
                items = recorded.items()
            task, problems = shapes.task(recorded, items, file.name, number)
            unresolved += problems
            if task.items and (partial or not problems):
                tasks.append(task)
            on_pack(file.name, number)
    return Original(tuple(tasks), packs, tuple(unresolved))


Number = Annotated[float, Meta(ge=-MOST, le=MOST)]
Factor = Annotated[float, Meta(ge=SMALLEST, le=LARGEST)]


class _Position(Struct):
    x: Number
    y: Number
    z: Number


class _Quaternion(_Position):
    w: Number


class _Factors(Struct):
    x: Factor
    y: Factor
    z: Factor


class _RecordedPack(Struct):
    """A pack in the file, with an entry of each list for each item."""

    sources: Annotated[tuple[str, ...], Meta(min_length=1)]
    scales: tuple[_Factors, ...]
    rotations: tuple[_Quaternion, ...]
    positions: tuple[_Position, ...]
    efficiency: Annotated[float, Meta(ge=0, le=MOST)]
    shape_scale: Factor | UnsetType = field(default=UNSET, name="shapeScale")

    def items(self) -> list[_RecordedItem]:
        """Return the items, or raise PackFormatError that names the wrong field."""
        for name in ("scales", "rotations", "positions"):
            entries = getattr(self, name)
            if len(entries) != len(self.sources):
                raise PackFormatError(
                    f"field {name!r} has {_count(len(entries), 'entry', 'entries')}, "
                    f"'sources' has {len(self.sources)}: they must be as many"
                )
        rows = zip(self.sources, self.scales, self.rotations, strict=True)
        return [
            _RecordedItem(
                source, _scale(factors, f"scales[{n}]"), _rotation(turn, f"rotations[{n}]")
            )
            for n, (source, factors, turn) in enumerate(rows)
        ]


class _PackFile(Struct):
    """The content of a file; its packs are converted one by one."""

    data: Annotated[list[Any], Meta(min_length=1)]


@dataclass(frozen=True)
class _RecordedItem:
    """An item of a pack, with our scale and rotation."""

    source: str
    scale: float
    rotation: int


class _Shapes:
    """The shapes of a library by their names in the original."""

    def __init__(self, library: ShapeLibrary) -> None:
        self._library = library
        self._models: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        for category, ids in library.categories.items():
            for id in ids:
                self._models[_plain(category)][_plain(_model(id))].append(id)
        self._missing = {_plain(id): reason for id, reason in library.missing.items()}

    def task(
        self, recorded: _RecordedPack, entries: list[_RecordedItem], file: str, number: int
    ) -> tuple[Task, list[Unresolved]]:
        """Return the task of the items that have shapes, and the other items."""
        items: list[tuple[Item, int]] = []
        problems: list[Unresolved] = []
        for n, entry in enumerate(entries):
            try:
                items.append((self._item(entry), entry.rotation))
            except PackItError as error:
                problems.append(Unresolved(file, number, n, entry.source, str(error)))
        items.sort(key=lambda pair: (pair[0].shape.id, pair[0].scale))
        origin = FromOriginal(
            file=file,
            pack=number,
            efficiency=recorded.efficiency,
            shape_scale=recorded.shape_scale or None,
            rotations=tuple(rotation for _, rotation in items),
            left_out=len(problems),
        )
        outside = tuple(ItemRecord(item.shape.id, item.scale) for item, _ in items)
        pack = Pack(LibraryRef.of(self._library), BOX_CELLS, (), 0.0, origin, outside)
        return pack.task(self._library), problems

    def _item(self, entry: _RecordedItem) -> Item:
        """Load an item; raises UnknownShapeError, MeshError and other errors of loading."""
        item = Item(self._library[self._id(entry.source)], entry.scale)
        if max(item.cells) > max(BOX_CELLS):
            raise MeshError(f"at its scale it needs {item.cells} cells: the box has {BOX_CELLS}")
        return item

    def _id(self, source: str) -> str:
        """Return the id of a shape by its name in the file, or raise UnknownShapeError."""
        match = re.fullmatch(r"[^/]+/([^/]+)/([^/]+)/model\.obj", source)
        if match is None:
            raise UnknownShapeError("it is not of the form Shapes_SPLIT/CATEGORY/MODEL/model.obj")
        category, model = match.groups()
        synsets = (synset for synset, name in CATEGORIES.items() if name == _plain(category))
        names = dict.fromkeys(map(_plain, (category, CATEGORIES.get(category, ""), *synsets)))
        known = [name for name in names if name and name in self._models]
        found = [id for name in known for id in self._models[name].get(_plain(model), ())]
        if len(found) > 1:
            found = [id for id in found if _model(id) == model] or found
        if len(found) == 1:
            return found[0]
        if found:
            raise UnknownShapeError(f"ambiguous: it may be {listed(found)}")
        for name in names:
            reason = self._missing.get(_plain(f"{name}/{model}"))
            if reason is not None:
                raise UnknownShapeError(reason)
        library = f"library {self._library.name!r}"
        if known:
            raise UnknownShapeError(f"no model {model!r} in {known[0]!r} of {library}")
        raise UnknownShapeError(
            f"no category {category!r} in {library}: it has {listed(self._library.categories)}"
        )


def _plain(name: str) -> str:
    """Remove what differs between spellings of a name: case, spaces, underscores."""
    return re.sub(r"(?:[^\w/]|_)+", "-", name.casefold()).strip("-")


def _model(id: str) -> str:
    """Return the last part of an id, without the suffix of two files with the same name."""
    name = id.rpartition("/")[2]
    stem, dot, ending = name.rpartition(".")
    return stem if stem and dot + ending.lower() in mesh_files.SUFFIXES else name


def _files(path: Path) -> list[Path]:
    """Return the file itself, or the pack files of a folder: 2_tr before 10_tr."""
    if not path.is_dir():
        return [path]
    try:
        files = [
            file
            for file in path.iterdir()
            if file.is_file() and not file.name.startswith(".") and not file.name.endswith(_LOG)
        ]
    except OSError as error:
        raise PackFormatError(f"packs can't be read from {path}: {error.strerror}") from None
    if not files:
        raise PackFormatError(f"{path} holds no pack files")
    return sorted(files, key=lambda file: _natural(file.name))


def _natural(name: str) -> list[int | str]:
    """Return a key that orders names by the numbers in them: text and numbers alternate."""
    parts = re.split(r"([0-9]+)", name)
    return [int(part) if n % 2 else part for n, part in enumerate(parts)]


def _raw_packs(file: Path) -> list[Any]:
    """Return the packs of a file in JSON's types, or raise PackFormatError that names the file."""
    data = read_bytes(file)
    if not data.strip():
        raise PackFormatError(f"{file} is empty")
    try:  # not by msgspec: unknown fields of another tool's file may be NaN
        raw = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise PackFormatError(f"{file} is not JSON: {error}") from None
    with located(file, PackFormatError):
        return typed_json.convert(raw, _PackFile, PackFormatError, "the file").data


def _scale(recorded: _Factors, field: str) -> float:
    """Return the ratio of volumes for the factors along Unity's axes."""
    factors = structs.astuple(recorded)
    if max(factors) - min(factors) > UNEQUAL * max(factors):
        raise PackFormatError(
            f"field {field!r} is {factors}: the three must be equal, an item has one scale"
        )
    return math.prod(factors)


def _rotation(recorded: _Quaternion, field: str) -> int:
    """Return the index of our rotation for a quaternion of Unity's."""
    x, y, z, w = quaternion = structs.astuple(recorded)
    unity = Pose.from_xyzw(np.zeros(3), (x, y, z, w)).axes
    errors = np.abs(rotations.MATRICES - _UNITY_TO_OURS @ unity @ _UNITY_TO_OURS.T)
    worst = errors.max(axis=(1, 2))
    nearest = int(worst.argmin())
    if abs(math.hypot(*quaternion) - 1) > SKEW or worst[nearest] > SKEW:
        raise PackFormatError(
            f"field {field!r} is {quaternion}: it must be a unit quaternion of one of the "
            f"{rotations.COUNT} rotations"
        )
    return nearest


def _printable(text: str) -> str:
    """Escape what a terminal or a file may refuse, so that the text is on one line."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"
