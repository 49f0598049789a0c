"""The format of the original PackIt's pack files (Goyal and Deng, 2020).

The meaning of the fields is that of the Unity scripts that write them (github.com/princeton-vl/
PackIt_Extra); `docs/benchmarks/original.md` lists how their packs differ from ours.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, field, structs

from packit_sim.core import typed_json
from packit_sim.core.errors import PackFormatError, located
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.libraries.data_files import read_bytes

SMALLEST, LARGEST = CELL, 1.75
"""Range of linear factors: a diagonal of one cell, and a little more than the box's diagonal."""

MAX_NUMBER = 1e6
"""Bound on the absolute value of other numbers."""

UNEQUAL = 1e-4
"""Largest relative difference between the factors along the three axes: rounding of their text."""

SKEW = 1e-3
"""Largest error of a rotation matrix's entry: rounding of single precision."""

_UNITY_TO_OURS = np.array(((-1, 0, 0), (0, 0, -1), (0, 1, 0)))
"""Maps Unity's left-handed, y-up axes to a canonical shape's: Unity reads an OBJ file with its x
reversed, and we turn the file's y up."""

_LOG = "_log"
"""Ending of the log file next to a pack file."""


Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
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


class OriginalPack(Struct):
    """A pack in the file, with an entry of each list for each item.

    Attributes
    ----------
    sources : tuple of str
        The name of each shape.
    scales : tuple of factors
        The linear factors along Unity's axes.
    rotations : tuple of quaternions
        The rotations in Unity's axes.
    positions : tuple of positions
        The positions in Unity's axes.
    efficiency : float
        The density that the generator measured.
    shape_scale : float, optional
        The field "shapeScale".
    """

    sources: Annotated[tuple[str, ...], Meta(min_length=1)]
    scales: tuple[_Factors, ...]
    rotations: tuple[_Quaternion, ...]
    positions: tuple[_Position, ...]
    efficiency: Annotated[float, Meta(ge=0, le=MAX_NUMBER)]
    shape_scale: Factor | UnsetType = field(default=UNSET, name="shapeScale")

    def items(self) -> list[OriginalItem]:
        """Return the items, or raise PackFormatError that names the wrong field."""
        for name in ("scales", "rotations", "positions"):
            entries = getattr(self, name)
            if len(entries) != len(self.sources):
                raise PackFormatError(
                    f"field {name!r} has {counted(len(entries), 'entry', 'entries')}, "
                    f"'sources' has {len(self.sources)}: both must have as many"
                )
        rows = zip(self.sources, self.scales, self.rotations, strict=True)
        return [
            OriginalItem(
                source, _scale(factors, f"scales[{n}]"), _rotation(turn, f"rotations[{n}]")
            )
            for n, (source, factors, turn) in enumerate(rows)
        ]


class _PackFile(Struct):
    """The content of a file; its packs are converted one by one."""

    data: Annotated[list[Any], Meta(min_length=1)]


@dataclass(frozen=True)
class OriginalItem:
    """An item of a pack, with our scale and rotation.

    Attributes
    ----------
    source : str
        The name of its shape.
    scale : float
        The scale, a ratio of volumes.
    rotation : int
        The index of the rotation, 0 to 23.
    """

    source: str
    scale: float
    rotation: int


def list_files(path: Path) -> list[Path]:
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


def read_pack_file(file: Path) -> Iterator[tuple[OriginalPack, list[OriginalItem]]]:
    """Read a pack file.

    Yields
    ------
    recorded : OriginalPack
        A pack.
    items : list of OriginalItem
        Its items.

    Raises
    ------
    PackFormatError
        If the file is not of this form; the message names the file, the pack and the field.
    """
    data = read_bytes(file)
    if not data.strip():
        raise PackFormatError(f"{file} is empty")
    with located(file, PackFormatError):
        typed_json.refuse_long_integers(data, PackFormatError)
    try:  # not by msgspec: unknown fields of another tool's file may be NaN
        raw = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise PackFormatError(f"{file} is not JSON: {error}") from None
    with located(file, PackFormatError):
        packs = typed_json.convert(raw, _PackFile, PackFormatError, "the file").data
    for number, pack in enumerate(packs):
        with located(f"{file}, pack {number}", PackFormatError):
            recorded = typed_json.convert(pack, OriginalPack, PackFormatError, "a pack")
            items = recorded.items()
        yield recorded, items


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
    quaternion = (recorded.x, recorded.y, recorded.z, recorded.w)
    length = math.hypot(*quaternion)
    if abs(length - 1) <= SKEW:
        x, y, z, w = (part / length for part in quaternion)
        unity = Motion.from_xyzw((x, y, z, w)).rotation
        errors = np.abs(rotations.MATRICES - _UNITY_TO_OURS @ unity @ _UNITY_TO_OURS.T)
        worst = errors.max(axis=(1, 2))
        nearest = int(worst.argmin())
        if worst[nearest] <= SKEW:
            return nearest
    raise PackFormatError(
        f"field {field!r} is {quaternion}: it must be a unit quaternion of one of the "
        f"{rotations.COUNT} rotations"
    )


def counted(number: int, one: str, many: str = "") -> str:
    """Format a number with a noun in the singular or the plural."""
    return f"{number} {one if number == 1 else many or one + 's'}"
