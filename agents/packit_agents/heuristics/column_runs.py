"""Runs of consecutive locations in memory that cover the True entries of a mask."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.placement import Mask

CellRuns = npt.NDArray[np.int64]
"""Begin and end (exclusive) of each run, (n, 2), in the mask's C order."""

SHORTEST_GAP = 32
"""A gap of fewer False locations than this does not end a run: visiting them is cheaper, since long
runs are processed many locations at once."""


def mask_runs(mask: Mask) -> CellRuns:
    """Cover the True locations of a mask by runs, each of which begins and ends with one."""
    places = np.flatnonzero(mask)
    cuts = np.flatnonzero(np.diff(places) > SHORTEST_GAP)
    begins, ends = np.append(places[:1], places[cuts + 1]), np.append(places[cuts], places[-1:])
    return np.column_stack((begins, ends + 1))
