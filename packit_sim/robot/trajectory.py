"""The trajectory of a whole box: what was tried, and each step of it, as a file."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from packit_sim.core import typed_json
from packit_sim.core.errors import PackFormatError
from packit_sim.geometry.items import ItemInBox, PlacedItem, PosedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.robot.cell import Cells, RobotCell
from packit_sim.robot.executed_item import ExecutedItem, Outcome
from packit_sim.robot.recording import Recording

FORMAT = 1
"""Version of the file."""

_ARRAYS = {"joints": (None, np.float64), "rows": (2, np.int64), "poses": (7, np.float64)}


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
    planned: tuple[float, ...]
    outcome: Outcome
    held: tuple[int, int]
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
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                head = typed_json.decode(
                    file["head"].tobytes(), _Head, PackFormatError, "a trajectory"
                )
                arrays = [
                    {name: file[f"{name}_{n}"] for name in _ARRAYS}
                    for n in range(len(head.attempts))
                ]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            if isinstance(error, PackFormatError):
                raise
            raise PackFormatError(f"not a trajectory: {error}") from None
        attempts = []
        for n, (record, own) in enumerate(zip(head.attempts, arrays, strict=True)):
            for name, (width, kind) in _ARRAYS.items():
                array = own[name]
                width = width or head.cell.joints
                if array.shape != (len(array), width) or array.dtype != kind:
                    raise PackFormatError(f"array {name}_{n} is {array.dtype} {array.shape}")
            item = Item(shape(record.shape), record.scale, record.rotation)
            planned = posed(item, record.planned)
            recording = Recording(
                own["joints"], record.held, record.radius, own["rows"], own["poses"]
            )
            chosen = planned if record.location is None else PlacedItem(item, record.location)
            attempts.append(Attempt(chosen, planned, record.outcome, recording))
        return cls(head.cell, head.cells, tuple(attempts))


def posed(item: Item, row: Sequence[float]) -> PosedItem:
    """Return an item at a recorded pose: position, and quaternion w, x, y, z."""
    x, y, z, *wxyz = map(float, row)
    a, b, c, d = wxyz
    return PosedItem.at(item, Motion.from_wxyz((a, b, c, d), np.array((x, y, z))))
