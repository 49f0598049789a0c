"""Settings of densification, recorded with each pack that it makes denser."""

from __future__ import annotations

from dataclasses import dataclass

from packit_sim.core.checks import Range, check_settings
from packit_sim.core.typed_json import JsonRecord
from packit_sim.geometry.lattice import BOX_CELLS, Triple, box_cells


@dataclass(frozen=True)
class DensificationSettings(JsonRecord):
    """The settings of a densification.

    Parameters
    ----------
    items : tuple of int
        The range of the number of items.
    floor : float
        The smallest volume of an item, relative to that of all items of the pack.
    largest : float
        The largest volume of an item, relative to the box's volume.
    fill : float
        The largest share of its bounding box that a shape may fill. That of hollow and elongated
        shapes is small.
    pool : int
        The number of different shapes drawn, among those that can have the smallest volume. Fewer
        if the library does not have as many.
    copies : int
        The number of items that may have the same shape.
    moves : int
        The number of moves in a round.
    tolerance : float
        The mean loss of density that a move may cause at the beginning. It falls to 0 in `rounds`.
    cells : tuple of int
        The box's cells along x, y and z.

    Raises
    ------
    ArgumentError
        If a setting is out of range; the message names it.
    """

    items: tuple[int, int] = (20, 24)
    floor: float = 0.025
    largest: float = 0.1
    fill: float = 1.0
    pool: int = 100
    copies: int = 1
    rounds: int = 60
    moves: int = 100
    tolerance: float = 0.003
    cells: Triple = BOX_CELLS

    def __post_init__(self) -> None:
        low, high = self.items
        check_settings(
            self,
            "densification setting",
            items=(1 <= low <= high, "two numbers from 1, the smaller first"),
            floor=(
                0 < self.floor * high <= 1,
                f"above 0, and at most {1 / max(high, 1):.3g} for {high} items",
            ),
            largest=Range(0, 1, ends="(]"),
            fill=Range(0, 1, ends="(]"),
            copies=Range(1),
            pool=(
                self.copies * self.pool >= high,
                f"at least {high / max(self.copies, 1):.10g} for {high} items with at most "
                f"{self.copies} of a shape",
            ),
            rounds=Range(0),
            moves=Range(1),
            tolerance=Range(0, 1),
        )
        box_cells(self.cells)

    @property
    def steps(self) -> int:
        """The number of rounds, the loose packing included."""
        return self.rounds + 1
