"""Packed parts: what is where, what was left out and why, and the numbers of the summary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.filling.answers import FilledBox
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.handling.requirements import Requirements
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.part_files import UnreadFile
from packit_sim.parts.reading.part_sizes import shown
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.results.original_check import Check, check_originals

if TYPE_CHECKING:
    from packit_sim.web.viewer import Viewer


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
    boxes : tuple of FilledBox
        The boxes with parts.
    left_out : tuple of LeftOut
        The parts that were not packed.
    problems : tuple of UnreadFile
        The files that could not be read.
    notes : tuple of str
        How files were understood, and what is doubtful.
    searches : int
        How many searches, each from the best packing before it, led to this one.
    """

    task: PackTask
    boxes: tuple[FilledBox, ...]
    left_out: tuple[LeftOut, ...] = ()
    problems: tuple[UnreadFile, ...] = ()
    notes: tuple[str, ...] = ()
    searches: int = 1

    def part(self, placement: Placement) -> PreparedPart:
        """Return the part of a placement."""
        return self.task.all_parts[placement.type]

    def contents(self, box: FilledBox) -> Packing:
        """Return what is in a box: the fixed parts, and then those that were packed."""
        return self.task.with_fixed(box.packing)

    def pose(self, placement: Placement) -> Floats:
        """Return the matrix (4, 4) from the coordinates in a part's file to those of its box."""
        return np.asarray(placement.pose @ self.part(placement).frame)

    def stem(self, box: int) -> str:
        """Return the name, without suffix, of the files of a box, by its number from 0."""
        return "packing" if len(self.boxes) == 1 else f"packing-{box + 1}"

    @property
    def placements(self) -> list[tuple[FilledBox, Placement]]:
        """All packed parts, each with its box."""
        return [(box, one) for box in self.boxes for one in box.packing.placements]

    @property
    def count(self) -> int:
        """How many parts are packed."""
        return len(self.placements)

    @cached_property
    def volume(self) -> float:
        """The volume of all packed parts."""
        return plain_sum(self.part(one).volume for _, one in self.placements)

    @property
    def density(self) -> float:
        """The volume of the packed parts, divided by that of the boxes with parts."""
        space = plain_sum(box.type.container.volume for box in self.boxes)
        return self.volume / space if space else 0.0

    @property
    def height(self) -> float:
        """The largest z of all packed parts; their files' surfaces are not higher."""
        heights = [
            box.packing.vertices(one)[:, 2].max() + self.part(one).deviation
            for box, one in self.placements
        ]
        return float(max(heights, default=0.0))

    @cached_property
    def mass(self) -> float | None:
        """Grams of all packed parts; None if a mass is not known."""
        masses = [self.part(one).mass for _, one in self.placements]
        known = [mass for mass in masses if mass is not None]
        return sum(known) if known and len(known) == len(masses) else None

    def centre_of_gravity(self, box: FilledBox) -> Floats:
        """Return the centre of gravity (3,) of a box's parts.

        Parameters
        ----------
        box : FilledBox
            One of the boxes.

        Returns
        -------
        ndarray of float64, shape (3,)
            By their masses, or by their volumes if a mass is not known.
        """
        weights, centres = [], []
        for one in box.packing.placements:
            part = self.part(one)
            mass = part.mass if self.mass is not None else None
            weights.append(part.volume if mass is None else mass)
            centres.append(one.pose[:3, :3] @ part.centre + one.pose[:3, 3])
        return np.average(centres, axis=0, weights=weights)

    @cached_property
    def check(self) -> Check:
        """The independent check of the original files at the poses."""
        return check_originals(self)

    def verify(self) -> list[str]:
        """Check the original files at the poses, independently of the search.

        Returns
        -------
        list of str
            A sentence for each problem: parts that overlap, that are nearer than the clearance, or
            that are outside their box. Empty if the packing keeps its promise.

        Notes
        -----
        trimesh reads the files again. FCL computes distances of their triangles, and manifold3d,
        where it is installed, the volumes that closed parts share.
        """
        return list(self.check.problems)

    def table(self) -> str:
        """Return the summary as text, a line for each part and for each number."""
        unit = self.task.unit
        placed = self.task.counts([one for _, one in self.placements])
        rows = [("part", "asked", "packed", "left out, and why")]
        known = {part.part.name for part in self.task.parts}
        for n, part in enumerate(self.task.parts):
            name = part.part.name
            why = "; ".join(f"{e.count}: {e.reason}" for e in self.left_out if e.name == name)
            rows.append((name, f"{part.part.count}", f"{placed.get(n, 0)}", why))
        rows += [
            (each.name, f"{each.count}", "0", each.reason)
            for each in self.left_out
            if each.name not in known
        ]
        rows += [(Path(one.source).name, "", "0", f"file: {one.reason}") for one in self.problems]
        widths = [max(len(row[n]) for row in rows) for n in range(3)]
        lines = [
            f"{name:<{widths[0]}}  {asked:>{widths[1]}}  {packed:>{widths[2]}}  {why}".rstrip()
            for name, asked, packed, why in rows
        ]
        lines.append("")
        lines += [f"{name:<18} {value}" for name, value in self.summary(unit).items()]
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join(lines)

    def summary(self, unit: str | None = None) -> dict[str, str]:
        """Return the numbers of the packing as text, by name."""
        unit = unit or self.task.unit
        total = sum(part.part.count for part in self.task.parts)
        found = {
            "packed": f"{self.count} of {total} parts",
            "boxes": ", ".join(
                f"{box.type.name} {shown(box.type.size)} {unit}" for box in self.boxes
            )
            or "none",
            "volume": f"{self.volume:.6g} {unit}³",
            "density": f"{self.density:.3f}",
            "height": f"{self.height:.5g} {unit}",
        }
        distance = self.check.distance
        if distance is not None:
            found["smallest distance"] = f"{distance:.4g} {unit}"
        found["mass"] = "unknown" if self.mass is None else f"{self.mass:.5g} g"
        by = "mass" if self.mass is not None else "volume"
        for number, box in enumerate(self.boxes, start=1):
            name = "centre of gravity" if len(self.boxes) == 1 else f"centre, box {number}"
            place = ", ".join(f"{each:.4g}" for each in self.centre_of_gravity(box))
            found[name] = f"({place}) {unit}, by {by}"
        found["check"] = (
            f"{len(self.check.problems)} problems"
            if self.check.problems
            else f"no problems ({self.check.how})"
        )
        return found

    def export(self, folder: Path | str) -> list[Path]:
        """Write the packing to a folder: 3MF, GLB, STL, JSON, a picture and a report page.

        Parameters
        ----------
        folder : Path or str
            The folder; its files of an earlier packing are replaced, each in one step.

        Returns
        -------
        list of Path
            The files.

        Raises
        ------
        PackItError
            If there is nothing to write, or a file can't be written.
        """
        from packit_sim.parts.results.exports import export_packing

        return export_packing(self, Path(folder))

    def instructions(self, path: Path | str) -> Path:
        """Write printable packing instructions: a step for each part, with pictures.

        Parameters
        ----------
        path : Path or str
            The HTML file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            If nothing is packed.
        OSError
            If the file can't be written.
        """
        from packit_sim.parts.results.instructions import write_instructions

        boxes = [
            (f"Box {n}: {box.type.name}" if len(self.boxes) > 1 else "Box", self.contents(box))
            for n, box in enumerate(self.boxes, start=1)
        ]
        return write_instructions(path, boxes, self.task.unit, requirements=self._requirements)

    def film(self, path: Path | str, box: int = 0) -> Path:
        """Film how the parts of a box are put in, by the straight moves that bring them in.

        Parameters
        ----------
        path : Path or str
            The file, .gif or .mp4.
        box : int
            The number of the box, from 0.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        RenderError
            If the file can't be written.
        """
        from packit_sim.parts.results.packing_film import film_packing

        return film_packing(path, self.contents(self.boxes[box]), self._requirements)

    @property
    def _requirements(self) -> Requirements:
        return self.task.requirements or Requirements(fixed=self.task.fixed_numbers)

    def view(self, box: int = 0, port: int | None = None) -> Viewer:
        """Show a box on a local, interactive web page.

        Parameters
        ----------
        box : int
            The number of the box, from 0.
        port : int, optional
            The port; by default a free one.

        Returns
        -------
        Viewer
            The page, with its `address`; close it, or use it in a `with` statement.

        Raises
        ------
        RenderError
            If viser is not installed, or the port is not available.
        """
        from packit_sim.parts.results.box_pictures import shown
        from packit_sim.web.viewer import Viewer

        return Viewer(shown(self.contents(self.boxes[box])), port=port)
