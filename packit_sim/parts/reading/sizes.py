"""Fits of parts into boxes, and likely mistakes of units."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from packit_sim.core.length_units import Unit
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.reading.units import factor

_MISTAKEN: tuple[Unit, ...] = ("mm", "in", "m")
"""Units that are often confused: they differ by 25.4 and 1000."""

_TINY = 0.005
"""A part's longest side, relative to the box's, below which its unit is doubtful."""


def fits(part: PreparedPart, box: BoxType, margin: WallClearance, factor: float = 1.0) -> bool:
    """Return whether a part, enlarged by a factor, may fit into a box within its margin.

    The box's limits are not considered.
    """
    return box.container.has_space(part, margin, factor)


def too_large(
    part: PreparedPart, boxes: Sequence[BoxType], margin: WallClearance, unit: Unit
) -> str | None:
    """Explain why a part fits into no box.

    Parameters
    ----------
    margin : WallClearance
        The distances that the walls keep.
    unit : str
        The unit of lengths.

    Returns
    -------
    str or None
        The reason, which names a likely mistake of units; None if the part fits into a box.
    """
    light = [box for box in boxes if box.limits.allow(part.mass)]
    if not light:
        most = max(box.limits.max_mass or 0.0 for box in boxes)
        return f"{part.mass:.5g} g is heavier than what {_boxes(boxes)} may hold, {most:.5g} g"
    boxes = light
    if any(fits(part, box, margin) for box in boxes):
        return None
    reason = f"{lengths_text(part.item_type.extents)} {unit} is larger than "
    reason += "every box" if len(boxes) > 1 else _the_only(boxes[0], unit)
    if any(fits(part, box, WallClearance()) for box in boxes):
        reason += f" with {margin.text(unit)}"
    elif any(_fits_in_some_rotation(part, box) for box in boxes):
        reason += f" in its rotations ({part.part.rotations})"
    else:
        for other in _MISTAKEN:
            smaller = factor(other, part.part.unit)
            if smaller < 1 and any(fits(part, box, margin, smaller) for box in boxes):
                size = lengths_text(part.item_type.extents * smaller)
                reason += (
                    f"; is its unit {other} instead of {part.part.unit}? "
                    f"Then it is {size} {unit} and fits"
                )
                break
    return reason


def unit_notes(
    parts: Sequence[PreparedPart], boxes: Sequence[BoxType], margin: WallClearance, unit: Unit
) -> list[str]:
    """Name parts that are so small that their unit may be wrong.

    Parameters
    ----------
    parts : sequence of PreparedPart
        The parts, which fit.
    margin : WallClearance
        The distances that the walls keep.
    unit : str
        The unit of lengths.

    Returns
    -------
    list of str
        The notes.
    """
    longest = max(max(box.size) for box in boxes)
    notes = []
    for part in parts:
        if part.item_type.extents.max() < _TINY * longest:
            other = _larger(part, boxes, margin)
            if other:
                size = f"{lengths_text(part.item_type.extents)} {unit}"
                notes.append(
                    f"{part.part.name} is only {size}: is its unit {other} instead of "
                    f"{part.part.unit}?"
                )
    if not notes and parts:
        volume = max(box.container.volume for box in boxes)
        inch = [factor("in", part.part.unit) for part in parts]
        larger = plain_sum(p.volume * p.part.count * f**3 for p, f in zip(parts, inch, strict=True))
        is_all = all(
            f > 1 and any(fits(part, box, margin, f) for box in boxes)
            for part, f in zip(parts, inch, strict=True)
        )
        if is_all and larger < volume:
            share = plain_sum(p.volume * p.part.count for p in parts) / volume
            notes.append(
                f"all parts together have {share:.2g} of the box's volume: "
                f"are they in inches instead of {parts[0].part.unit}?"
            )
    return notes


def _larger(part: PreparedPart, boxes: Sequence[BoxType], margin: WallClearance) -> Unit | None:
    """Return a larger unit in which a part would still fit."""
    for other in reversed(_MISTAKEN):
        larger = factor(other, part.part.unit)
        if larger > 1 and any(fits(part, box, margin, larger) for box in boxes):
            return other
    return None


def _fits_in_some_rotation(part: PreparedPart, box: BoxType) -> bool:
    return bool((np.sort(part.item_type.extents) <= np.sort(box.size)).all())


def _boxes(boxes: Sequence[BoxType]) -> str:
    return "every box" if len(boxes) > 1 else "the box"


def _the_only(box: BoxType, unit: Unit) -> str:
    """Name the only box, to which parts are compared."""
    text = container_text(box.container, unit)
    if isinstance(box.form, MeshContainer):
        return f"the bounding box of the {text}"
    return f"the {text}" if box.form else f"the box of {text}"


def container_text(container: Container, unit: Unit) -> str:
    """Return the size of a container as text, such as "cylinder of 220 x 300 mm"."""
    if isinstance(container, CylinderContainer):
        return f"cylinder of {lengths_text((container.diameter, container.height))} {unit}"
    text = f"{lengths_text(container.size)} {unit}"
    return f"mesh of {text}" if isinstance(container, MeshContainer) else text


def lengths_text(lengths: Sequence[float] | Floats) -> str:
    """Return lengths as text, such as "300 x 200 x 150"."""
    return " x ".join(f"{length:.4g}" for length in lengths)
