"""Pictures of packings, and the boxes that viewers and pages show."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.shapes import Item
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.outlines import outline_body
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.posed_parts import contents
from packit_sim.render.coloring import PALETTE, UNKNOWN_COLOR, Color, Colors, lighter
from packit_sim.render.looks import Look
from packit_sim.scene import Scene

_CELLS = range(100, 129)
"""Possible numbers of cells along the longest side."""

SIZE = 1200, 900
"""Pixels of a picture."""

OUTLINE_COLOR: Color = (0.30, 0.32, 0.36)
"""The colour of the lines of a container."""

_SHADES = 0.0, 0.2, 0.4, 0.6
"""Shares of white in the colours of parts that have the same hue."""


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


def part_colors(packing: Packing) -> tuple[Color, ...]:
    """Choose colours that tell parts apart.

    Each part of the task has a hue, in every box; its copies have shades of it that differ between
    neighbours. If all are copies of one part, they have all hues.

    Returns
    -------
    tuple of Color
        The colour of each placement.
    """
    placed: dict[Color, list[Floats]] = {}
    found = []
    for one in packing.placements:
        hue = PALETTE[one.type % len(PALETTE)]
        hues = PALETTE if len(packing.types) == 1 else (hue,)
        middle = one.apply(packing.types[one.type].middle)
        distances = {
            color: _distance(middle, placed.get(color, ()))
            for color in (lighter(hue, white) for white in _SHADES for hue in hues)
        }
        color = max(distances, key=distances.__getitem__)
        placed.setdefault(color, []).append(middle)
        found.append(color)
    return tuple(found)


def _distance(point: Floats, others: Sequence[Floats]) -> float:
    """Return the distance of a point to the nearest of others, infinite if there is none."""
    return float(np.linalg.norm(np.array(others) - point, axis=1).min()) if len(others) else np.inf


def draw(packing: Packing, path: str | os.PathLike[str], keep_out: Sequence[ItemType] = ()) -> None:
    """Draw a box and write the picture as PNG.

    Parameters
    ----------
    packing : Packing
        The parts in the box.
    keep_out : sequence of ItemType
        Volumes that stay free, in the box's coordinates: they are grey.
    """
    lines = outline_body(packing.container)
    others = (*keep_out, *([lines] if lines else ()))
    first = len(packing.types)
    whole = replace(
        packing,
        types=(*packing.types, *others),
        placements=(*packing.placements, *(Placement(first + n) for n in range(len(others)))),
    )
    greys = *(UNKNOWN_COLOR,) * len(keep_out), *((OUTLINE_COLOR,) if lines else ())

    def colors(items: Sequence[Item]) -> Colors:
        return Colors((*part_colors(packing), *greys))

    with Scene(shown(whole)) as scene:
        look = Look(box="none" if lines else "edges", coloring=colors)
        scene.snapshot(*SIZE, look).save(path)
