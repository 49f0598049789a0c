"""Checks of settings and arguments against their valid values."""

import math
import operator
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

from packit_sim.core.errors import ArgumentError


@dataclass(frozen=True)
class Range:
    """A range of valid numbers; NaN is in none.

    Parameters
    ----------
    low, high : float
        The ends.
    ends : str
        The ends that belong to the range, in interval notation: "[]" both, "(]" all but the lower.
    """

    low: float
    high: float = math.inf
    ends: str = "[]"

    def __contains__(self, value: float) -> bool:
        try:
            above = self.low < value if self.ends[0] == "(" else self.low <= value
            return above and (value < self.high if self.ends[1] == ")" else value <= self.high)
        except TypeError:  # of what is no number
            return False

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


_MOST_SHOWN = 80
"""Most characters or digits of a value in a message."""

POSITIVE = Range(0, ends="()")
"""All finite numbers above 0."""


Valid: TypeAlias = Range | tuple[bool, str]
"""The valid range of a number, or whether a value is valid and a description of valid values."""


def shown(value: object) -> str:
    """Return a value as messages show it; Python prints no integer of more than 4,300 digits."""
    if isinstance(value, int) and abs(value) >= 10**_MOST_SHOWN:
        return f"of {int(math.log10(abs(value))) + 1:,} digits"
    return f"{value!r:.{_MOST_SHOWN}}"


def check_range(name: str, value: Any, valid: Valid, unit: str = "") -> None:
    """Raise ArgumentError, which lists the valid values, if a value is not valid."""
    holds, description = (value in valid, valid) if isinstance(valid, Range) else valid
    if not holds:
        raise ArgumentError(f"{name} {shown(value)} is not possible: {description} {unit}".rstrip())


def as_integer(name: str, value: Any) -> int:
    """Return an integer of any library's type as an int.

    Parameters
    ----------
    name : str
        The name of the argument in the message.
    value : object
        The argument: an int, an integer of NumPy, or an array of one without axes.

    Returns
    -------
    int
        The same number.

    Raises
    ------
    ArgumentError
        If the value is something else, such as a bool, a float or a text.
    """
    try:
        if isinstance(value, bool):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise ArgumentError(
            f"{name} {shown(value)} is not possible: it must be an integer"
        ) from None


def check_settings(settings: Any, kind: str = "", **checks: Valid) -> None:
    """Check the settings of a record.

    Parameters
    ----------
    settings : object
        The record.
    kind : str
        The kind of settings in messages, such as "training setting".
    **checks : Valid
        The valid values, by the name of the setting.

    Raises
    ------
    ArgumentError
        If a setting is not valid; the message contains its name, its value and the valid values.
    """
    for name, valid in checks.items():
        check_range(f"{kind} {name} =" if kind else name, getattr(settings, name), valid)


def one_of(setting: str, value: object, valid: tuple[object, ...]) -> None:
    """Raise ArgumentError if the value of a setting is not one of the valid ones."""
    if value not in valid:
        choices = ", ".join(map(repr, valid))
        raise ArgumentError(f"{setting} {value!r} is not known: choose from {choices}")


def check_keywords(call: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Check keyword arguments that a function passes on.

    Parameters
    ----------
    call : str
        The function, as Python names it in its own messages, such as "Rules.changed".

    Raises
    ------
    TypeError
        If one is not known: in Python's own words, which other libraries look for, and then the
        known ones.
    """
    known = tuple(known)
    for name in given:
        if name not in known:
            raise TypeError(
                f"{call}() got an unexpected keyword argument {name!r}: "
                f"choose from {', '.join(known)}"
            )


def check_same(**values: tuple[Any, Any]) -> None:
    """Check that a saved state belongs to what resumes from it.

    Parameters
    ----------
    **values : tuple
        The value then and the value now, by name.

    Raises
    ------
    ArgumentError
        If two of them differ; the message contains both.
    """
    for name, (then, now) in values.items():
        if then != now:
            raise ArgumentError(f"{name} was {then!r}, now {now!r}: it can't be resumed")
