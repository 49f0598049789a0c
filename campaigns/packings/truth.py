"""Cases: parts whose meshes are known from formulas, boxes and rules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from campaigns.packings.shapes import Floats, Shape

MILLIMETRES: Mapping[str, float] = {
    "micron": 1e-3,
    "mm": 1.0,
    "cm": 10.0,
    "in": 25.4,
    "ft": 304.8,
    "m": 1000.0,
}
"""Millimetres in each unit of length."""


@dataclass(frozen=True, eq=False)
class TruePart:
    """A part as its owner means it.

    Attributes
    ----------
    file : str
        How the name of its file begins.
    token : str
        What its name contains, if its file has several parts.
    kind : str
        The format of its file.
    shape : Shape
        The solid, in millimetres.
    user_from_shape : tuple of ndarray of float64, shape (4, 4)
        Where the file has copies of it, in millimetres with z up.
    up : ndarray of float64, shape (3, 3)
        From the axes of its file to z up.
    count : int
        How many are asked for.
    rotations : str
        The set of its rotations.
    density : float, optional
        Grams per cubic centimetre.
    rounding : float
        The largest error of the file's coordinates, in millimetres.
    """

    file: str
    token: str
    kind: str
    shape: Shape
    user_from_shape: tuple[Floats, ...]
    up: Floats
    count: int
    rotations: str
    density: float | None
    rounding: float


@dataclass(frozen=True, eq=False)
class TrueBox:
    """A size of boxes, in millimetres, and the most of them; None for any number."""

    name: str
    size: Floats
    count: int | None


@dataclass(frozen=True, eq=False)
class Truth:
    """A case, in millimetres.

    Attributes
    ----------
    unit : str
        The unit of the results.
    unread : tuple of str
        Texts of which each must be among the files that are not read.
    list_kind : str
        The format of the list of parts, or "" without one.
    keep_out : Shape, optional
        What stays free in every box.
    """

    parts: tuple[TruePart, ...]
    boxes: tuple[TrueBox, ...]
    unit: str
    clearance: float
    wall_clearance: float
    insertable: bool
    unread: tuple[str, ...]
    list_kind: str
    keep_out: Shape | None = None


@dataclass(frozen=True)
class Problem:
    """Something that is wrong in a result, and the formats of the parts that it is about.

    Attributes
    ----------
    kinds : tuple of str
        The formats; none if it is about the packing as a whole.
    is_unread : bool
        Whether it is only that a file was not read, which the result says.
    """

    text: str
    kinds: tuple[str, ...] = ()
    is_unread: bool = False
