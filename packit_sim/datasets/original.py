"""Pack files of the original PackIt (Goyal and Deng, 2020) read into tasks, by a shape library.

What their fields mean is told by the Unity scripts that write them (github.com/princeton-vl/
PackIt_Extra); `docs/paper-compat.md` says how their packs differ from ours.
"""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, field

from packit_sim.core import typed_json
from packit_sim.core.errors import MeshError, PackFormatError, PackItError, UnknownShapeError
from packit_sim.datasets.packs import ItemRecord, LibraryRef, Pack, Task
from packit_sim.datasets.provenance import FromOriginal
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import BOX_CELLS, CELL
from packit_sim.geometry.shapes import Item
from packit_sim.libraries import mesh_files
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.shapenet import CATEGORIES
from packit_sim.libraries.sources import listed

SMALLEST, LARGEST = CELL, 1.75
"""Linear factors that can be: a diagonal of a cell, and a little more than that of the box."""

MOST = 1e6
"""Any other number of a pack is far smaller."""

UNEQUAL = 1e-4
"""How far the factors along the three axes may differ, as a share: rounding of their text."""

SKEW = 1e-3
"""How far an entry of a rotation's matrix may be from 0 or 1: rounding of single precision."""

_UNITY_TO_OURS = np.array(((-1, 0, 0), (0, 0, -1), (0, 1, 0)))
"""From Unity's left-handed, y-up axes to a canonical shape's: Unity reads an OBJ file with its x
reversed, and we turn the file's y up."""

_LOG = "_log"
"""Ending of what their generator writes beside a pack file."""


@dataclass(frozen=True)
class Unresolved:
    """An item of a pack that can't be had from the library.

    file: the pack file's name. pack, item: numbers from 0, theirs. source: as the file has it.
    reason: why there is no shape.
    """

    file: str
    pack: int
    item: int
    source: str
    reason: str


@dataclass(frozen=True)
class Original:
    """What became of the packs of one file or folder.

    tasks: one for each pack that was kept, in order. packs: how many were read. unresolved: every
    item without a shape, in order.
    """

    tasks: tuple[Task, ...]
    packs: int
    unresolved: tuple[Unresolved, ...]

    COLUMNS = ("file", "pack", "item", "source", "reason")
    """Headings of `rows`."""

    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """A row of text for each item without a shape; what can't be printed is escaped."""
        return [
            (
                _printable(u.file),
                str(u.pack),
                str(u.item),
                _printable(u.source),
                _printable(u.reason),
            )
            for u in self.unresolved
        ]

    def summary(self) -> str:
        """One line: how many packs were read, kept whole, kept in part and left out."""
        partial = sum(
            1
            for task in self.tasks
            if isinstance(task.pack.provenance, FromOriginal) and task.pack.provenance.left_out
        )
        counts = {
            "whole": len(self.tasks) - partial,
            "without some of their items": partial,
            "left out": self.packs - len(self.tasks),
        }
        told = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        items = len(self.unresolved)
        return f"{_count(self.packs, 'pack')}: {told}; {_count(items, 'item')} without a shape"

    def report(self) -> str:
        """The summary, and below it a line for each item without a shape."""
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
    """Tasks of the original PackIt's pack file, or of all those in a folder.

    A task holds our items in canonical orientation, and the benchmark's box. It has no solution,
    and all items of its pack are outside: the original's places are not on our grid. The pack's
    provenance, `FromOriginal`, has what else was recorded. Written by `write_packs`, the packs of
    the tasks are a dataset that `load_tasks` reads.

    partial: whether a pack is kept where some of its items have no shape; else it is left out.
    on_pack is called with the name of the file and the number of each pack that was read.

    An item's scale is the product of its three recorded factors. Their generator writes the linear
    factor in full, 2^((g - 2) / 3) * shapeScale with g in 0..4, so that shapeScale must not be
    applied again; and it applies it to the mesh as ShapeNetCore has it, which is taken to have a
    bounding-box diagonal of 1, as our canonical shapes have.

    Raises PackFormatError that names the file, the pack, the field and its value.
    """
    shapes = _Shapes(library)
    tasks: list[Task] = []
    unresolved: list[Unresolved] = []
    packs = 0
    for file in _files(Path(path)):
        for number, (recorded, entries) in enumerate(_recorded_packs(file)):
            packs += 1
            task, problems = shapes.task(recorded, entries, file.name, number)
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


class _Factors(Struct):
    x: Factor
    y: Factor
    z: Factor


class _Quaternion(Struct):
    x: Number
    y: Number
    z: Number
    w: Number


