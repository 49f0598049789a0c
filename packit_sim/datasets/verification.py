"""Checks of whole datasets, by none of the code that generates them.

Of the geometry only the oracle decides (`placement.conflicts`): no mask and no search of the
engine, no `Box`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from packit_sim.core.errors import LibraryError, PackFormatError, PackItError, UnknownShapeError
from packit_sim.datasets.pack_checks import named, order_problems, settings_problems, verify
from packit_sim.datasets.pack_files import WHOLE, Manifest, manifest_path
from packit_sim.datasets.packs import FORMATS, Pack
from packit_sim.datasets.provenance import Evolved, Played, Provenance
from packit_sim.geometry.lattice import CELLS_PER_UNIT
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.splits import SPLITS
from packit_sim.placement import PlacedItem


@dataclass(frozen=True)
class Problem:
    """What is wrong, as a sentence that names the item where it is about one.

    pack: its number in the file from 0, as `read_packs` counts; None where it is about the file.
    """

    file: Path
    pack: int | None
    sentence: str

    def __str__(self) -> str:
        where = f"{self.file}" if self.pack is None else f"{self.file}, pack {self.pack}"
        return f"{where}: {self.sentence}"


@dataclass(frozen=True)
class Report:
    """What was checked, and all that is wrong with it.

    files, packs, items: how many; a pack that can't be read counts, its items don't.
    volume: of the items whose shapes could be had, space: of their boxes, in box units cubed, or in
    those of the packing's file. settled: how many items are off the grid: of these it is not judged
    whether they overlap, or rest where they are.
    """

    problems: tuple[Problem, ...]
    files: int
    packs: int
    items: int
    volume: float
    space: float
    settled: int = 0

    @property
    def holds(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    @property
    def not_judged(self) -> str:
        """What the check leaves open, as a sentence; empty where it leaves nothing open."""
        if not self.settled:
            return ""
        return (
            f"not judged, of {self.settled} items that settled off the grid: whether they overlap, "
            "and whether they rest where they are"
        )

    @property
    def broken(self) -> int:
        """How many packs have a problem of their own."""
        return len({(p.file, p.pack) for p in self.problems if p.pack is not None})

    @property
    def density(self) -> float:
        """The volume over the space: the mean density, if the boxes are alike."""
        return self.volume / self.space if self.space else 0.0


def verify_dataset(
    path: Path | str,
    library: ShapeLibrary,
    on_pack: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Check a dataset, and continue after each problem, so that one run reports them all.

    path: one JSON Lines file, or a folder with one for each split ("train.jsonl") or "packs.jsonl".
    library: that of its shapes, whole. on_pack is called with how many packs are checked, and of
    how many.

    - Each line is a pack, no field of which comes twice; the manifest has the file's digest,
      number of packs and libraries, and no manifest stands without its file.
    - Each pack holds by `packs.verify`: library, items inside and without conflict, density.
    - It has no more items than its recorded pool, each at one of its recorded scales, in the box
      of its recorded settings.
    - Evolved packs: no item could have stood at any location before its own in the order of
      bottom-left-back fill, among those placed before it. Cells that prove a conflict are asked
      first, and the oracle about each location that is left.
    - No two packs are the same, within a file or between two, in whatever order their items are;
      no seed comes twice in a file. Packs of one evolution's history may be the same, and so may
      what agents left of a task.
    - The shapes are of the split that a folder's file is named for, or that the manifest or the
      pack's provenance records.

    Raises PackFormatError where there is no such file, or a folder without any.
    """
    path = Path(path)
    files = sorted(path.glob("*.jsonl")) if path.is_dir() else [path]
    if not files:
        raise PackFormatError(f"{path} is a folder without packs: it has no .jsonl file")
    checking = _Checking(library)
    read_in = [_ReadIn(file, checking) for file in files]
    if path.is_dir():
        _check_folder(path, files, checking)
    total = sum(len(found.packs) for found in read_in)
    done = 0
    for found in read_in:
        manifest = _check_manifest(found, checking)
        name = found.file.stem if path.is_dir() and found.file.stem in SPLITS else None
        recorded = manifest.split if manifest is not None else None
        for number, pack in found.packs:
            for sentence in checking.pack_problems(pack, (name, recorded)):
                checking.add(found.file, number, sentence)
            for sentence in checking.repeated(found.file, number, pack):
                checking.add(found.file, number, sentence)
            done += 1
            on_pack(done, total)
    return Report(
        tuple(checking.problems),
        len(files),
        sum(found.count for found in read_in),
        sum(len(pack.items) for found in read_in for _, pack in found.packs),
        checking.volume,
        checking.space,
        sum(item.pose is not None for f in read_in for _, pack in f.packs for item in pack.items),
    )


