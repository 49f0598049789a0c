"""Packings off the grid: items of some types at their poses in a container."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from packit_sim.core.check_reports import named
from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings import validity
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.distances import stretch
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing_files import read_packing, write_packing
from packit_sim.parts.packings.placements import Placement

Objective = Literal["strip", "knapsack", "bins"]

OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
"""Objectives of the nester: least height, most in one box, or fewest boxes."""


@dataclass(frozen=True, eq=False)
class Packing:
    """Items at their poses in a container, or in several.

    Parameters
    ----------
    container : BoxContainer, CylinderContainer or MeshContainer
        The container, or the largest.
    placements : tuple of Placement
        The placed items.
    clearance : float
        The smallest distance between the surfaces of two items, unless an item type has a larger
        one.
    objective : str
        "strip", "knapsack" or "bins".
    containers : tuple of BoxContainer, CylinderContainer or MeshContainer
        That of each box, if there are several sizes; empty if all are like `container`.
    clearance_z : float, optional
        The smallest distance along z, if it is another one (see `distances.stretch`).

    Raises
    ------
    ArgumentError
        If a placement is of no type or in no box, an objective is unknown or does not fit the
        container, or a clearance is not possible.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import trimesh
    >>> from packit_sim import ItemType, NestSettings, nest
    >>> mesh = trimesh.creation.box((10, 10, 10))
    >>> cubes = ItemType("cube", mesh.vertices, mesh.faces, demand=3)
    >>> settings = NestSettings(workers=1, iterations=2)
    >>> packing = nest([cubes], (10, 10, 20), "knapsack", settings=settings)
    >>> round(packing.density, 3), packing.left_out
    (1.0, (1,))
    >>> packing.problems()
    []
    >>> len(replace(packing, clearance=5.0).problems())
    1
    """

    types: tuple[ItemType, ...]
    container: Container
    placements: tuple[Placement, ...]
    clearance: float = 0.0
    objective: str = "strip"
    containers: tuple[Container, ...] = ()
    clearance_z: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "types", tuple(self.types))
        object.__setattr__(self, "placements", tuple(self.placements))
        if self.objective not in OBJECTIVES:
            raise ArgumentError(
                f"objective {self.objective!r} is not known: choose from {', '.join(OBJECTIVES)}"
            )
        if self.container.is_strip and self.objective != "strip":
            raise ArgumentError(f"objective {self.objective!r} needs a box with a height")
        check_range("clearance", self.clearance, Range(0, ends="[)"))
        stretch(self.clearance, self.clearance_z)
        for number, placement in enumerate(self.placements):
            if not 0 <= placement.type < len(self.types):
                raise ArgumentError(
                    f"placement {number} is of type {placement.type}: "
                    f"there are types 0 to {len(self.types) - 1}"
                )
            if placement.box < 0:
                raise ArgumentError(f"placement {number} is in box {placement.box}: at least 0")
            if self.containers and placement.box >= len(self.containers):
                raise ArgumentError(
                    f"placement {number} is in box {placement.box}: "
                    f"there are boxes 0 to {len(self.containers) - 1}"
                )

    def vertices(self, placement: Placement) -> Floats:
        """Return the vertices (n, 3) of a placed item, in the container's coordinates."""
        return placement.apply(self.types[placement.type].vertices)

    @property
    def height(self) -> float:
        """The largest z of all items; 0 without items."""
        return max((float(self.vertices(p)[:, 2].max()) for p in self.placements), default=0.0)

    @property
    def sides(self) -> tuple[float, float, float]:
        """The sides of the container; a strip is as high as its highest item."""
        x, y, z = self.container.size
        return x, y, self.height if self.container.is_strip else z

    @property
    def volume(self) -> float:
        """The volume of all placed items."""
        return plain_sum(self.types[p.type].volume * p.scale**3 for p in self.placements)

    @property
    def density(self) -> float:
        """The volume of the items, divided by that of the used boxes, or of the strip's part."""
        if not self.placements:
            return 0.0
        if self.objective == "strip":
            x, y, _ = self.container.size
            return self.volume / (x * y * self.height)
        return self.volume / plain_sum(self.container_of(box).volume for box in self._used)

    @property
    def boxes(self) -> int:
        """How many containers have items."""
        return len(self._used)

    @property
    def _used(self) -> list[int]:
        return sorted({placement.box for placement in self.placements})

    def container_of(self, box: int) -> Container:
        """Return the container of a box, by its number."""
        return self.containers[box] if self.containers else self.container

    @property
    def left_out(self) -> tuple[int, ...]:
        """How many items of each type are not placed."""
        placed = np.bincount([p.type for p in self.placements], minlength=len(self.types))
        demands = [item_type.demand for item_type in self.types]
        return tuple((np.array(demands, dtype=int) - placed).tolist())

    def problems(self) -> list[str]:
        """Check the packing by its meshes, independently of the search that found it.

        Returns
        -------
        list of str
            A sentence for each problem (see `validity`); empty if the packing is valid.
        """
        numbered = list(enumerate(self.placements))
        if not self.containers:
            return self._problems(self.container, numbered)
        found = []
        for box, container in enumerate(self.containers):
            own = [(n, placement) for n, placement in numbered if placement.box == box]
            found += self._problems(container, own)
        return found

    def _problems(
        self, container: Container, numbered: Sequence[tuple[int, Placement]]
    ) -> list[str]:
        """Check items in boxes of one size."""
        unit = container.longest
        items = [
            CheckedItem(named(number, own.name), own, placement, unit)
            for number, placement in numbered
            for own in [self.types[placement.type]]
        ]
        obstacles = [
            CheckedItem(each.name, each, Placement(0), unit) for each in container.obstacles
        ]
        factor = stretch(self.clearance, self.clearance_z)
        return validity.problems(items, container, self.clearance, obstacles, factor)

    def write(self, path: Path | str) -> None:
        """Write the packing as JSON that `packit verify` checks.

        Parameters
        ----------
        path : Path or str
            The file. Meshes without a file below its folder are written to NAME-meshes next to it.

        Raises
        ------
        OSError
            If a file can't be written.
        """
        placed = self.types, self.container, self.placements, self.clearance
        write_packing(path, *placed, self.containers, self.clearance_z)

    @classmethod
    def read(cls, path: Path | str) -> Packing:
        """Read a packing from a file that `packit verify` accepts.

        Parameters
        ----------
        path : Path or str
            The JSON file, see `verify_packing`.

        Returns
        -------
        Packing
            The packing, with an item type for each mesh.

        Raises
        ------
        PackFormatError
            If the file is not of this form.
        MeshError
            If a mesh can't be used.
        ArgumentError
            If a pose shears or mirrors.
        """
        types, container, placements, clearance, several, clearance_z = read_packing(path)
        objective = "strip" if container.is_strip else "bins"
        return cls(types, container, placements, clearance, objective, several, clearance_z)
