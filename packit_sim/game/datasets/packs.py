"""Packs and tasks: records of packed boxes, and their items for an agent to pack again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, structs

from packit_sim.box import BaseBox, Box
from packit_sim.core import typed_json
from packit_sim.core.caches import cached_property
from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import ArgumentError, PackFormatError
from packit_sim.core.sums import plain_sum
from packit_sim.core.version import __version__
from packit_sim.game.datasets import format_1
from packit_sim.game.datasets.provenance import UNKNOWN_PROVENANCE, Provenance, RotationIndex
from packit_sim.geometry.items import BoxState, ItemInBox, PlacedItem, PosedItem
from packit_sim.geometry.lattice import (
    BOX_CELLS,
    CELL,
    CELLS_PER_UNIT,
    MAX_CELLS,
    Triple,
    box_cells,
)
from packit_sim.geometry.motions import Motion, Quaternion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.placement import checked_location

FORMAT = 2
"""Version of the format of packs, results and manifests that this module writes."""

FORMATS = (format_1.FORMAT, FORMAT)
"""The versions that this module reads."""

MAX_SCALE = (MAX_CELLS / CELLS_PER_UNIT) ** 3 * 3**1.5
"""The largest possible scale: a shape's longest extent is at least 1 / sqrt(3)."""

Scale = Annotated[float, Meta(gt=0, le=MAX_SCALE)]

MAX_VALUE = 1e12
"""The largest possible value of an item, as of a part: no sum of values overflows."""

Value = Annotated[float, Meta(gt=0, le=MAX_VALUE)]

Kind = tuple[str, float]
"""The shape and the scale of an item."""

Fact = Kind | tuple[str, float, float]
"""The same, with the value of an item that has one."""


@dataclass(frozen=True)
class LibraryRef:
    """The shape library that a pack's shape ids refer to.

    Attributes
    ----------
    name : str
        The library's name.
    digest : str
        The SHA-256 of its content, in hex.
    source : str, optional
        The argument that opens it here, if known: a name or a path (see `ShapeLibrary.locator`).
        Manifests record it, packs do not; it has no influence on equality.
    """

    name: str
    version: str
    digest: str
    source: str | None = dataclasses.field(default=None, compare=False)

    @classmethod
    def of(cls, library: ShapeLibrary) -> LibraryRef:
        return cls(library.name, library.version, library.digest, library.locator)

    def facts(self) -> dict[str, str]:
        """Return the fields that identify the library: all but its source."""
        return {"name": self.name, "version": self.version, "digest": self.digest}


class PoseRecord(Struct, frozen=True):
    """A rigid pose off the grid, as recorded.

    It is a `Motion` in JSON's types, which have no arrays.

    Attributes
    ----------
    position : tuple of float
        The translation x, y, z in box units.
    wxyz : Quaternion
        The rotation from the canonical shape, as a unit quaternion w, x, y, z.
    """

    position: tuple[float, float, float]
    wxyz: Quaternion


class _Valued(Struct, frozen=True, kw_only=True, omit_defaults=True):
    value: Value | None = None


class ItemRecord(_Valued, frozen=True):
    """One item of a task that is not in the box.

    Attributes
    ----------
    shape : str
        The id of its shape.
    scale : float
        Its scale, a ratio of volumes.
    value : float, optional
        Its value, by which `Rules(values=True)` counts it. Either all items of a task have values,
        equal ones the same, or none has.
    """

    shape: str
    scale: Scale

    @property
    def kind(self) -> Kind:
        """Its shape and its scale, which equal items share."""
        return self.shape, self.scale

    @property
    def facts(self) -> Fact:
        """Its shape, scale, and value if it has one: its part of the digest of its task."""
        return self.kind if self.value is None else (*self.kind, self.value)