class _Checking:
    """What a check of a dataset has found so far."""

    def __init__(self, library: ShapeLibrary) -> None:
        self.library = library
        self.problems: list[Problem] = []
        self.volume = self.space = 0.0
        self._same: dict[tuple[Any, ...], list[tuple[Path, int, Provenance]]] = {}
        self._seeds: dict[tuple[Any, ...], int] = {}
        self._split = cache(library.split)

    def add(self, file: Path, pack: int | None, sentence: str) -> None:
        self.problems.append(Problem(file, pack, sentence))

    def pack_problems(self, pack: Pack, recorded: Iterable[str | None]) -> Iterator[str]:
        """All that is wrong with one pack. recorded: its split, by each source that knows it."""
        evolved = pack.provenance if isinstance(pack.provenance, Evolved) else None
        if not pack.items:
            yield "it holds no items"
        if evolved is not None:
            yield from settings_problems(pack, evolved)
        splits = dict.fromkeys(s for s in (*recorded, pack.provenance.split) if s is not None)
        if len(splits) > 1:
            yield f"it is recorded to be of several splits: {', '.join(map(repr, splits))}"
        for split in splits:
            yield from self._split_problems(pack, split)
        try:
            yield from verify(pack, self.library)
            placed = pack.placed(self.library)
        except (PackFormatError, UnknownShapeError):
            return  # verify has said so
        except PackItError as error:
            yield str(error)
            return
        self.volume += sum(p.item.volume for p in placed)
        self.space += math.prod(pack.cells) / CELLS_PER_UNIT**3
        if evolved is not None and pack.is_on_grid:
            on_grid = [one for one in placed if isinstance(one, PlacedItem)]
            yield from order_problems(pack.cells, on_grid)

    def repeated(self, file: Path, number: int, pack: Pack) -> Iterator[str]:
        """Which pack before it is the same, or has its seed."""
        origin = pack.provenance
        items = sorted(pack.items, key=repr)
        same = self._same.setdefault((pack.library, pack.cells, *items), [])
        for other_file, other, other_origin in same:
            if _may_be_alike(origin, other_origin):
                continue
            where = f"pack {other}" if other_file == file else f"pack {other} of {other_file.name}"
            yield f"it is the same as {where}"
            break
        same.append((file, number, origin))
        if isinstance(origin, Evolved | Played):
            of = origin.after if isinstance(origin, Evolved) else origin.task
            key = file, origin.producer, origin.seed, of
            if key in self._seeds:
                yield f"its seed {origin.seed} is that of pack {self._seeds[key]}"
            self._seeds.setdefault(key, number)

    def _split_problems(self, pack: Pack, split: str) -> Iterator[str]:
        try:
            own = self._split(split)
        except LibraryError as error:
            yield str(error)
            return
        for n, item in enumerate(pack.items):
            if item.shape in self.library and item.shape not in own:
                others = [name for name in SPLITS if item.shape in self._split(name)]
                yield (
                    f"{named(n, item.shape)} is a shape of split "
                    f"{' and '.join(others) or 'none'}, the pack is of {split}"
                )


class _ReadIn:
    """A dataset's file as it was read. packs: each readable one and its number. count: of all."""

    def __init__(self, file: Path, checking: _Checking) -> None:
        self.file = file
        try:
            self.data = file.read_bytes()
        except OSError as error:
            raise PackFormatError(f"packs can't be read from {file}: {error.strerror}") from None
        self.packs: list[tuple[int, Pack]] = []
        self.count = 0
        for number, line in enumerate(self.data.split(b"\n"), start=1):
            if not line.strip():
                continue
            try:
                pack = Pack.from_json(line)
                json.loads(line, object_pairs_hook=_refuse_doubles)
            except (ValueError, RecursionError) as error:
                checking.add(file, self.count, f"line {number}: {error}")
            else:
                self.packs.append((self.count, pack))
            self.count += 1
        if not self.count:
            checking.add(file, None, "it holds no packs")
        elif not self.data.endswith(b"\n"):
            checking.add(file, None, "its last line has no end")


def _check_folder(folder: Path, files: Sequence[Path], checking: _Checking) -> None:
    names = SPLITS if any(file.stem in SPLITS for file in files) else (WHOLE,)
    for file in files:
        if file.stem not in names:
            choices = ", ".join(names)
            checking.add(file, None, f"a file of this folder can't have this name: {choices}")
    described = {manifest_path(file) for file in files}
    for manifest in sorted(folder.glob("*.manifest.json")):
        if manifest not in described:
            checking.add(manifest, None, "there is no file that this manifest describes")


def _check_manifest(found: _ReadIn, checking: _Checking) -> Manifest | None:
    """Compare a manifest with its file; None where there is no manifest."""
    path = manifest_path(found.file)
    if not path.exists():
        checking.add(found.file, None, f"it has no manifest {path.name}")
        return None
    try:
        manifest = Manifest.read(path)
    except PackFormatError as error:
        checking.add(path, None, str(error))
        return None
    if manifest.format not in FORMATS:
        known = " and ".join(map(str, FORMATS))
        checking.add(path, None, f"field 'format' is {manifest.format}: this version reads {known}")
    expected: dict[str, Any] = {
        "packs": found.count,
        "sha256": hashlib.sha256(found.data).hexdigest(),
    }
    if len(found.packs) == found.count:
        expected["libraries"] = tuple(dict.fromkeys(pack.library for _, pack in found.packs))
    for name, value in expected.items():
        recorded = getattr(manifest, name)
        if recorded != value:
            sentence = f"field {name!r} is {recorded!r}, of {found.file.name} it is {value!r}"
            checking.add(path, None, sentence)
    return manifest


def _refuse_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for key, value in pairs:
        if key in fields:
            raise PackFormatError(f"field {key!r} comes twice")
        fields[key] = value
    return fields


def _may_be_alike(one: Provenance, other: Provenance) -> bool:
    """Whether two packs may have the same items: of one history, or of agents at one task."""
    if isinstance(one, Evolved) and isinstance(other, Evolved):
        return one.seed == other.seed and None not in (one.after, other.after)
    return isinstance(one, Played) and isinstance(other, Played)
