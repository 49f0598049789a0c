"""Kernels that push overlapping items apart, all at once.

In sweeps over all pairs, both items of an overlapping pair move away from each other along the
gradient of their distance, each by half of the depth (an obstacle leaves all of it to the other).
This is the relaxation of position-based dynamics (Jakobsen, 2001; Mueller et al., 2007), applied to
overlaps. It solves what one item at a time can't: a row of items that must all shift a little. The
caller keeps the result only if the total overlap falls.

Invariant: overlaps of moved items are computed again at the end, not in between: a sweep measures
the depth of each pair itself.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inlined
from packit_sim.parts.nesting.cost_kernels import NEGLIGIBLE, distance_of, update_overlaps
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, apart, clamp, put

SWEEPS = 30
"""Limit of sweeps over all pairs."""

PUSH = 0.55
"""Share of the depth by which each of a pair is pushed: a little over half ends in a gap."""

PATIENCE = 4
"""Sweeps without a gain of 5% after which pushing ends."""


@inlined
def push_apart(problem, state, boxes):
    """Push overlapping items apart, pair by pair, each by half of the depth, or one by all of it.

    Parameters
    ----------
    state : State
        Poses of all items, with overlaps; changed.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    """
    lookup = problem.lookup
    n = len(state.types)
    p = np.empty(3)
    last = np.full(n, -1)
    least, idle = NO_LIMIT, 0
    for sweep in range(SWEEPS):
        total = 0.0
        for i in range(n):
            o = state.turned[i]
            for j in range(i):
                # After the first sweep only pairs can overlap anew of which an item moved since.
                is_due = (
                    state.overlaps[i, j] > 0 if sweep == 0 else max(last[i], last[j]) >= sweep - 1
                )
                if not is_due or apart(state, i, j):
                    continue
                distance, gx, gy, gz = distance_of(problem, state, i, o, state.places[i], j)
                depth = state.margins[i, j] - distance
                square = gx * gx + gy * gy + gz * gz
                if depth <= NEGLIGIBLE or square == 0:  # no direction: left to the moves
                    continue
                total += depth * lookup.sizes[state.types[i]] * lookup.sizes[state.types[j]]
                share = PUSH if i < state.movable else 2 * PUSH
                for m in (i, j):
                    if m >= state.movable:
                        continue
                    step = (share if m == i else -share) * depth / square
                    p[0] = state.places[m, 0] + step * gx
                    p[1] = state.places[m, 1] + step * gy
                    p[2] = state.places[m, 2] + step * gz
                    if clamp(lookup, state.types[m], state.turned[m], p, boxes):
                        put(lookup, state, m, state.turned[m], p)
                        last[m] = sweep
        idle = 0 if total < 0.95 * least else idle + 1
        least = min(least, total)
        if total == 0 or idle > PATIENCE:
            break
    for i in range(n):
        if last[i] >= 0:
            update_overlaps(problem, state, i)
