"""Packs and tasks: a packed box as text, and the same taken apart for an agent to pack again.

A dataset is a JSON Lines file, one pack a line, beside a manifest with its number of packs and its
SHA-256.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from packit_sim._version import __version__
from packit_sim.box import Box
from packit_sim.core.errors import InfeasibleError, PackFormatError, UnknownShapeError
from packit_sim.core.files import replace_text
from packit_sim.engine import feasibility
from packit_sim.engine.occupancy import PlacedItem
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELLS_PER_UNIT, MAX_CELLS, Triple, box_cells
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary, assets_folder

FORMAT = 1
"""Version of the pack format, written with each pack."""

MAX_SCALE = (MAX_CELLS / CELLS_PER_UNIT) ** 3 * 3**1.5
"""Of an item that any box can hold: a shape's longest extent is at least 1 / sqrt(3)."""

STARTER_PACKS = "starter"
"""Name of the dataset that comes with the package."""

WHOLE = "packs"
"""The split of a dataset that has none: the name of its file."""

DENSITY_SLACK = 1e-9
"""How far a recorded density may be from the replayed one: rounding of sums."""


@dataclass(frozen=True)
class LibraryRef:
    """Which shape library a pack's ids are of."""

    name: str
    version: str
    digest: str

    @classmethod
    def of(cls, library: ShapeLibrary) -> LibraryRef:
        return cls(library.name, library.version, library.digest)


@dataclass(frozen=True)
class PackedItem:
    """One item of a pack: its shape's id, its scale (a ratio of volumes), rotation and location."""

    shape: str
    scale: float
    rotation: int
    location: Triple


@dataclass(frozen=True)
class OutsideItem:
    """One item that has no place in a pack: its shape's id and its scale."""

    shape: str
    scale: float


@dataclass(frozen=True)
class Pack:
    """A packed box: what was placed where, in the order of placing, and how it was made.

    cells: the box's, an axis. density: placed volume over the box's volume. made: free-form record
    of how (agent or evolution, seed, generation, settings), JSON values only. outside: what its
    task holds besides its items: all, where no pack is known, as of the original PackIt's tasks.
    """

    library: LibraryRef
    cells: Triple
    items: tuple[PackedItem, ...]
    density: float
    made: Mapping[str, Any] = field(default_factory=dict)
    outside: tuple[OutsideItem, ...] = ()

    @classmethod
    def of(cls, box: Box, library: LibraryRef, **made: Any) -> Pack:
        """What is in a box now, of shapes of a library; `made` in JSON's types."""
        items = tuple(
            PackedItem(p.item.shape.id, p.item.scale, p.item.rotation, p.location)
            for p in box.placed
        )
        return cls(library, box.cells, items, box.density, json.loads(json.dumps(made)))

    def placed(self, library: ShapeLibrary) -> tuple[PlacedItem, ...]:
        """The items in their places, unchecked.

        Raises PackFormatError where the library is not the pack's, UnknownShapeError for an id
        that it doesn't hold.
        """
        if self.library != LibraryRef.of(library):
            raise PackFormatError(
                f"the pack was made with library {self.library.name!r} {self.library.version} "
                f"({self.library.digest[:12]}), this is {library.name!r} {library.version} "
                f"({library.digest[:12]})"
            )
        return tuple(
            PlacedItem(Item(library[i.shape], i.scale, i.rotation), i.location) for i in self.items
        )

    def replay(self, library: ShapeLibrary) -> Box:
        """A box packed anew, item by item. Raises InfeasibleError at the first that can't stand."""
        box = Box(self.cells)
        for placed in self.placed(library):
            box.place(placed.item, placed.location)
        return box

    def task(self, library: ShapeLibrary) -> Task:
        """The pack taken apart, its items in an order that tells nothing of the pack's."""
        items = [p.item.turned(0) for p in self.placed(library)]
        items += [Item(library[i.shape], i.scale) for i in self.outside]
        order = sorted(range(len(items)), key=lambda n: (items[n].shape.id, items[n].scale, n))
        return Task(
            items=tuple(items[n] for n in order),
            pack=self,
            solution=tuple(
                (order.index(n), item.rotation, item.location) for n, item in enumerate(self.items)
            ),
        )

    def to_json(self) -> str:
        """One line of JSON; floats keep every bit."""
        fields = {"format": FORMAT, "version": __version__, **asdict(self)}
        if not self.outside:
            del fields["outside"]
        return json.dumps(fields, separators=(",", ":"), allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Pack:
        """Reads one line. Raises PackFormatError that names the field that is wrong."""
        try:
            raw = json.loads(line, parse_constant=_refuse_constant)
        except PackFormatError:
            raise
        except (ValueError, RecursionError, OverflowError) as error:
            raise PackFormatError(f"not JSON: {error}") from None
        if not isinstance(raw, dict):
            raise PackFormatError(f"a pack is a JSON object, not {type(raw).__name__}")
        if raw.get("format") != FORMAT:
            raise PackFormatError(
                f"field 'format' is {raw.get('format')!r}: this version reads {FORMAT}"
            )
        library = _get(raw, "library", dict)
        try:
            cells = box_cells(_get(raw, "cells", list))
        except ValueError as error:
            raise PackFormatError(f"field 'cells': {error}") from None
        density = _get(raw, "density", float)
        return cls(
            LibraryRef(
                *(_get(library, key, str, "library") for key in ("name", "version", "digest"))
            ),
            cells,
            tuple(
                _packed_item(raw_item, f"items[{n}]", cells)
                for n, raw_item in enumerate(_get(raw, "items", list))
            ),
            density,
            _get(raw, "made", dict),
            tuple(
                _outside_item(raw_item, f"outside[{n}]")
                for n, raw_item in enumerate(_get(raw, "outside", list) if "outside" in raw else ())
            ),
        )


@dataclass(frozen=True)
class Task:
    """A pack taken apart: what stands outside the box, in canonical orientation.

    items: sorted by shape and scale. pack: the ground truth.
    solution: (index into items, rotation, location) for each of the pack's items, in its order.
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
        """Tells it from other tasks: of the library, the box's cells, and the items."""
        items = [(item.shape.id, item.scale) for item in self.items]
        told = (self.pack.library.digest, self.cells, items)
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:16]


