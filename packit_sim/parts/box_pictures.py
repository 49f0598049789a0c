"""Boxes of packed parts as pictures, viewers and pages show them."""

from __future__ import annotations

import os

import numpy as np

from packit_sim.geometry.lattice import CELL
from packit_sim.nesting.packing import Packing
from packit_sim.parts.posed_parts import PosedContents, contents
from packit_sim.scene import Scene

_CELLS = range(100, 129)
"""How many cells the longest side may have."""

SIZE = 1200, 900
"""Pixels of a picture."""


def shown(packing: Packing) -> PosedContents:
    """Return a box with all of its parts.

    Parameters
    ----------
    packing : Packing
        The parts in the box.

    Returns
    -------
    PosedContents
        The box in box units: its longest side has 100 to 128 cells, so many that the others are
        nearly whole numbers of cells.
    """
    sides = np.array(packing.container.size) / packing.container.longest
    count = min(_CELLS, key=lambda n: float(np.abs(sides * n - np.round(sides * n)).max()))
    return contents(packing, range(len(packing.placements)), count * CELL)


def draw(packing: Packing, path: str | os.PathLike[str]) -> None:
    """Draw a box and write the picture as PNG."""
    with Scene(shown(packing)) as scene:
        scene.snapshot(*SIZE).save(path)
