"""Placed items, as the validity check of packings and containers see them."""

from __future__ import annotations

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.placements import Placement
from packit_sim.placement import LooseMesh

MAX_SHRINKAGE = 1e-3
"""Largest tolerance of an item, relative to the longest side of its bounding box."""


def tolerance(unit: float, longest: float) -> float:
    """Return how far an item may reach beyond a wall, and into an item that is not smaller.

    Parameters
    ----------
    unit : float
        The container's longest fixed side.
    longest : float
        The item's longest side.

    Returns
    -------
    float
        The contact tolerance times the unit, and at most `MAX_SHRINKAGE` of the item's side.
    """
    return min(CONTACT_TOLERANCE * unit, MAX_SHRINKAGE * longest)


class CheckedItem:
    """A placed item, for the check.

    Parameters
    ----------
    name : str
        What messages call it.
    placement : Placement
        Where it is.
    unit : float
        The container's longest fixed side.
    length_unit : str
        The name of the unit of lengths in messages, such as "mm"; none by default.

    Attributes
    ----------
    box : int
        The number of its container.
    vertices : ndarray of float64, shape (n, 3)
        Its vertices, in the container's coordinates.
    low, high : ndarray of float64, shape (3,)
        The corners of its bounding box.
    tolerance : float
        See `tolerance`.
    clearance : float
        The smallest distance to other items, 0 if its type has none of its own.
    """

    def __init__(
        self,
        name: str,
        item_type: ItemType,
        placement: Placement,
        unit: float,
        length_unit: str = "",
    ) -> None:
        self.name = name
        self.item_type = item_type
        self.box = placement.box
        self.vertices = placement.apply(item_type.vertices)
        self.low, self.high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        self.scale = float(f"{placement.scale:.7g}")  # of single precision: equal ones share meshes
        self.tolerance = tolerance(unit, self.scale * float(item_type.extents.max()))
        self.clearance = item_type.clearance or 0.0
        self._length_unit = length_unit
        self._unit = CONTACT_TOLERANCE * unit
        self._stretched: dict[float, LooseMesh] = {}
        self.volume = item_type.volume * placement.scale**3
        self.box_from_item = placement.pose.at(placement.apply(item_type.middle))  # centred

    def length(self, value: float) -> str:
        """Return a length as text, such as "2.5 mm"."""
        return f"{value:.3g} {self._length_unit}".rstrip()

    def seen_from(self, other: CheckedItem, unit: float) -> tuple[Floats, Floats]:
        """Return its rotation (3, 3) and, in a unit, its translation (3,) in another's frame."""
        other_from_self = self.box_from_item.seen_from(other.box_from_item)
        return other_from_self.rotation.copy(), other_from_self.translation / unit

    def stretched_distance(self, other: CheckedItem, stretch: float) -> float:
        """Compute the distance to another item of the container, in stretched space.

        Parameters
        ----------
        stretch : float
            By what lengths along z are multiplied before.

        Returns
        -------
        float
            The distance, not above 0 if they cross.
        """
        shift = (other.low - self.low) * (1, 1, stretch) / self._unit
        one, two = self._stretched_surface(stretch), other._stretched_surface(stretch)
        return one.distance(two, shift) * self._unit

    def _stretched_surface(self, stretch: float) -> LooseMesh:
        """Look up the surface from the lower corner, in numbers in which FCL is accurate."""
        if stretch not in self._stretched:
            vertices = (self.vertices - self.low) * (1, 1, stretch) / self._unit
            self._stretched[stretch] = LooseMesh(vertices, self.item_type.faces)
        return self._stretched[stretch]
