"""Checks of datasets, independent of the code that generates them.

The oracle (`engine.oracle`) decides about the geometry: no mask or search of the engine, and
no `Box`, is used.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from packit_sim.core.check_reports import FileProblem, Report, named
from packit_sim.core.choices import SPLITS
from packit_sim.core.errors import (
    LibraryError,
    MeshError,
    PackFormatError,
    PackItError,
    UnknownShapeError,
)
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.execution_checks import execution_problems
from packit_sim.game.datasets.manifests import (
    SUFFIX,
    Manifest,
    find_manifest,
    former_manifest_path,
    manifest_path,
)
from packit_sim.game.datasets.pack_checks import (
    density_problems,
    order_problems,
    puzzle_problems,
    settings_problems,
    verify,
)
from packit_sim.game.datasets.pack_files import WHOLE, folder_files
from packit_sim.game.datasets.packs import FORMATS, LibraryRef, Pack
from packit_sim.game.datasets.provenance import (
    Densified,
    Drawn,
    Evolved,
    Played,
    Provenance,
    Puzzle,
)
from packit_sim.game.datasets.result_checks import (
    insertion_problems,
    placement_problems,
    result_problems,
    task_of,
)
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELLS_PER_UNIT
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.data_files import numbered_lines, read_bytes
from packit_sim.libraries.library import ShapeLibrary

VOLUME_SLACK = 1e-6
"""Largest relative difference between a recorded volume and that of the mesh: rounding of sums."""


def verify_dataset(
    path: Path | str,
    library: ShapeLibrary,
    on_pack: Callable[[int, int], None] = lambda done, total: None,
    *,
    executions: bool = True,
) -> Report:
    """Check a dataset, and continue after each problem, so that one run reports them all.

    Parameters
    ----------
    path : Path or str
        A JSON Lines file, or a folder with one for each split ("train.jsonl") or "packs.jsonl".
    library : ShapeLibrary
        The whole library of its shapes.
    on_pack : callable
        Called after each pack with the number of checked packs and of all packs.
    executions : bool, default: True
        Whether results of an arm are compared with their recorded trajectories.

    Returns
    -------
    Report
        The problems, and how much was checked.

    Raises
    ------
    PackFormatError
        If there is no such file, or the folder has none.

    Notes
    -----
    The checks:

    - Each line is a pack without a duplicate field; the manifest has the file's digest, number of
      packs and libraries, and each manifest has its file.
    - Each pack passes `verify`: library, items inside and without conflict, density.
    - It has at most as many items as its recorded pool, each at one of its recorded scales, in the
      box of its recorded settings. A pack that was made denser has as many items, of such shares of
      the volume, as its settings say.
    - The volumes that a stored library records are those of its meshes.
    - Results: the box is that of the task or of the rules, the return and the end follow from the
      items and the task; with the kinematic rule each item can come straight down from the open
      top, with the rule of support it rests on enough, and none is in two of several boxes. Agents
      do not play again.
    - Results of an arm: the return, the measures and the final poses follow from the recorded
      trajectory.
    - Evolved packs: each item is at its bottom-left-back-fill location, the first feasible one
      given the items placed before it. Cells that prove a conflict rule locations out, and the
      oracle decides about the others.
    - No two packs have the same items in any order, within a file or in two files, and no seed
      occurs twice in a file. The packs of one evolution's history may be the same, and an agent
      may pack a box as another agent or the evolution did.
    - The shapes belong to the split that the file's name, the manifest or the pack's provenance
      records.
    """
    path = Path(path)
    files = folder_files(path) if path.is_dir() else [path]
    check = _DatasetCheck(library)
    parts = [_DatasetFile(file, check) for file in files]
    if path.is_dir():
        _check_folder(path, parts, check)
    total = sum(len(part.packs) for part in parts)
    done = 0
    for part in parts:
        manifest = _check_manifest(part, check)
        name = part.file.stem if path.is_dir() and part.file.stem in SPLITS else None
        recorded = manifest.split if manifest is not None else None
        for number, pack in part.packs:
            for sentence in check.pack_problems(pack, (name, recorded)):
                check.add(part.file, number, sentence)
            if executions and isinstance(pack.provenance, Played) and not check.is_unknown(pack):
                for sentence in execution_problems(part.file, pack, pack.provenance, library):
                    check.add(part.file, number, sentence)
            for sentence in check.duplicate_problems(part.file, number, pack):
                check.add(part.file, number, sentence)
            done += 1
            on_pack(done, total)
    items = [item for part in parts for _, pack in part.packs for item in pack.items]
    return Report(
        tuple(check.problems),
        len(files),
        sum(part.count for part in parts),
        len(items),
        check.volume,
        check.space,
        sum(item.pose is not None for item in items),
        check.unjudged_returns,
    )


class _DatasetCheck:
    """The state of a check of a dataset: problems and counts so far."""

    def __init__(self, library: ShapeLibrary) -> None:
        self.library = library
        self.problems: list[FileProblem] = []
        self.volume = self.space = 0.0
        self.unjudged_returns = 0
        self._volume = cache(lambda shape: Shape(shape.mesh, shape.id, shape.category).volume)
        self._same: dict[tuple[Any, ...], list[tuple[Path, int, Provenance]]] = {}
        self._seeds: dict[tuple[Any, ...], int] = {}
        self._split = cache(library.split)

    def add(self, file: Path, pack: int | None, sentence: str) -> None:
        self.problems.append(FileProblem(file, pack, sentence))

    def is_unknown(self, pack: Pack) -> bool:
        """Return whether the library is another one, or a shape is missing: `verify` says so."""
        shapes = {item.shape for item in (*pack.items, *pack.outside)}
        return pack.library != LibraryRef.of(self.library) or any(
            shape not in self.library for shape in shapes
        )

    def pack_problems(self, pack: Pack, recorded: Iterable[str | None]) -> Iterator[str]:
        """Yield the problems of one pack, given its split as the file's name and manifest say."""
        evolved = pack.provenance if isinstance(pack.provenance, Evolved) else None
        played = pack.provenance if isinstance(pack.provenance, Played) else None
        puzzle = pack.provenance if isinstance(pack.provenance, Puzzle) else None
        if not (pack.items or isinstance(pack.provenance, Drawn)):
            yield "it holds no items"
        if evolved is not None:
            yield from settings_problems(pack, evolved)
        if puzzle is not None:
            yield from puzzle_problems(pack, puzzle)
        splits = dict.fromkeys(s for s in (*recorded, pack.provenance.split) if s is not None)
        if len(splits) > 1:
            yield f"it is recorded to be of several splits: {', '.join(map(repr, splits))}"
        for split in splits:
            yield from self._split_problems(pack, split)
        try:
            yield from verify(pack, self.library)
            placed = pack.placed(self.library)
        except (PackFormatError, UnknownShapeError):
            return  # reported by verify
        except PackItError as error:
            yield str(error)
            return
        if isinstance(pack.provenance, Densified) and placed:
            yield from density_problems(pack, placed, pack.provenance)
        self.volume += plain_sum(p.item.volume for p in placed)
        self.space += math.prod(pack.cells) / CELLS_PER_UNIT**3
        for shape in dict.fromkeys(p.item.shape for p in placed):
            yield from self._volume_problems(shape)
        on_grid = [one for one in placed if isinstance(one, PlacedItem)]
        if evolved is not None and pack.is_on_grid:
            yield from order_problems(pack.cells, on_grid)
        if played is not None:
            yield from self._own_problems(pack, played)
        if puzzle is not None:
            yield from insertion_problems(on_grid)
        if played is not None:
            yield from placement_problems(played.rules, pack.cells, on_grid)

    def _own_problems(self, pack: Pack, played: Played) -> Iterator[str]:
        self.unjudged_returns += task_of(pack, played) is None
        try:
            yield from result_problems(pack, played, lambda id: self.library[id].volume)
        except (UnknownShapeError, MeshError) as error:
            yield str(error)

    def _volume_problems(self, shape: Shape) -> Iterator[str]:
        """Yield a problem if the recorded volume is not that of the mesh."""
        measured = self._volume(shape)
        if not math.isclose(shape.volume, measured, rel_tol=VOLUME_SLACK):
            yield (
                f"the library records volume {shape.volume!r} for shape {shape.id!r}, "
                f"its mesh has {measured!r}"
            )

    def duplicate_problems(self, file: Path, number: int, pack: Pack) -> Iterator[str]:
        """Yield which earlier pack has the same items, or the same seed."""
        origin = pack.provenance
        items = (*sorted(pack.items, key=repr), *sorted(pack.outside, key=repr))
        same = self._same.setdefault((pack.library, pack.cells, *items), [])
        for other_file, other, other_origin in same:
            if not _may_be_alike(origin, other_origin):
                of = "" if other_file == file else f" of {other_file.name}"
                yield f"it is the same as pack {other}{of}"
                break
        same.append((file, number, origin))
        if isinstance(origin, Evolved | Densified | Played):
            part = None
            if not isinstance(origin, Densified):
                part = origin.after if isinstance(origin, Evolved) else origin.task
            first = self._seeds.setdefault((file, origin.producer, origin.seed, part), number)
            if first != number:
                yield f"its seed {origin.seed} is that of pack {first}"

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


