"""Boxes of a packing as the page shows them: models, kinds, and what else is in the box."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CELL
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.outlines import outline
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.results.pictures import part_colors, shown
from packit_sim.render.coloring import PALETTE, UNKNOWN_COLOR, Color, hexadecimal, lighter
from packit_sim.web.page_models import Models

_SHADES = (0.0, 0.3, 0.55)
"""Shares of white in the colours of more kinds than there are hues."""


def kind_color(kind: int) -> Color:
    """Return the colour of a kind of parts, by its number."""
    shade, hue = divmod(kind % (len(PALETTE) * len(_SHADES)), len(PALETTE))
    return lighter(PALETTE[hue], _SHADES[shade])


@dataclass(frozen=True)
class Kind:
    """A kind of parts in the legend."""

    number: int
    name: str
    count: int

    def to_json(self) -> dict[str, Any]:
        """Return it in JSON's types."""
        color = "#" + hexadecimal(kind_color(self.number))
        return {"number": self.number, "name": self.name, "count": self.count, "color": color}


def box_scenes(packed: PackedParts) -> dict[str, Any]:
    """Return the boxes of a packing in JSON's types.

    Returns
    -------
    dict[str, Any]
        "models" of `Models`, with what is in the box already after the parts; "boxes", of each its
        name, its sides, and of its parts the names, kinds and corners, all in the task's unit;
        "kinds", the legend; and the distances that parts keep.
    """
    task, models, boxes = packed.task, Models(), []
    for packing in packed.packings:
        _add(models, packed, packing)
        corners = [_corners(packing, one) for one in packing.placements]
        boxes.append(
            {
                "name": packing.container.name,
                "parts": [packed.part(one).part.name for one in packing.placements],
                "kinds": [one.type for one in packing.placements],
                "others": [each.part.name for each in (*task.fixed, *task.keep_out)],
                "sides": list(packing.container.size),
                "low": [low.tolist() for low, _ in corners],
                "high": [high.tolist() for _, high in corners],
            }
        )
    kinds = (Kind(n, task.parts[n].part.name, packed.counts[n]) for n in sorted(packed.counts))
    return {
        "models": models.to_json(),
        "boxes": boxes,
        "kinds": [each.to_json() for each in kinds],
        "unit": task.unit,
        "gap": task.largest_gap,
        "walls": [task.margin.lower.tolist(), task.margin.upper.tolist()],
    }


def _add(models: Models, packed: PackedParts, packing: Packing) -> None:
    """Add a box with its parts, and in grey with what else is in it."""
    task, first = packed.task, len(packing.types)
    free = [each.item_type for each in task.keep_out]
    fixed = [Placement(len(task.parts) + n) for n in range(len(task.fixed))]
    others = (*fixed, *(Placement(first + n) for n in range(len(free))))
    whole = replace(
        packing,
        types=(*packing.types, *free),
        container=packing.container.with_obstacles(()),
        placements=(*packing.placements, *others),
    )
    state = shown(whole)
    colors = (*part_colors(packing), *(UNKNOWN_COLOR,) * len(others))
    lines = outline(whole.container) * (max(state.cells) * CELL / whole.container.longest)
    total = plain_sum(one.item.volume for one in state.placed)
    models.add(state.cells, state.placed, total, colors, lines)


def _corners(packing: Packing, one: Placement) -> tuple[Floats, Floats]:
    vertices = one.apply(packing.types[one.type].vertices)
    return np.min(vertices, axis=0), np.max(vertices, axis=0)
