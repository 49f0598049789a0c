"""The sets of rotations that an item of a packing off the grid may take, by name."""

from __future__ import annotations

import math
import re
from functools import cache

import numpy as np

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats

FIXED = "fixed"
"""The name of the set of no rotation."""

FREE = "free"
"""The name of the set of all rotations: the only one that is not a list."""

MAX_STEPS = 360
"""Most steps of a full turn."""

_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
"""Cosine and sine of the multiples of 90 degrees."""


def check(name: str) -> None:
    """Raise ArgumentError, which lists the valid forms, if a name is none of a set."""
    if name not in (FIXED, "cube", FREE) and _steps(name) is None:
        raise ArgumentError(
            f"rotations {name!r} are not known: choose from fixed, yaw-N, flip-N, axis-N "
            f"(N steps of a full turn, 1 to {MAX_STEPS}), cube, {FREE}"
        )


def matrices(name: str) -> Floats:
    """Return the rotations of a set.

    Parameters
    ----------
    name : str
        `fixed`; `yaw-n`: n steps about z; `flip-n`: the same, and upside down; `axis-n`: one turn
        by a multiple of 360 / n degrees about one of the three coordinate axes; or `cube`: the 24
        proper rotations of the cube.

    Returns
    -------
    ndarray of float64, shape (n, 3, 3)
        Matrices, each once, the identity first. Turns by 90 degrees have entries -1, 0 and 1.

    Raises
    ------
    ArgumentError
        If there is no such set, or if it is `FREE`, which has no list.
    """
    check(name)
    if name == FREE:
        raise ArgumentError(f"rotations {FREE!r} are all rotations: they can't be listed")
    return _matrices(name)


@cache
def _matrices(name: str) -> Floats:
    if name == "cube":
        found = rotations.MATRICES.astype(float)
    elif name == "fixed":
        found = np.eye(3)[None]
    else:
        kind, steps = name.split("-")
        turns = [(axis, step) for axis in (2, 0, 1) for step in range(1, int(steps))]
        kept = [
            _turn(axis, step, int(steps)) for axis, step in turns if kind == "axis" or axis == 2
        ]
        found = np.array([np.eye(3), *kept])
        if kind == "flip":
            found = np.concatenate((found, found @ np.diag((1.0, -1.0, -1.0)) + 0.0))
    found.setflags(write=False)
    return found


def _turn(axis: int, step: int, steps: int) -> Floats:
    quarters, rest = divmod(4 * step, steps)
    angle = 2 * math.pi * step / steps
    cosine, sine = (math.cos(angle), math.sin(angle)) if rest else _QUARTERS[quarters]
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[one, one] = matrix[other, other] = cosine
    matrix[one, other], matrix[other, one] = -sine, sine
    return matrix + 0.0  # no -0.0


def _steps(name: str) -> int | None:
    match = re.fullmatch(r"(?:yaw|flip|axis)-([1-9][0-9]{0,2})", str(name))
    steps = int(match[1]) if match else 0
    return steps if 1 <= steps <= MAX_STEPS else None
