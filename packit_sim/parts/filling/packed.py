"""Packed parts: the parts in each box, and those that are left out with the reasons."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.filling.hollows import hollow_notes
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.files import UnreadFile
from packit_sim.parts.reading.prepared import PreparedPart


@dataclass(frozen=True)
class LeftOut:
    """Parts that were not packed.

    Attributes
    ----------
    name : str
        The name of the part.
    count : int
        How many of it.
    reason : str
        Why.
    """

    name: str
    count: int
    reason: str


@dataclass(frozen=True, eq=False)
class PackedParts:
    """Parts packed into boxes.

    Attributes
    ----------
    task : PackTask
        What was to be packed, and into which boxes.
    packings : tuple of Packing
        The packing of each box with parts: their collision meshes, in the box's coordinates. The
        types are those of all parts of the task; the container has the name of the box.
    rejected : tuple of (int, str)
        The number and the reason of each part that constraints left out.
    searches : int
        How many searches, each from the best packing before it, led to this one.
    changes : tuple of str
        Notes on what changed after the search.

    Examples
    --------
    >>> from trimesh import creation
    >>> from packit_sim import PackSettings, Part, pack
    >>> from packit_sim.parts import check, export, summary
    >>> block = Part("block", creation.box((10, 10, 10)), count=4)
    >>> settings = PackSettings(workers=1, iterations=20)
    >>> packed = pack([block], "25x25x15mm", settings=settings)
    >>> summary(packed)["density"]
    '0.427'
    >>> check(packed).problems
    ()
    >>> export(packed, "packed")[-1].name
    'packing.json'
    """

    task: PackTask
    packings: tuple[Packing, ...] = ()
    rejected: tuple[tuple[int, str], ...] = ()
    searches: int = 1
    changes: tuple[str, ...] = ()

    def part(self, placement: Placement) -> PreparedPart:
        """Return the part of a placement."""
        return self.task.all_parts[placement.type]

    def pose(self, placement: Placement) -> Floats:
        """Return the matrix (4, 4) from the coordinates in a part's file to those of its box."""
        part = self.part(placement)
        return (placement.pose @ part.part.user_from_file).scaled(part.scale)

    def stem(self, box: int) -> str:
        """Return the name, without suffix, of the files of a box, by its number from 0."""
        return "packing" if len(self.packings) == 1 else f"packing-{box + 1}"

    @property
    def unread(self) -> tuple[UnreadFile, ...]:
        """The files that could not be read."""
        return self.task.unread

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Notes on how files were read, and on what is doubtful."""
        hollows = hollow_notes(self.contents, self.task.all_parts)
        return (*self.task.notes, *hollows, *self.changes)

    @cached_property
    def contents(self) -> tuple[Packing, ...]:
        """All parts in each box: the fixed ones, and then those that were packed."""
        return tuple(self.task.with_fixed(packing) for packing in self.packings)

    @property
    def placements(self) -> list[tuple[Packing, Placement]]:
        """All packed parts, each with the packing of its box."""
        return [(packing, one) for packing in self.packings for one in packing.placements]

    @property
    def count(self) -> int:
        """The number of packed parts."""
        return len(self.placements)

    @cached_property
    def counts(self) -> Counter[int]:
        """The number of copies packed of each part, by its number in the task."""
        return Counter(one.type for _, one in self.placements)

    @property
    def packed_of_asked(self) -> str:
        """How many parts are packed, and of how many if not of as many as fit."""
        return packed_of(self.count, [each.part for each in self.task.parts])

    @property
    def missed(self) -> tuple[LeftOut, ...]:
        """The parts that are not packed, without those of which as many as fit were asked for."""
        surplus = {each.part.name for each in self.task.parts if each.part.as_many_as_fit}
        return tuple(each for each in self.left_out if each.name not in surplus)

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """The parts that are not packed, with the reasons."""
        found = [
            LeftOut(self.task.parts[n].part.name, self.task.parts[n].part.count, reason)
            for n, reason in self.task.too_large.items()
        ]
        for n, each in enumerate(self.task.parts):
            left = each.part.count - self.counts[n]
            if n in self.task.too_large or left == 0:
                continue
            reasons = Counter([why for number, why in self.rejected if number == n][:left])
            if left > reasons.total():
                reasons[self._why_no_space(n)] += left - reasons.total()
            found += [LeftOut(each.part.name, count, why) for why, count in reasons.items()]
        return tuple(found)

    def _why_no_space(self, number: int) -> str:
        """Return why one more of a part is in no box."""
        task, mass = self.task, self.task.parts[number].mass
        is_full = self.packings and all(
            not task.limits(packing).is_empty
            and task.limits(packing).faults([*task.masses_in(packing), mass])
            for packing in self.packings
        )
        if is_full:
            return "a limit of the box is reached"
        is_kit = "kit" in task.settings.groups and task.parts[number].part.group is not None
        return "the whole kit does not fit" if is_kit else "no space was found"

    @cached_property
    def score(self) -> tuple[float, ...]:
        """The larger, the better by the objective."""
        if not self.packings:
            return (-math.inf,)
        score = self.task.worth_by_priority(self.counts)
        if self.task.objective == "height":
            score += (-max(packing.height for packing in self.packings),)
        elif self.task.objective == "boxes":
            score += (-float(len(self.packings)), -self._space)
        return score

    @cached_property
    def volume(self) -> float:
        """The volume of all packed parts."""
        return plain_sum(self.part(one).volume for _, one in self.placements)

    @property
    def density(self) -> float:
        """The volume of the packed parts, divided by that of the boxes with parts."""
        return self.volume / self._space if self.packings else 0.0

    @property
    def _space(self) -> float:
        return plain_sum(packing.container.volume for packing in self.packings)

    @property
    def height(self) -> float:
        """The largest z of all packed parts; their files' surfaces are not higher."""
        heights = [
            packing.vertices(one)[:, 2].max() + self.part(one).deviation
            for packing, one in self.placements
        ]
        return float(max(heights, default=0.0))

    @cached_property
    def mass(self) -> float | None:
        """Grams of all packed parts; None if a mass is not known."""
        masses = [self.part(one).mass for _, one in self.placements]
        known = [mass for mass in masses if mass is not None]
        return sum(known) if known and len(known) == len(masses) else None

    def centre_of_gravity(self, packing: Packing) -> Floats:
        """Return the centre of gravity (3,) of the parts in a box.

        Parameters
        ----------
        packing : Packing
            One of the packings.

        Returns
        -------
        ndarray of float64, shape (3,)
            By their masses, or by their volumes if a mass is not known.
        """
        weights, centres = [], []
        for one in packing.placements:
            part = self.part(one)
            mass = part.mass if self.mass is not None else None
            weights.append(part.volume if mass is None else mass)
            centres.append(one.pose.apply(part.centre))
        return np.average(centres, axis=0, weights=weights)


class _Asked(Protocol):
    """A part that was asked for."""

    @property
    def count(self) -> int: ...

    @property
    def as_many_as_fit(self) -> bool: ...


def packed_of(count: int, asked: Sequence[_Asked]) -> str:
    """Return how many parts are packed, and of how many if not of as many as fit.

    Parameters
    ----------
    count : int
        The number of packed parts.
    asked : sequence of Part or of their records
        All parts that were asked for.

    Returns
    -------
    str
        The text, such as "5 of 6 parts".
    """
    of = "" if any(each.as_many_as_fit for each in asked) else f"of {sum(p.count for p in asked)} "
    return f"{count} {of}parts"
