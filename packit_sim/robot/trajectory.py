"""The trajectory of a whole box: what was tried, and each step of it, as a file."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
import numpy.typing as npt

from packit_sim.core import typed_json
from packit_sim.core.errors import PackFormatError, PackItError, located
from packit_sim.core.npz_arrays import read_array
from packit_sim.geometry.items import ItemInBox, PlacedItem, PosedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.motions import UNIT_SLACK, Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.executed_item import ExecutedItem, Outcome
from packit_sim.robot.recording import Recording

FORMAT = 1
"""Version of the file."""

MAX_STEPS = 4_000_000
"""Most steps of a trajectory, and most recorded poses: 4 hours, and 224 MB."""

_MAX_HEAD = 2**24
"""Most bytes of the head of a file."""

_MAX_VALUE = 1e9
"""Largest joint or position in a file: far beyond all, but no sum or square of it overflows."""

_ARRAYS = {"joints": (None, "<f8"), "rows": (2, "<i8"), "poses": (7, "<f8")}
"""The length of a row of each array of a recording, and its type."""

_Row = tuple[float, float, float, float, float, float, float]

_Step = Annotated[int, msgspec.Meta(ge=0, le=MAX_STEPS)]


class AttemptRecord(msgspec.Struct, frozen=True):
    """The attempt to put one item into the box, as recorded.

    Attributes
    ----------
    shape : str
        The id of its shape.
    location : tuple of int, optional
        The chosen node of the grid; None if the placement was chosen off the grid.
    planned : tuple of float
        Where the arm was to release it: position in box units and quaternion w, x, y, z.
    held : tuple of int
        See `Recording`; so is `radius`.
    """

    shape: str
    scale: float
    rotation: int
    location: Triple | None
    planned: _Row
    outcome: Outcome
    held: tuple[_Step, _Step]
    radius: float


class _Head(msgspec.Struct, frozen=True):
    format: int
    cells: Cells
    cell: RobotCell
    attempts: tuple[AttemptRecord, ...]


@dataclass(frozen=True, eq=False)
class Attempt:
    """The attempt to put one item into the box.

    Attributes
    ----------
    chosen : ItemInBox
        The placement that was chosen for it.
    planned : PosedItem
        Where the arm was to release it.
    """

    chosen: ItemInBox
    planned: PosedItem
    outcome: Outcome
    recording: Recording


@dataclass(frozen=True, eq=False)
class Trajectory:
    """All attempts to pack a box.

    Attributes
    ----------
    cells : Cells
        The cells of the box along x, y and z.
    """

    cell: RobotCell
    cells: Cells
    attempts: tuple[Attempt, ...]

    @classmethod
    def of(cls, cell: RobotCell, cells: Cells, items: Sequence[ExecutedItem]) -> Trajectory:
        """Return the trajectory of a box's items."""
        attempts = (Attempt(i.chosen, i.planned, i.outcome, i.recording) for i in items)
        return cls(cell, cells, tuple(attempts))

    @property
    def digest(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.to_bytes()).hexdigest()

    def to_bytes(self) -> bytes:
        """Write a NumPy archive (.npz): "head", JSON in UTF-8, and the arrays of each recording."""
        records = []
        arrays: dict[str, npt.NDArray[Any]] = {}
        for n, one in enumerate(self.attempts):
            item, pose, own = one.chosen.item, one.planned.pose, one.recording
            records.append(
                AttemptRecord(
                    item.shape.id,
                    float(item.scale),
                    item.rotation,
                    one.chosen.location if isinstance(one.chosen, PlacedItem) else None,
                    (*pose.translation.tolist(), *pose.wxyz),
                    one.outcome,
                    own.held,
                    own.radius,
                )
            )
            arrays |= {f"{name}_{n}": getattr(own, name) for name in _ARRAYS}
        head = typed_json.encode(_Head(FORMAT, self.cells, self.cell, tuple(records))).encode()
        file = io.BytesIO()
        arrays["head"] = np.frombuffer(head, dtype=np.uint8)
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type] # one name is of a bool
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes, shape: Callable[[str], Shape]) -> Trajectory:
        """Read a file.

        Parameters
        ----------
        shape : callable
            Returns a shape by its id.

        Returns
        -------
        Trajectory
            The trajectory.

        Raises
        ------
        PackFormatError
            If it is not the file of a trajectory.
        UnknownShapeError
            If there is no such shape.
        """
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                text = read_array(archive, "head", ("|u1",), (None,), _MAX_HEAD).tobytes()
                head = typed_json.decode(text, _Head, PackFormatError, "a trajectory")
                if head.format != FORMAT:
                    raise PackFormatError(f"format {head.format} is not known: it must be {FORMAT}")
                recordings = _recordings(archive, head)
        except PackItError:
            raise
        except Exception as error:  # numpy and zipfile raise any error for a damaged file
            raise PackFormatError(f"not a trajectory: {error or type(error).__name__}") from None
        attempts = []
        for n, (record, recording) in enumerate(zip(head.attempts, recordings, strict=True)):
            with located(f"attempt {n}", PackItError):
                item = Item(shape(record.shape), record.scale, record.rotation)
                planned = posed(item, record.planned)
            chosen = planned if record.location is None else PlacedItem(item, record.location)
            attempts.append(Attempt(chosen, planned, record.outcome, recording))
        return cls(head.cell, head.cells, tuple(attempts))


