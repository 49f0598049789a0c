"""Pictures of packings, and the boxes that viewers and pages show."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.shapes import Item
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.posed_parts import contents
from packit_sim.render.coloring import UNKNOWN_COLOR, Colors, by_item
from packit_sim.render.looks import Look
from packit_sim.scene import Scene

_CELLS = range(100, 129)
"""Possible numbers of cells along the longest side."""

SIZE = 1200, 900
"""Pixels of a picture."""


def shown(packing: Packing) -> BoxState[PosedItem]:
    """Return a box with all of its parts.

    Parameters
    ----------
    packing : Packing
        The parts in the box.

    Returns
    -------
    BoxState
        The box in box units: its longest side has 100 to 128 cells, so many that the others are
        nearly whole numbers of cells.
    """
    sides = np.array(packing.sides) / packing.container.longest
    count = min(_CELLS, key=lambda n: float(np.abs(sides * n - np.round(sides * n)).max()))
    return contents(packing, range(len(packing.placements)), count * CELL)


def draw(packing: Packing, path: str | os.PathLike[str], keep_out: Sequence[ItemType] = ()) -> None:
    """Draw a box and write the picture as PNG.

    Parameters
    ----------
    packing : Packing
        The parts in the box.
    keep_out : sequence of ItemType
        Volumes that stay free, in the box's coordinates: they are grey.
    """
    first = len(packing.types)
    volumes = (Placement(first + n) for n in range(len(keep_out)))
    whole = replace(
        packing,
        types=(*packing.types, *keep_out),
        placements=(*packing.placements, *volumes),
    )

    def colors(items: Sequence[Item]) -> Colors:
        parts = by_item(items[: len(packing.placements)]).of
        return Colors((*parts, *(UNKNOWN_COLOR,) * len(keep_out)))

    with Scene(shown(whole)) as scene:
        scene.snapshot(*SIZE, Look(coloring=colors)).save(path)
