"""The hand-made shapes of `packit selftest`, cubes, and boxes filled with items."""

from __future__ import annotations

import numpy as np

from packit_sim.box import Box
from packit_sim.geometry.shapes import Item
from packit_sim.selftest.hard_shapes import (
    BALL,
    BOWL,
    CUBE,
    HOLLOW,
    PLATE,
    RING,
    SOUP,
    TILTED,
    ZOO,
    item_of,
    nested_pair,
    random_item,
)

__all__ = [
    "BALL",
    "BOWL",
    "CUBE",
    "HOLLOW",
    "PLATE",
    "RING",
    "SOUP",
    "TILTED",
    "ZOO",
    "cube_of",
    "fill",
    "item_of",
    "nested_pair",
    "random_item",
]


def cube_of(cells: float) -> Item:
    """A cube of so many cells a side."""
    return Item(CUBE, scale=(cells / 100 * 3**0.5) ** 3)


def fill(box: Box, items: list[Item], rng: np.random.Generator) -> None:
    """Places what fits, each at a feasible location by chance, half of them at the BLBF one."""
    for item in items:
        locations = np.argwhere(box.feasible(item))
        if len(locations):
            bottom_left_back = rng.random() < 0.5
            location = box.blbf(item) if bottom_left_back else rng.choice(locations)
            assert location is not None
            box.place(item, location)