class PackedItem(ItemRecord, frozen=True):
    """One item of a pack: on the grid at a location, or off the grid with a pose.

    Attributes
    ----------
    rotation : int
        The index of the rotation in which it was placed, 0 to 23.
    location : tuple of int, optional
        The grid node of its cell box's minimum corner, for an item on the grid.
    pose : PoseRecord, optional
        The pose in which it came to rest, for an item that settled.
    counted : bool
        Whether its volume counts for the density: items that settled count while they are inside
        the box and stable.
    """

    rotation: RotationIndex
    location: Triple | None = None
    pose: PoseRecord | None = None
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
        x, y, z = inside.pose.translation.tolist()
        return cls(*fields, None, PoseRecord((x, y, z), inside.pose.wxyz), bool(inside.counts))

    def placed(self, item: Item) -> PlacedItem | PosedItem:
        """Return the given item at the recorded location or pose."""
        if self.location is not None:
            return PlacedItem(item, self.location)
        assert self.pose is not None
        return PosedItem.at(item, Motion.from_wxyz(self.pose.wxyz, np.array(self.pose.position)))


@dataclass(frozen=True)
class Pack:
    """A packed box: its items in the order of placing, and its provenance.

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
        The origin of the pack.
    outside : tuple of ItemRecord
        Further items of its task: those that an agent left outside, or all of its items if no
        solution on the grid is known, as for the original PackIt's packs.

    Examples
    --------
    >>> from packit_sim import Pack, ShapeLibrary, dataset_file, read_packs
    >>> library = ShapeLibrary.open("everyday")
    >>> pack = read_packs(dataset_file("starter"))[0]
    >>> pack.items[0]
    PackedItem(shape='speaker', scale=0.906..., rotation=15, location=(0, 0, 0), ...)
    >>> pack.replay(library)
    Box((100, 100, 100), 35 items, density 0.431)
    >>> Pack.from_json(pack.to_json()) == pack
    True
    """

    library: LibraryRef
    cells: Triple
    items: tuple[PackedItem, ...]
    density: Annotated[float, Meta(ge=0)]
    provenance: Provenance = UNKNOWN_PROVENANCE
    outside: tuple[ItemRecord, ...] = ()

    @classmethod
    def of(
        cls,
        box: BaseBox[Any],
        library: LibraryRef | ShapeLibrary,
        provenance: Provenance = UNKNOWN_PROVENANCE,
    ) -> Pack:
        """Record the content of a box.

        Parameters
        ----------
        box : BaseBox
            A `Box`, or a `SettlingBox`, whose items get poses instead of locations.
        library : LibraryRef or ShapeLibrary
            The library of the items' shapes.
        provenance : Provenance
            The origin of the pack.

        Returns
        -------
        Pack
            The pack, whose density is the box's.
        """
        reference = library if isinstance(library, LibraryRef) else LibraryRef.of(library)
        items = tuple(PackedItem.of(inside) for inside in box.placed)
        return cls(reference, box.cells, items, float(box.density), provenance)

    @property
    def is_on_grid(self) -> bool:
        """True if all items have a location on the grid."""
        return all(item.location is not None for item in self.items)

    @cached_property
    def values(self) -> Mapping[Kind, float]:
        """The values of its items, in the box and outside, by shape and scale; empty without."""
        records = (*self.items, *self.outside)
        return {one.kind: one.value for one in records if one.value is not None}

    def valued(self, values: Mapping[Kind, float]) -> Pack:
        """Return the pack with other values of its items, by shape and scale; empty for none."""
        items = (structs.replace(one, value=values.get(one.kind)) for one in self.items)
        outside = (structs.replace(one, value=values.get(one.kind)) for one in self.outside)
        return dataclasses.replace(self, items=tuple(items), outside=tuple(outside))

    @property
    def counted_volume(self) -> float:
        """The volume of the items that count, in box units cubed."""
        return self.density * float(np.prod(self.cells)) * CELL**3

    def placed(self, library: ShapeLibrary) -> tuple[PlacedItem | PosedItem, ...]:
        """Return the items in their poses, unchecked.

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
                f"the pack is of library {self.library.name!r} {self.library.version} "
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
            The content of the box.

        Raises
        ------
        PackFormatError
            If items settled off the grid, or if `placed` raises it.
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
        """Pack a new box, item by item.

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
            If items settled off the grid, or if `placed` raises it.
        """
        box = Box(self.cells)
        for placed in self.contents(library).placed:
            box.place(placed.item, placed.location)
        return box

    def task(self, library: ShapeLibrary) -> Task:
        """Return the task of the pack, its items sorted by shape and scale."""
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
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        fields["library"] = self.library.facts()
        if not self.outside:
            del fields["outside"]
        return typed_json.encode({"format": FORMAT, "version": __version__, **fields})

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
            The pack. Every field is in range; whether items overlap is not checked.

        Raises
        ------
        PackFormatError
            If the line is not a pack; the message names the field that is wrong.
        """
        number = typed_json.format_of(line, PackFormatError, "a pack")
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
        """Raise PackFormatError if the box or a location is not possible."""
        n: int | None = None
        try:
            box_cells(self.cells)
            for n, item in enumerate(self.items):  # noqa: B007 (used in the message)
                if item.location is not None:
                    checked_location(self.cells, item.location)
        except ValueError as error:
            field = "cells" if n is None else f"items[{n}].location"
            raise PackFormatError(f"field {field!r}: {error}") from None
        values = self.values
        for one in (*self.items, *self.outside):
            if values and one.value != values.get(one.kind):
                raise PackFormatError(
                    f"field 'value' of {one.shape!r} (scale {one.scale:g}) is {one.value!r}: "
                    "either all items have values, equal ones the same, or none has"
                )


