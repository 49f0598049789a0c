"""Answers of the search: boxes filled with parts, and how good they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.handling.constraints import filtered
from packit_sim.parts.handling.requirements import packing_order, violations
from packit_sim.parts.handling.supports import lowered
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.box_types import BoxType


@dataclass(frozen=True, eq=False)
class FilledBox:
    """A box and its contents.

    Attributes
    ----------
    type : BoxType
        Which box it is.
    packing : Packing
        The parts' collision meshes in it, in its coordinates; the types are those of all parts.
    """

    type: BoxType
    packing: Packing


@dataclass(frozen=True, eq=False)
class Answer:
    """Filled boxes, and what constraints took out of them.

    Attributes
    ----------
    boxes : tuple of FilledBox
        The boxes with parts.
    dropped : tuple of (int, str)
        The part and the reason of each that a constraint took out.
    score : tuple of float
        The larger, the better.
    """

    boxes: tuple[FilledBox, ...] = ()
    dropped: tuple[tuple[int, str], ...] = ()
    score: tuple[float, ...] = (-math.inf,)

    @classmethod
    def of(cls, task: PackTask, boxes: Sequence[FilledBox]) -> Answer:
        """Apply the constraints of a task to filled boxes.

        Parameters
        ----------
        task : PackTask
            The task.
        boxes : sequence of FilledBox
            The boxes.

        Returns
        -------
        Answer
            The boxes that still have parts.
        """
        kept: list[FilledBox] = []
        dropped: list[tuple[int, str]] = []
        for box in boxes:
            packing, out = filtered(box.packing, task.constraints)
            dropped += out
            if packing.placements:
                kept.append(replace(box, packing=packing))
        placed = task.counts([one for box in kept for one in box.packing.placements])
        score = task.worth_by_priority(placed)
        if task.objective == "height":
            score += (-max((box.packing.height for box in kept), default=0.0),)
        elif task.objective == "boxes":
            volume = plain_sum(box.type.container.volume for box in kept)
            score += (-float(len(kept)), -volume)
        return cls(tuple(kept), tuple(dropped), score)

    def in_order(self, task: PackTask) -> Answer:
        """Return the same boxes with their parts in an order of packing, if it is required.

        Where gravity matters, parts come straight down to where they rest, if they may touch.

        Parameters
        ----------
        task : PackTask
            The task.

        Returns
        -------
        Answer
            The boxes.
        """
        requirements = task.requirements
        if requirements is None:
            return self
        boxes = []
        for box in self.boxes:
            whole = task.with_fixed(box.packing)
            first = len(requirements.fixed)
            if requirements.stable is not None and whole.clearance == 0:
                resting = lowered(whole, requirements.fixed)
                own = replace(box.packing, placements=resting.placements[first:])
                rest = replace(requirements, stable=None)
                if not (own.problems() or violations(resting, rest)):
                    whole = resting
            order = packing_order(whole, requirements)[first:]
            placements = tuple(whole.placements[n] for n in order)
            boxes.append(replace(box, packing=replace(box.packing, placements=placements)))
        return replace(self, boxes=tuple(boxes))

    def counts(self, task: PackTask) -> dict[int, int]:
        """Count the placed parts by their number."""
        return task.counts([one for box in self.boxes for one in box.packing.placements])
