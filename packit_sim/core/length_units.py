"""Units of length, by the names that files and people use."""

from collections.abc import Mapping
from typing import Literal

Unit = Literal["micron", "mm", "cm", "in", "ft", "m"]

UNITS_CM: Mapping[Unit, float] = {
    "micron": 1e-4,
    "mm": 0.1,
    "cm": 1.0,
    "in": 2.54,
    "ft": 30.48,
    "m": 100.0,
}
"""Centimetres in a unit of length."""