def _recordings(archive: zipfile.ZipFile, head: _Head) -> list[Recording]:
    """Read the recordings of all attempts, or raise if one is not possible."""
    found, left = [], dict.fromkeys(_ARRAYS, MAX_STEPS)
    for n, record in enumerate(head.attempts):
        arrays = {}
        for name, (width, kind) in _ARRAYS.items():
            width = width or head.cell.joints
            most = left[name] * width * 8
            arrays[name] = read_array(archive, f"{name}_{n}", (kind,), (None, width), most)
            left[name] -= len(arrays[name])
        own = Recording(held=record.held, radius=record.radius, **arrays)
        if fault := _fault(n, record, own, head):
            raise PackFormatError(f"attempt {n}: {fault}")
        found.append(own)
    return found


def _fault(number: int, record: AttemptRecord, own: Recording, head: _Head) -> str:
    """Return what is not possible in the recording of an attempt; none if it is right."""
    steps, items = own.rows.T
    count = len(own.joints)
    values = (own.joints, own.poses, record.planned, record.location or ())
    if not all((np.abs(np.array(each, float)) <= _MAX_VALUE).all() for each in values):
        return f"a joint or a position is not a number up to {_MAX_VALUE:g}"
    lengths = np.linalg.norm([*own.poses[:, 3:], record.planned[3:]], axis=1)
    if not (np.abs(lengths - 1) <= UNIT_SLACK).all():
        return "a quaternion is no rotation: its length must be 1"
    if len(own.rows) != len(own.poses):
        return f"it has {len(own.rows)} rows and {len(own.poses)} poses"
    if not ((items >= 0) & (items <= number)).all():
        return f"a row is of an item that is none of the first {number + 1}"
    if not ((steps >= 0) & (steps < count)).all() or (np.diff(steps) < 0).any():
        return f"its rows are not those of its {count} steps, one after the other"
    if not record.held[0] <= record.held[1] <= count:
        return f"it is held from {record.held[0]} to {record.held[1]} of {count} steps"
    if count and record.radius not in head.cell.gripper.cups:
        return f"its cup of {record.radius} m is none of the gripper's"
    was_there = number in items[steps == 0]
    if not was_there and (count or record.outcome in (Outcome.PLACED, Outcome.LOST)):
        return "it does not say where the item is at first"
    return ""


def posed(item: Item, row: Sequence[float]) -> PosedItem:
    """Return an item at a recorded pose: position, and quaternion w, x, y, z."""
    x, y, z, *wxyz = map(float, row)
    a, b, c, d = wxyz
    return PosedItem.at(item, Motion.from_wxyz((a, b, c, d), np.array((x, y, z))))