class _DatasetFile:
    """A file: its readable packs with their numbers, and the number of all packs."""

    def __init__(self, file: Path, check: _DatasetCheck) -> None:
        self.file = file
        self.data = read_bytes(file)
        self.packs: list[tuple[int, Pack]] = []
        self.count = 0
        for number, line in numbered_lines(self.data):
            try:
                pack = Pack.from_json(line)
                json.loads(line, object_pairs_hook=_refuse_duplicates)
            except (ValueError, RecursionError) as error:
                check.add(file, self.count, f"line {number}: {error}")
            else:
                self.packs.append((self.count, pack))
            self.count += 1
        self.is_results = bool(self.packs) and all(
            isinstance(pack.provenance, Played) for _, pack in self.packs
        )
        if not self.count:
            check.add(file, None, "it holds no packs")
        elif not self.data.endswith(b"\n"):
            check.add(file, None, "its last line has no end")


def _check_folder(folder: Path, parts: Sequence[_DatasetFile], check: _DatasetCheck) -> None:
    """Check the names of a folder's files and manifests; results may have any name."""
    files = [part.file for part in parts]
    names = SPLITS if any(file.stem in SPLITS for file in files) else (WHOLE,)
    for part in parts:
        if part.file.stem not in names and not part.is_results:
            choices = ", ".join(names)
            check.add(part.file, None, f"a file of this folder can't have this name: {choices}")
    former = {*map(former_manifest_path, files)}
    for manifest in sorted({*folder.glob(f"*{SUFFIX}")} - former):
        if not manifest.with_name(manifest.name.removesuffix(SUFFIX)).exists():
            check.add(manifest, None, "there is no file that this manifest describes")


