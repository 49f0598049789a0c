"""Settings of evolution, recorded with each evolved pack; the defaults are the paper's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from packit_sim.core.checks import Range, check_settings
from packit_sim.core.errors import ArgumentError
from packit_sim.core.typed_json import JsonRecord
from packit_sim.geometry.lattice import BOX_CELLS, Triple, box_cells

SCALES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""The scales of items, ratios of volumes."""

SearchName = Literal["generational", "elitist"]

SEARCHES: tuple[str, ...] = get_args(SearchName)
"""Ways to choose the next chromosomes (see `strategies`)."""


@dataclass(frozen=True)
class EvolutionSettings(JsonRecord):
    """The settings of an evolution; the defaults are the paper's, except for the mutation rates.

    Parameters
    ----------
    pool : int
        The number of shapes, each of a uniformly drawn category.
    population : int
        The number of chromosomes in a generation.
    elite : int
        The number of the best chromosomes that survive.
    lucky : int
        The number of others that survive by chance; children fill the rest of the population.
    generations : int
        The maximum number of generations.
    patience : int
        The number of generations without improvement after which the evolution stops.
    keep_every : int
        The interval, in generations, at which the best pack so far is kept.
    scales : tuple of float
        The scales of items, ratios of volumes.
    size_range : tuple of float
        The range of the linear factor on all items of a pack.
    swap_rate : float
        The probability that two places in a child's order are exchanged.
    point_rate : float
        The probability that a scale, or a rotation, of a child is drawn again.
    search : str
        One of the `SEARCHES`, which chooses the next chromosomes; the paper's is "generational".
    cells : tuple of int
        The box's cells along x, y and z.

    Raises
    ------
    ArgumentError
        If a setting is out of range; the message names it.

    Notes
    -----
    Goyal and Deng (2020), section 3. The paper does not give its mutation rates; ours are 0.5 and
    0.02.

    Examples
    --------
    >>> from packit_sim import EvolutionSettings
    >>> settings = EvolutionSettings(population=40, elite=10, lucky=10)
    >>> settings.survivors, settings.children
    (20, 20)
    >>> EvolutionSettings(population=40)
    Traceback (most recent call last):
        ...
    packit_sim...ArgumentError: ... population = 40 is not possible: more than 50 survivors
    """

    pool: int = 50
    population: int = 100
    elite: int = 25
    lucky: int = 25
    generations: int = 1000
    patience: int = 100
    keep_every: int = 50
    scales: tuple[float, ...] = SCALES
    size_range: tuple[float, float] = (0.75, 1.0)
    swap_rate: float = 0.5
    point_rate: float = 0.02
    search: SearchName = "generational"
    cells: Triple = BOX_CELLS

    def __post_init__(self) -> None:
        low, high = self.size_range
        if self.search == "climbing":  # type: ignore[comparison-overlap]
            raise ArgumentError(
                "evolution setting search = 'climbing': this search was removed, since its "
                f"packs were less dense; choose from {', '.join(SEARCHES)}"
            )
        check_settings(
            self,
            "evolution setting",
            pool=Range(1),
            elite=Range(1),
            lucky=Range(0),
            population=(self.population > self.survivors, f"more than {self.survivors} survivors"),
            generations=Range(0),
            patience=Range(1),
            keep_every=Range(1),
            scales=(bool(self.scales) and min(self.scales) > 0, "one number above 0 or more"),
            size_range=(0 < low <= high, "two numbers above 0, the smaller first"),
            swap_rate=Range(0, 1),
            point_rate=Range(0, 1),
            search=(self.search in SEARCHES, f"choose from {', '.join(SEARCHES)}"),
        )
        box_cells(self.cells)

    @property
    def steps(self) -> int:
        """The maximum number of generations, the first one included."""
        return self.generations + 1

    @property
    def survivors(self) -> int:
        """Chromosomes of a generation that survive it."""
        return self.elite + self.lucky

    @property
    def children(self) -> int:
        """New chromosomes in a generation, after the first."""
        return self.population - self.survivors
