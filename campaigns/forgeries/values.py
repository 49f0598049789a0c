"""Types and ranges of the values of a record, as the guides and docstrings state them.

Nothing here is of PackIt-Sim.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import NoneType
from typing import Any

import numpy as np

from campaigns.packings.shapes import Floats

TYPES: Mapping[str, tuple[type, ...]] = {
    "name": (str,),
    "mesh": (str, NoneType),
    "sha256": (str, NoneType),
    "count": (int,),
    "scale": (float,),
    "up": (str,),
    "rotations": (str,),
    "value": (float, NoneType),
    "priority": (int,),
    "mass": (float, NoneType),
    "density": (float, NoneType),
    "no stack": (bool,),
    "max load": (float, NoneType),
    "deviation": (float,),
    "as many as fit": (bool,),
    "clearance": (float, NoneType),
    "group": (str, NoneType),
    "max tilt": (float,),
    "down": (list,),
    "stop": (int, NoneType),
}
"""The types of the fields of a requested part; an integer is a float, too."""

SIDES: Mapping[str, Floats] = {
    f"{name}{sign}": np.where(np.arange(3) == axis, 1.0 if sign == "+" else -1.0, 0.0)
    for axis, name in enumerate("xyz")
    for sign in "-+"
}
"""The sides of a part by name, with the directions out of them."""

ABSENT: Mapping[str, Any] = {
    "as many as fit": False,
    "clearance": None,
    "group": None,
    "max tilt": 180.0,
    "down": list(SIDES),
    "stop": None,
}
"""Fields of a requested part that earlier versions did not write, with what that means."""

RANGES: Mapping[str, tuple[float, float]] = {
    "count": (1, 10_000),
    "value": (0, 1e12),
    "priority": (-1e9, 1e9),
    "mass": (1e-9, 1e12),
    "density": (1e-9, 1e6),
    "max load": (0, 1e12),
    "deviation": (0, 1e30),
    "clearance": (0, 1e30),
    "max tilt": (0, 180),
    "stop": (1, 10_000),
}

UPS: Mapping[str, Floats] = {
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "z": np.eye(3),
}
"""From the axes of a file to z up."""


class Wrong(Exception):
    """The fault of a record."""


def require(holds: bool, what: str) -> None:
    """Raise Wrong if something does not hold."""
    if not holds:
        raise Wrong(what)


def check_types(part: Mapping[str, Any]) -> None:
    """Raise Wrong if a requested part lacks a field, or has one of another type."""
    for key, types in TYPES.items():
        kinds = (*types, int) if float in types else types
        require(key in part and type(part[key]) in kinds, f"field {key!r} of a part")
    require(part["scale"] > 0, "the scale of a part")


def out_of_range(part: Mapping[str, Any]) -> list[str]:
    """List the fields of a requested part that have a value that is not possible."""
    found = [] if part["up"] in UPS else ["up"]
    down = part.get("down", list(SIDES))
    found += [] if down and all(each in SIDES for each in down) else ["down"]
    for key, (low, high) in RANGES.items():
        value = part.get(key)
        found += [] if value is None or low <= value <= high else [key]
    return found


def as_number(value: Any) -> float:
    """Return a number; raise Wrong if it is none."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    require(is_number and abs(value) < 1e300, f"{value!r:.40}")
    return float(value)


def as_walls(value: Any) -> tuple[Floats, Floats]:
    """Return the distances (3,) from the walls at 0, and from the opposite ones."""
    if not isinstance(value, dict):
        value = {"sides": value, "floor": value, "top": value}
    sides, floor, top = (as_number(value.get(name, 0.0)) for name in ("sides", "floor", "top"))
    require(min(sides, floor, top) >= 0, "wall clearance")
    return np.array((sides, sides, floor)), np.array((sides, sides, top))


def as_integer(value: Any) -> int:
    """Return an integer; raise Wrong if it is none."""
    require(type(value) is int, f"{value!r:.40} is no integer")
    return int(value)


def as_text(value: Any) -> str:
    """Return a text; raise Wrong if it is none."""
    require(isinstance(value, str), f"{value!r:.40} is no text")
    return str(value)


def is_same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, and both truth values or neither."""
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)


def as_matrix(rows: Any) -> Floats:
    """Return a matrix (4, 4); raise Wrong if it is none, or not finite."""
    require(len(rows) == 4 and all(len(row) == 4 for row in rows), "no matrix")
    pose = np.array([[as_number(each) for each in row] for row in rows])
    require(bool((np.abs(pose) < 1e30).all()), "no finite matrix")
    return pose