@dataclass(frozen=True)
class Task:
    """The items of a pack outside the box, in canonical orientation.

    Attributes
    ----------
    items : tuple of Item
        The items, sorted by shape and scale.
    pack : Pack
        The ground truth.
    solution : tuple of tuple
        (index into items, rotation, location) for each of the pack's items, in its order; empty
        if items settled off the grid.

    Examples
    --------
    >>> from packit_sim import load_tasks
    >>> task = load_tasks("starter")[0]
    >>> task.items[0].shape
    Shape('air-mattress', 'bed', 728 triangles)
    >>> task.cells, round(task.volume, 3)
    ((100, 100, 100), 0.431)
    >>> task.digest
    '1509aee4e479403a'
    """

    items: tuple[Item, ...]
    pack: Pack
    solution: tuple[tuple[int, int, Triple], ...]

    @classmethod
    def of(
        cls,
        items: Sequence[Item],
        cells: Sequence[int] = BOX_CELLS,
        library: ShapeLibrary | None = None,
    ) -> Task:
        """Create a task of items, without a known solution.

        Parameters
        ----------
        items : sequence of Item
            One item or more, in any order; `Item.of_size` creates items of a given size. Their
            rotations have no effect.
        cells : sequence of int
            Cells of the box along x, y and z: a cell is 1/100 of a box unit.
        library : ShapeLibrary, optional
            The library of the shapes, which results record. Without one, tasks can be played, but
            results can't be verified or drawn from their file.

        Returns
        -------
        Task
            The task.

        Raises
        ------
        ArgumentError
            If there is no item, one does not fit into the empty box in any rotation, a shape is not
            that of the library, or two shapes have the same id.
        UnknownShapeError
            If the library does not have a shape.

        Examples
        --------
        >>> from packit_sim import Item, ShapeLibrary, Task, evaluate
        >>> library = ShapeLibrary.open("everyday")
        >>> sizes = {"teapot": 22, "coffee-mug": 12, "basketball": 24}  # in cm
        >>> items = [Item.of_size(library[id], size, unit=40) for id, size in sizes.items()]
        >>> task = Task.of(items, (100, 80, 80), library)  # a box of 40 x 32 x 32 cm
        >>> [round(float(item.extents.max()), 2) for item in task.items]
        [0.6, 0.3, 0.55]
        >>> round(evaluate(["largest-first/aligned/blbf"], [task], seed=0)[0].total, 3)
        0.91
        """
        box = box_cells(cells)
        ranked = sorted((one.turned(0) for one in items), key=lambda i: (i.shape.id, i.scale))
        if not ranked:
            raise ArgumentError("a task needs an item")
        shapes: dict[str, Shape] = (
            {} if library is None else {i.shape.id: library[i.shape.id] for i in ranked}
        )
        for item in ranked:
            shape = shapes.setdefault(item.shape.id, item.shape)
            if shape != item.shape:
                other = "another one of the task" if library is None else repr(library)
                raise ArgumentError(
                    f"shape {shape.id!r} is not that of {other}: their meshes differ"
                )
            if any(np.sort(item.cells) > np.sort(box)):
                raise ArgumentError(
                    f"{shape.id!r} (scale {item.scale:g}) needs {item.cells} cells: it fits into "
                    f"no box of {box}"
                )
        if library is None:
            meshes = "".join(shape.digest for _, shape in sorted(shapes.items()))
            reference = LibraryRef("none", "", hashlib.sha256(meshes.encode()).hexdigest())
        else:
            reference = LibraryRef.of(library)
        outside = tuple(ItemRecord(item.shape.id, item.scale) for item in ranked)
        return cls(tuple(ranked), Pack(reference, box, (), 0.0, outside=outside), ())

    @property
    def cells(self) -> Triple:
        """The box's cells along x, y and z."""
        return self.pack.cells

    @property
    def volume(self) -> float:
        """The total volume of the items, in box units cubed."""
        return plain_sum(item.volume for item in self.items)

    @cached_property
    def values(self) -> tuple[float, ...]:
        """The value of each item; empty if they have none."""
        by_kind = self.pack.values
        return tuple(by_kind[i.shape.id, i.scale] for i in self.items) if by_kind else ()

    def valued(self, value: Callable[[Item], float]) -> Task:
        """Return the task with other values of its items, which `Rules(values=True)` counts.

        Parameters
        ----------
        value : callable
            The value of an item, above 0 and at most 1e12; called once for equal items.

        Returns
        -------
        Task
            The task, another one by its digest.

        Raises
        ------
        ArgumentError
            If a value is not possible, or the task has other items than its pack.

        Examples
        --------
        >>> from packit_sim import Rules, evaluate, load_tasks
        >>> task = load_tasks("starter")[0].valued(lambda item: 5 if item.volume < 0.01 else 1)
        >>> sum(task.values)
        83.0
        >>> (rollout,) = evaluate(
        ...     ["largest-first/aligned/blbf"], [task], seed=0, rules=Rules(values=True)
        ... )
        >>> round(rollout.total, 3)
        0.506
        """
        kinds = {(item.shape.id, item.scale): item for item in self.items}
        if {one.kind for one in (*self.pack.items, *self.pack.outside)} != kinds.keys():
            raise ArgumentError("the task has other items than its pack: values are stored there")
        values = {kind: value(item) for kind, item in kinds.items()}
        for (shape, _), each in values.items():
            check_range(f"value of {shape!r}", each, Range(0, MAX_VALUE, "(]"))
        pack = self.pack.valued({kind: float(each) for kind, each in values.items()})
        return dataclasses.replace(self, pack=pack)

    @property
    def digest(self) -> str:
        """A digest of the library, the box's cells and the items, which identifies the task.

        It does not depend on the order of the items.
        """
        values = self.pack.values
        kinds = [(item.shape.id, item.scale) for item in self.items]
        items = sorted((*kind, values[kind]) if values else kind for kind in kinds)
        return task_digest(self.pack.library.digest, self.cells, items)

    @cached_property
    def arriving(self) -> Task:
        """The same task with its items in the order in which they arrive in the online game."""
        ranked = sorted(
            range(len(self.items)),
            key=lambda n: (self.items[n].shape.id, self.items[n].scale),
        )
        order = [ranked[n] for n in arrival_order(self.digest, len(ranked))]
        items = tuple(self.items[n] for n in order)
        if items == self.items:
            return self
        steps = tuple((order.index(n), turn, at) for n, turn, at in self.solution)
        return dataclasses.replace(self, items=items, solution=steps)


def task_digest(library: str, cells: Triple, items: Sequence[Fact]) -> str:
    """Compute the digest of a task.

    Parameters
    ----------
    library : str
        The digest of its library.
    cells : tuple of int
        The box's cells along x, y and z.
    items : sequence of tuple
        The shape and scale of each item, and its value if items have values; sorted.

    Returns
    -------
    str
        16 hex digits.
    """
    facts = (library, cells, items)
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


def arrival_order(digest: str, count: int) -> list[int]:
    """Return the order in which the items of a task arrive in the online game.

    Parameters
    ----------
    digest : str
        The digest of the task.
    count : int
        The number of its items.

    Returns
    -------
    list of int
        Indices into the items sorted by shape and scale, the first to arrive first.

    Notes
    -----
    The order is that of SHA-256 of "DIGEST INDEX": as if drawn at random, and the same wherever the
    task is played or its results are verified.
    """
    return sorted(range(count), key=lambda n: hashlib.sha256(f"{digest} {n}".encode()).digest())
