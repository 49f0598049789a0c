"""Limits on turning as text: a tilt such as "15deg", and sides such as "z- x+"."""

from __future__ import annotations

import re
from dataclasses import replace

from packit_sim.core.checks import shown
from packit_sim.core.errors import ArgumentError, about
from packit_sim.parts.packings.turning import ANY_TURN, SIDES, Turning

_ANGLE = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(?:deg|°)?\s*")


def read_angle(text: object) -> float:
    """Read an angle in degrees; raise ArgumentError if it is none."""
    if match := _ANGLE.fullmatch(str(text)):
        return float(match[1])
    raise ArgumentError(f"{shown(str(text))} is not an angle in degrees, such as 15deg")


def read_sides(text: object) -> tuple[str, ...]:
    """Read the sides that may face down, with blanks or commas between them."""
    sides = tuple(re.split(r"[\s,;|]+", str(text).strip()))
    for side in sides:
        if side not in SIDES:
            raise ArgumentError(f"{shown(side)} is not a side: choose from {', '.join(SIDES)}")
    return sides


def read_turning(max_tilt: str | None, down: str | None) -> Turning:
    """Read the limits of a command line."""
    with about("max_tilt"):
        turning = ANY_TURN if max_tilt is None else Turning(read_angle(max_tilt))
    with about("down"):
        return turning if down is None else replace(turning, down=read_sides(down))
