"""Boxes and other containers to pack into: sizes, names, and how many there are."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from packit_sim.core.checks import as_integer, check_range, shown
from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.files import exists
from packit_sim.core.length_units import Unit
from packit_sim.libraries.mesh_files import SUFFIXES
from packit_sim.parts.packings.bounds import COUNTS
from packit_sim.parts.packings.containers import BoxContainer, Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.reading.limits import NO_LIMITS, Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.units import lengths, unit_of

_CYLINDER = "cylinder"

_NAMED = re.compile(
    rf"(?:(?P<name>(?!{_CYLINDER}:)[^:=]+):)?(?P<round>{_CYLINDER}:)?"
    r"(?P<size>[^:=]+?)(?:=(?P<count>\d{1,30}))?"
)

_MESH = re.compile(r"(?:(?P<name>[^:=/\\]+):)?(?P<file>.+?)(?:=(?P<count>\d{1,30}))?")

_FILE = re.compile(r"\.[A-Za-z]\w*$")

FORMS = "300x200x150mm, A:30x20x15cm, cylinder:220x300mm or a mesh file"
"""Examples of boxes."""


@dataclass(frozen=True)
class BoxType:
    """A size of boxes, and how many there are.

    Parameters
    ----------
    size : tuple of float
        The sides along x, y and z.
    name : str
        Its name, in tables and files.
    count : int, optional
        How many there are, at least 1; None for as many as are needed.
    form : CylinderContainer or MeshContainer, optional
        What they are instead of boxes; the sides are those of its bounding box.
    limits : Limits
        What one of them may hold.

    Raises
    ------
    ArgumentError
        If a side is not above 0, the count is not possible, or the form has other sides, or
        obstacles.

    Examples
    --------
    >>> from packit_sim import BoxType
    >>> BoxType((300, 200, 150), "A", count=2)
    BoxType(size=(300.0, 200.0, 150.0), name='A', count=2)
    >>> BoxType.parse("B:30x20x15cm=3", unit="mm")
    BoxType(size=(300.0, 200.0, 150.0), name='B', count=3)
    """

    size: tuple[float, float, float]
    name: str = "box"
    count: int | None = 1
    form: CylinderContainer | MeshContainer | None = None
    limits: Limits = NO_LIMITS

    def __repr__(self) -> str:
        named: dict[str, object] = {"form": self.form} if self.form else {}
        named |= {} if self.limits.is_empty else {"limits": self.limits}
        more = "".join(f", {name}={value!r}" for name, value in named.items())
        return f"BoxType(size={self.size}, name={self.name!r}, count={self.count}{more})"

    def __post_init__(self) -> None:
        container = BoxContainer(self.size)
        if container.is_strip:
            raise ArgumentError(f"box {self.name!r} has no height: choose a finite one")
        object.__setattr__(self, "size", container.size)
        if self.form is not None:
            if self.form.size != container.size:
                raise ArgumentError(f"box {self.name!r} does not have the size of its form")
            if self.form.obstacles:
                raise ArgumentError(f"box {self.name!r} has obstacles: choose keep_out or fixed")
            object.__setattr__(self, "form", replace(self.form, name=self.name))
        if self.count is not None:
            what = f"the number of boxes {self.name!r}"
            check_range(what, as_integer(what, self.count), COUNTS)

    @property
    def container(self) -> Container:
        """The container of this size and name."""
        return self.form or BoxContainer(self.size, name=self.name)

    @classmethod
    def of(cls, container: Container, count: int | None = 1) -> BoxType:
        """Return the type of a container's name and size."""
        form = None if isinstance(container, BoxContainer) else container
        return cls(container.size, container.name, count, form)  # type: ignore[arg-type]

    @classmethod
    def parse(
        cls, text: str, unit: Unit, count: int | None = 1, plain: Unit | None = None
    ) -> BoxType:
        """Read a box, such as "300x200x150mm", "A:300x200x150mm=2" or "cylinder:220x300mm".

        Parameters
        ----------
        text : str
            The box.
        unit : str
            The unit of the result.
        count : int, optional
            How many there are, if the text does not say.
        plain : str, optional
            The unit of sides without one; by default that of the result.

        Returns
        -------
        BoxType
            The box.

        Raises
        ------
        ArgumentError
            If the text is not a box.
        """
        match = _NAMED.fullmatch(text.strip())
        if match is None or _FILE.search(text):
            raise ArgumentError(f"box {shown(text)} is not possible: choose one such as {FORMS}")
        own = int(match["count"]) if match["count"] else count
        if not match["round"]:
            x, y, z = lengths(match["size"], 3, unit, plain)
            with located(f"box {shown(text)}", ArgumentError):
                return cls((x, y, z), (match["name"] or "box").strip(), own)
        with located(f"box {shown(text)}", ArgumentError):
            diameter, height = lengths(match["size"], 2, unit, plain)
            name = (match["name"] or _CYLINDER).strip()
            return cls.of(CylinderContainer(diameter, height, name=name), own)


