"""Constraints beyond validity: the built-in ones, and the protocol of custom ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

from packit_sim.core.checks import Range, check_range
from packit_sim.core.choices import Door
from packit_sim.core.errors import ArgumentError, about
from packit_sim.core.length_units import UNITS_CM, Unit, check_unit
from packit_sim.parts.handling.sweeps import check_door
from packit_sim.parts.packings.bounds import LENGTHS, LOADS
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.packing import Packing
from packit_sim.physics.settings import PhysicsSettings


class CustomConstraint(Protocol):
    """A user-defined constraint, for `PackSettings`."""

    def left_out(self, packing: Packing) -> Mapping[int, str]:
        """Choose the parts to leave out, so that the others meet the constraint.

        Parameters
        ----------
        packing : Packing
            The parts in one box, in its coordinates. The types are those of all parts, by name.

        Returns
        -------
        mapping of int to str
            The reason for each part to leave out, by the number of its placement; empty if the
            packing meets the constraint. It is called again for the parts that remain.
        """


@dataclass(frozen=True)
class Constraints:
    """The constraints that a packing of parts must meet beyond being valid.

    Parameters
    ----------
    removable : bool
        Whether every part can be taken out by straight moves (see `removal`).
    insertable : bool
        Whether every part can be put in straight through the door, in some order.
    separable : bool
        Whether every part can be moved out without turning, in some order (see `separability`).
    door : str
        The side of the box through which parts come in and leave, by default the top.
    stable : float, optional
        The largest distance that a part may move under gravity at any stage of packing, in the
        container's unit (see `stability`).
    stops : mapping of int to int
        The stop at which parts of each type are delivered, by its number; empty if they are not.
        Parts of a stop go straight out through the door while those of all later stops are there.
    no_stack : frozenset of int
        The numbers of the types on which nothing may rest (see `supports`).
    max_loads : mapping of int to float
        The largest mass in grams that may rest on a part, by the number of its type.
    masses : tuple of float, optional
        The grams of a part of each type.
    fixed : frozenset of int
        The numbers of placements that stay where they are, such as parts that belong to the box.
        They are in the way of others, and nobody has to take them out.
    unit : str
        The container's unit of length, for `stable`: a name of `UNITS_CM`.
    physics : PhysicsSettings, optional
        The simulated world, for `stable`; by default that of `stability`.

    Raises
    ------
    ArgumentError
        If a number is out of range, or masses are missing.
    """

    removable: bool = False
    insertable: bool = False
    separable: bool = False
    door: Door = "z+"
    stops: Mapping[int, int] = field(default_factory=lambda: MappingProxyType({}))
    stable: float | None = None
    no_stack: frozenset[int] = frozenset()
    max_loads: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({}))
    masses: tuple[float, ...] | None = None
    fixed: frozenset[int] = frozenset()
    unit: Unit = "mm"
    physics: PhysicsSettings | None = None

    def __post_init__(self) -> None:
        check_door(self.door)
        if self.stable is not None:
            check_range("stable", self.stable, LENGTHS)
        check_unit(self.unit)
        for load in self.max_loads.values():
            check_range("max_load", load, LOADS)
        for mass in self.masses or ():
            check_range("mass", mass, Range(0, ends="[)"))
        if self.masses is None and (self.max_loads or self.stable is not None):
            raise ArgumentError("load limits and stability need masses: one for each type of parts")

    @property
    def metres(self) -> float:
        """The container's unit in metres."""
        return UNITS_CM[self.unit] / 100

    @property
    def is_empty(self) -> bool:
        """True if every valid packing meets them."""
        has_moves = self.removable or self.is_straight or self.separable
        return not (has_moves or self.stable is not None or self.no_stack or self.max_loads)

    @property
    def is_straight(self) -> bool:
        """True if every part comes in by one straight move."""
        return self.insertable or len(self.stops) > 0

    def masses_in(self, packing: Packing) -> list[float]:
        """Return the grams of each placed part; 0 if they are not known."""
        masses = self.masses or (0.0,) * len(packing.types)
        return [masses[placement.type] for placement in packing.placements]

    def check_container(self, container: Container) -> None:
        """Raise ArgumentError if they can't be decided in a container that is no box."""
        form = form_of(container)
        asked = {
            "removable": self.removable,
            "stable": self.stable is not None,
            "insertable": self.insertable and form == "mesh",
            "delivery": bool(self.stops) and form == "mesh",
            f"door {self.door}": self.door != "z+",
            "no_stack": bool(self.no_stack) and form == "mesh",
            "max_load": bool(self.max_loads) and form == "mesh",
        }
        for name, is_asked in asked.items():
            if is_asked and form != "box":
                top = "straight moves through the top, or " if form == "cylinder" else ""
                with about(name.split()[0]):
                    raise ArgumentError(
                        f"{name} is not possible in {container.name!r}, a {form}: choose {top}a box"
                    )

    def check_numbers(self, packing: Packing) -> None:
        """Raise ArgumentError if they name types or placements that a packing does not have."""
        self.check_container(packing.container)
        for name, numbers, count in (
            ("no_stack", self.no_stack, len(packing.types)),
            ("max_loads", self.max_loads, len(packing.types)),
            ("fixed", self.fixed, len(packing.placements)),
        ):
            for number in numbers:
                if not 0 <= number < count:
                    raise ArgumentError(f"{name} has the number {number}: it must be below {count}")
        if self.masses is not None and len(self.masses) != len(packing.types):
            raise ArgumentError(
                f"{len(self.masses)} masses for {len(packing.types)} types of parts: one for each"
            )
