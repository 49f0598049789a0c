"""Checks of settings and arguments against their valid values."""

import math
from dataclasses import dataclass
from typing import Any

from packit_sim.core.errors import ArgumentError


@dataclass(frozen=True)
class Range:
    """A range of valid numbers; NaN is in none.

    Parameters
    ----------
    low, high : float
        The ends.
    ends : str
        Which ends belong to the range, in interval notation: "[]" both, "(]" all but the lower.
    """

    low: float
    high: float = math.inf
    ends: str = "[]"

    def __contains__(self, value: float) -> bool:
        above = self.low < value if self.ends[0] == "(" else self.low <= value
        return above and (value < self.high if self.ends[1] == ")" else value <= self.high)

    def __str__(self) -> str:
        if self.ends == "[]" and self.high < math.inf:
            return f"{self.low:.10g} to {self.high:.10g}"
        parts = []
        if self.low > -math.inf:
            parts.append(f"{'above' if self.ends[0] == '(' else 'at least'} {self.low:.10g}")
        if self.high < math.inf:
            parts.append(f"{'below' if self.ends[1] == ')' else 'at most'} {self.high:.10g}")
        elif self.ends[1] == ")":
            parts.append("finite")
        return ", ".join(parts)


POSITIVE = Range(0, ends="()")
"""All finite numbers above 0."""


def check_range(name: str, value: float, valid: Range, unit: str = "") -> None:
    """Raise ArgumentError, which names the valid range, if a number is outside it."""
    if value not in valid:
        raise ArgumentError(f"{name} {value!r} is not possible: {valid} {unit}".rstrip())


def check_settings(settings: Any, kind: str = "", **checks: Range | tuple[bool, str]) -> None:
    """Check the settings of a record.

    Parameters
    ----------
    settings : object
        The record.
    kind : str
        The kind of settings in messages, such as "training setting".
    **checks : Range or tuple of bool and str
        By name, the valid range, or whether the value is valid and a description of valid values.

    Raises
    ------
    ArgumentError
        If a setting is not valid; the message contains its name, its value and what is valid.
    """
    for name, check in checks.items():
        value = getattr(settings, name)
        holds, valid = (value in check, check) if isinstance(check, Range) else check
        if not holds:
            label = f"{kind} {name} =" if kind else name
            raise ArgumentError(f"{label} {value!r} is not possible: {valid}")