def _check_manifest(part: _DatasetFile, check: _DatasetCheck) -> Manifest | None:
    """Compare a manifest with its file; None if there is no manifest."""
    path = find_manifest(part.file, part.data)
    if path is None:
        check.add(part.file, None, f"it has no manifest {manifest_path(part.file).name}")
        return None
    try:
        manifest = Manifest.read(path)
    except PackFormatError as error:
        check.add(path, None, str(error))
        return None
    if manifest.format not in FORMATS:
        known = " and ".join(map(str, FORMATS))
        check.add(path, None, f"field 'format' is {manifest.format}: this version reads {known}")
    digest = hashlib.sha256(part.data).hexdigest()
    expected: dict[str, Any] = {"packs": part.count, "sha256": digest}
    if len(part.packs) == part.count:
        expected["libraries"] = tuple(dict.fromkeys(pack.library for _, pack in part.packs))
    for name, value in expected.items():
        if (recorded := getattr(manifest, name)) != value:
            sentence = f"field {name!r} is {recorded!r}, of {part.file.name} it is {value!r}"
            check.add(path, None, sentence)
    return manifest


def _refuse_duplicates(pairs: list[tuple[str, Any]]) -> None:
    """Raise PackFormatError if a JSON object has a field twice."""
    for key, count in Counter(key for key, _ in pairs).items():
        if count > 1:
            raise PackFormatError(f"field {key!r} comes twice")


def _may_be_alike(one: Provenance, other: Provenance) -> bool:
    """Return whether two packs may have the same items: rollouts, or packs of one history."""
    if isinstance(one, Evolved) and isinstance(other, Evolved):
        return one.seed == other.seed and None not in (one.after, other.after)
    return isinstance(one, Played) or isinstance(other, Played)