class _RecordedPack(Struct):
    """A pack as the file has it: an entry of each list for each item."""

    sources: Annotated[tuple[str, ...], Meta(min_length=1)]
    scales: tuple[_Factors, ...]
    rotations: tuple[_Quaternion, ...]
    positions: tuple[_Position, ...]
    efficiency: Annotated[float, Meta(ge=0, le=MOST)]
    shape_scale: Factor | UnsetType = field(default=UNSET, name="shapeScale")

    def items(self) -> list[_RecordedItem]:
        """Its items, in our terms. Raises PackFormatError that names the field that is wrong."""
        for name in ("scales", "rotations", "positions"):
            entries = getattr(self, name)
            if len(entries) != len(self.sources):
                raise PackFormatError(
                    f"field {name!r} has {_count(len(entries), 'entry', 'entries')}, "
                    f"'sources' has {len(self.sources)}: they must be as many"
                )
        return [
            _RecordedItem(
                source,
                _scale(self.scales[n], f"scales[{n}]"),
                _rotation(self.rotations[n], f"rotations[{n}]"),
            )
            for n, source in enumerate(self.sources)
        ]


class _PackFile(Struct):
    """What a file holds: its packs, read one by one."""

    data: Annotated[list[Any], Meta(min_length=1)]


@dataclass(frozen=True)
class _RecordedItem:
    """An item of a pack, its scale and rotation already ours."""

    source: str
    scale: float
    rotation: int


class _Shapes:
    """The shapes of a library by what the original calls them."""

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
        """The task of what there are shapes for, and what there are none for."""
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
        """Raises UnknownShapeError or MeshError, and whatever loading the shape raises."""
        item = Item(self._library[self._id(entry.source)], entry.scale)
        if max(item.cells) > max(BOX_CELLS):
            raise MeshError(f"at its scale it needs {item.cells} cells: the box has {BOX_CELLS}")
        return item

    def _id(self, source: str) -> str:
        match = re.fullmatch(r"[^/]+/([^/]+)/([^/]+)/model\.obj", source)
        if match is None:
            raise UnknownShapeError("it is not of the form Shapes_SPLIT/CATEGORY/MODEL/model.obj")
        category, model = match.groups()
        names = dict.fromkeys(
            _plain(name) for name in (category, CATEGORIES.get(category, ""), *_synsets(category))
        )
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
    """A name without what differs between spellings: case, spaces, underscores."""
    return re.sub(r"(?:[^\w/]|_)+", "-", name.casefold()).strip("-")


def _model(id: str) -> str:
    """The last part of an id, without the ending that folders keep where two files share a name."""
    name = id.rpartition("/")[2]
    stem, dot, ending = name.rpartition(".")
    return stem if stem and dot + ending.lower() in mesh_files.SUFFIXES else name


def _synsets(category: str) -> list[str]:
    """ShapeNet's numbers for a category by our name."""
    return [synset for synset, name in CATEGORIES.items() if name == _plain(category)]


def _files(path: Path) -> list[Path]:
    """The file itself, or the pack files of a folder: 2_tr before 10_tr."""
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
    """Orders names by the numbers in them: text and numbers alternate."""
    parts = re.split(r"([0-9]+)", name)
    return [int(part) if n % 2 else part for n, part in enumerate(parts)]


def _recorded_packs(file: Path) -> Iterator[tuple[_RecordedPack, list[_RecordedItem]]]:
    """The packs of a file, each with its items. Raises PackFormatError that names the file."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise PackFormatError(f"packs can't be read from {file}: {error.strerror}") from None
    except ValueError as error:
        raise PackFormatError(f"packs can't be read from {file}: {error}") from None
    if not text.strip():
        raise PackFormatError(f"{file} is empty")
    try:
        raw = json.loads(text)  # the packs of a foreign tool: unknown fields may hold NaN
    except (ValueError, RecursionError) as error:
        raise PackFormatError(f"{file} is not JSON: {error}") from None
    try:
        packs = typed_json.convert(raw, _PackFile, PackFormatError, "the file").data
    except PackFormatError as error:
        raise PackFormatError(f"{file}: {error}") from None
    for number, pack in enumerate(packs):
        try:
            recorded = typed_json.convert(pack, _RecordedPack, PackFormatError, "a pack")
            yield recorded, recorded.items()
        except PackFormatError as error:
            raise PackFormatError(f"{file}, pack {number}: {error}") from None


def _scale(recorded: _Factors, field: str) -> float:
    """The ratio of volumes of what is scaled by so much along Unity's axes."""
    factors = recorded.x, recorded.y, recorded.z
    if max(factors) - min(factors) > UNEQUAL * max(factors):
        raise PackFormatError(
            f"field {field!r} is {factors}: the three must be equal, an item has one scale"
        )
    return math.prod(factors)


def _rotation(recorded: _Quaternion, field: str) -> int:
    """The index of the rotation that is a quaternion of Unity's."""
    x, y, z, w = quaternion = recorded.x, recorded.y, recorded.z, recorded.w
    unity = np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )
    ours = _UNITY_TO_OURS @ unity @ _UNITY_TO_OURS.T
    errors = np.abs(rotations.MATRICES - ours).max(axis=(1, 2))
    nearest = int(errors.argmin())
    unit = abs(math.hypot(*quaternion) - 1) <= SKEW
    if not (unit and errors[nearest] <= SKEW):
        raise PackFormatError(
            f"field {field!r} is {quaternion}: it must be a unit quaternion of one of the "
            f"{rotations.COUNT} rotations"
        )
    return nearest


def _printable(text: str) -> str:
    """Text on one line, with escapes for what a terminal or a file may refuse."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"
