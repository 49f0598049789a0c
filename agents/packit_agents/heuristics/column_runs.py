"""Which locations of a mask are looked at: stretches that lie in a row in memory."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.placement import Mask

Stretches = npt.NDArray[np.int64]

SHORTEST_GAP = 16
"""Fewer locations than this are looked at for nothing rather than begin anew after them."""


def stretches(mask: Mask) -> Stretches:
    """(n, 2): where each stretch begins and ends in the mask's C order; they have all that is True.

    The first and the last location of each are True.
    """
    places = np.flatnonzero(mask)
    cuts = np.flatnonzero(np.diff(places) > SHORTEST_GAP)
    begins, ends = np.append(places[:1], places[cuts + 1]), np.append(places[cuts], places[-1:])
    return np.column_stack((begins, ends + 1))