@dataclass(frozen=True, eq=False)
class MeshBox:
    """A container that is a mesh, before that is read and prepared (see `mesh_boxes`).

    Attributes
    ----------
    mesh : Path or Part
        Its file, or the mesh itself.
    name : str
        The container's name.
    count : int, optional
        How many there are: of a file, if its text says so; else None for as many as are needed.
    limits : Limits
        What one of them may hold.
    """

    mesh: Path | Part
    name: str
    count: int | None = None
    limits: Limits = NO_LIMITS

    @classmethod
    def parse(cls, text: str) -> MeshBox | None:
        """Read "trunk.stl", "A:trunk.stl" or "A:trunk.stl=2"; return None for anything else."""
        whole = Path(text)
        if whole.suffix.lower() in SUFFIXES and exists(whole):  # also with a drive, or "="
            return cls(whole, whole.stem)
        drive, behind = os.path.splitdrive(text.strip())  # no name: "C:/trunk.stl=2" on Windows
        if not behind.startswith(("/", os.sep)):
            drive, behind = "", text.strip()
        match = _MESH.fullmatch(behind)
        if match is None or Path(match["file"]).suffix.lower() not in SUFFIXES:
            return None
        file = Path(drive + match["file"])
        name = (match["name"] or file.stem).strip()
        return cls(file, name, int(match["count"]) if match["count"] else None)


OneBox = str | BoxType | MeshBox | Container
"""A box, or another container."""

Boxes = OneBox | Sequence[float] | Sequence[OneBox]
"""A box, its three sides, another container, or several of them."""


def box_unit(boxes: Boxes) -> Unit | None:
    """Return the first unit of length that the text of a box names, if any does."""
    return next((unit for text in _texts(boxes) if (unit := unit_of(text))), None)


def unit_note(boxes: Boxes) -> str | None:
    """Return which boxes take the unit that others name, if any do."""
    unit = box_unit(boxes)
    plain = [text for text in _texts(boxes) if unit and unit_of(text) is None]
    return f"boxes without a unit read as {unit}: {', '.join(plain)}" if plain else None


def box_types(boxes: Boxes, unit: Unit, count: int | None) -> tuple[BoxType, ...]:
    """Read boxes in any of their forms.

    Parameters
    ----------
    boxes : str, BoxType, Container, or sequence of float, str, BoxType or Container
        A box, its three sides, or several boxes. A text without a unit has that of the others.
    unit : str
        The unit of the result, and of texts if none of them names one.
    count : int, optional
        How many there are of a box that does not say so; None for as many as are needed.

    Returns
    -------
    tuple of BoxType
        The boxes, at least one, with names that differ.

    Raises
    ------
    ArgumentError
        If something is not a box; or if one names no unit, and the others name several.
    """
    named = {own: text for text in _texts(boxes) if (own := unit_of(text))}
    if isinstance(boxes, OneBox):
        boxes = [boxes]
    if not len(boxes):
        raise ArgumentError("there must be at least one box")
    found = []
    if all(isinstance(each, (str, BoxType, Container)) for each in boxes):
        for each in boxes:
            if isinstance(each, str) and len(named) > 1 and unit_of(each) is None:
                raise ArgumentError(
                    f"box {each!r} has no unit, and others have {' and '.join(named)}: add one"
                )
            if isinstance(each, str):
                each = BoxType.parse(each, unit, count, next(iter(named), unit))
            assert isinstance(each, (BoxType, Container))
            found.append(each if isinstance(each, BoxType) else BoxType.of(each, count))
    else:
        found.append(BoxType(tuple(boxes), count=count))  # type: ignore[arg-type]
    names = [each.name for each in found]
    if len(set(names)) < len(names):
        raise ArgumentError(
            f"boxes {', '.join(names)} need different names, such as A:300x200x150mm"
        )
    return tuple(found)


def _texts(boxes: Boxes) -> list[str]:
    """Return the boxes whose sides are given as text."""
    several = [boxes] if isinstance(boxes, OneBox) else boxes
    texts = (each for each in several if isinstance(each, str))
    return [each for each in texts if MeshBox.parse(each) is None]
