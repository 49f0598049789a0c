"""Packs of the original PackIt (Goyal and Deng, 2020), read as tasks of a shape library."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path

from packit_sim.core.errors import MeshError, PackItError, UnknownShapeError
from packit_sim.core.plain_text import listed
from packit_sim.game.datasets.original_files import (
    OriginalItem,
    OriginalPack,
    counted,
    list_files,
    read_pack_file,
)
from packit_sim.game.datasets.packs import ItemRecord, LibraryRef, Pack, Task
from packit_sim.game.datasets.provenance import FromOriginal
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.geometry.shapes import Item
from packit_sim.libraries import mesh_files
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.shapenet import CATEGORIES


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
        """Count in one line the packs that were read, kept whole, kept in part and left out."""
        origins = [task.pack.provenance for task in self.tasks]
        partial = sum(isinstance(one, FromOriginal) and one.left_out > 0 for one in origins)
        counts = {
            "whole": len(self.tasks) - partial,
            "without some of their items": partial,
            "left out": self.packs - len(self.tasks),
        }
        outcome = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        items = len(self.unresolved)
        return f"{counted(self.packs, 'pack')}: {outcome}; {counted(items, 'item')} without a shape"

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

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from packit_sim import ShapeLibrary, read_original
    >>> pack = {
    ...     "sources": ["Shapes_train/mug/beer-mug/model.obj", "Shapes_train/mug/cup/model.obj"],
    ...     "scales": [{"x": 0.5, "y": 0.5, "z": 0.5}] * 2,
    ...     "rotations": [{"x": 0, "y": 0, "z": 0, "w": 1}] * 2,
    ...     "positions": [{"x": 0, "y": 0, "z": 0}] * 2,
    ...     "efficiency": 0.1,
    ... }
    >>> _ = Path("0_tr").write_text(json.dumps({"data": [pack]}))
    >>> original = read_original("0_tr", ShapeLibrary.open("everyday"))
    >>> print(original.report())
    1 pack: 1 whole; 0 items without a shape
    >>> original.tasks[0].items[0].scale
    0.125
    """
    shapes = _Shapes(library)
    tasks: list[Task] = []
    unresolved: list[Unresolved] = []
    packs = 0
    for file in list_files(Path(path)):
        for number, (recorded, items) in enumerate(read_pack_file(file)):
            packs += 1
            task, problems = shapes.task(recorded, items, file.name, number)
            unresolved += problems
            if task.items and (partial or not problems):
                tasks.append(task)
            on_pack(file.name, number)
    return Original(tuple(tasks), packs, tuple(unresolved))


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
        self, recorded: OriginalPack, entries: list[OriginalItem], file: str, number: int
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

    def _item(self, entry: OriginalItem) -> Item:
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


def _printable(text: str) -> str:
    """Escape what a terminal or a file may refuse, so that the text is on one line."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