def verify(pack: Pack, library: ShapeLibrary) -> list[str]:
    """What is wrong with a pack, as sentences; nothing is where it holds.

    Replays it item by item against the oracle, without the engine that made it.
    """
    try:
        items = pack.placed(library)
    except (PackFormatError, UnknownShapeError) as error:
        return [str(error)]
    problems = []
    inside: dict[int, PlacedItem] = {}
    for n, candidate in enumerate(items):
        what = f"item {n} ({candidate.item.shape.id!r})"
        if not feasibility.is_inside(pack.cells, candidate):
            problems.append(f"{what} is not inside the box")
            continue
        blocking = [n for n, other in inside.items() if feasibility.conflicts(other, candidate)]
        if blocking:
            problems.append(f"{what} is in conflict with items {blocking}")
        inside[n] = candidate
    density = sum(p.item.volume for p in items) / (math.prod(pack.cells) / CELLS_PER_UNIT**3)
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
    manifest = {
        "format": FORMAT,
        "version": __version__,
        "packs": len(packs),
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
        "libraries": [asdict(ref) for ref in dict.fromkeys(pack.library for pack in packs)],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_text(path, text)
    replace_text(manifest_path(path), json.dumps(manifest, indent=1) + "\n")


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
            packs.append(Pack.from_json(line.decode()))
        except (PackFormatError, UnicodeDecodeError) as error:
            raise PackFormatError(f"{path}, line {number}: {error}") from None
    if not packs:
        raise PackFormatError(f"{path} holds no packs")
    if manifest and manifest_path(path).exists():
        _check_manifest(manifest_path(path), path, data)
    return packs


def _check_manifest(manifest: Path, path: Path, data: bytes) -> None:
    try:
        digest = json.loads(manifest.read_text())["sha256"]
    except (ValueError, KeyError, TypeError) as error:
        raise PackFormatError(f"{manifest} is no manifest: {error!r}") from None
    if digest != hashlib.sha256(data).hexdigest():
        raise PackFormatError(
            f"{path} is not the file that {manifest.name} describes: its SHA-256 differs"
        )


def manifest_path(path: Path) -> Path:
    """Where the manifest of a dataset stands."""
    return path.with_suffix(".manifest.json")


def _refuse_constant(name: str) -> float:
    raise PackFormatError(f"{name} is no number that a pack can hold")


def _packed_item(raw: Any, where: str, cells: Triple) -> PackedItem:
    outside = _outside_item(raw, where)
    rotation = _get(raw, "rotation", int, where)
    if not 0 <= rotation < rotations.COUNT:
        raise PackFormatError(
            f"field '{where}.rotation' is {rotation!r}: it must be 0 to {rotations.COUNT - 1}"
        )
    try:
        location = feasibility.checked_location(cells, _get(raw, "location", list, where))
    except InfeasibleError as error:
        raise PackFormatError(f"field '{where}.location': {error}") from None
    return PackedItem(outside.shape, outside.scale, rotation, location)


def _outside_item(raw: Any, where: str) -> OutsideItem:
    if not isinstance(raw, dict):
        raise PackFormatError(f"field '{where}' is {raw!r}: it must be an object")
    scale = _get(raw, "scale", float, where)
    if not 0 < scale <= MAX_SCALE:
        raise PackFormatError(
            f"field '{where}.scale' is {scale!r}: it must be more than 0, and {MAX_SCALE:g} at most"
        )
    return OutsideItem(_get(raw, "shape", str, where), scale)


def _get(raw: Mapping[str, Any], key: str, kind: type, where: str = "") -> Any:
    """A field of the right JSON type; a whole number will do for a float, a bool for neither."""
    name = f"{where}.{key}" if where else key
    if key not in raw:
        raise PackFormatError(f"field {name!r} is missing")
    value = raw[key]
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise PackFormatError(f"field {name!r} is {value!r}: it must be of type {kind.__name__}")
    return value
