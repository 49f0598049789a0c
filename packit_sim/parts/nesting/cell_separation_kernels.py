"""Kernels that move items apart on a grid of cells: guided local search for many types.

The overlap of a pair is the number of cells that both items take, which a bitwise "and" of their
words counts at once for 64 cells along z: a sample costs about 10 microseconds, and one type needs
no data about another. Its square root is the cost, so that a pair that shares few cells matters
too. Moves and weights are those of `separation_kernels` (guided local search with samples, as in
sparrow); overlap volumes as cost go back to Egeblad, Nielsen and Odgaard (2007).

Sets of cells are conservative. So the surfaces are asked about pairs that share cells, after each
pass: a pair that is apart is *excused* for as many cells as it shares there, like the margins of
`conflict_kernels`. Excuses are right near the present poses alone, and are taken back where the
surfaces find a conflict.

Invariant: `separate_cells` returns 0 only if the surfaces find no conflict of pairs that share
cells.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inlined, inner_kernel, kernel
from packit_sim.geometry.word_kernels import count_bits
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, apart, list_near, put, random, shuffle
from packit_sim.parts.nesting.settling_kernels import are_in_conflict

KEPT = 3
"""Samples of a move that are improved, in addition to the present pose."""

FIRST_STEP = 4
"""First steps of a descent, in cells."""


class CellState(NamedTuple):
    """Poses of all items on a grid of cells.

    Attributes
    ----------
    low : ndarray
        (3,) float64, the lowest corner of the grid.
    bounds : ndarray
        (n, 6) int32, the lowest cell of each item, and the one after its highest; each column
        is contiguous (see `list_near`).
    shared, excused : ndarray
        (n, n) float32, symmetric: cells that pairs share beyond those that they may, and these.
    weights : ndarray
        (n, n) float32, symmetric, at least 1.
    found : ndarray
        (n,) float32, a work array for the shared cells of one item.
    moved : ndarray
        (n,) uint8, 1 for items that moved since the surfaces were asked.
    """

    low: Any
    bounds: Any
    shared: Any
    excused: Any
    weights: Any
    found: Any
    moved: Any


@inner_kernel
def _shared_cells(bits, one, p, other, q, enough):
    """Return the number of cells that two items at positions share, or a number above `enough`.

    one, other: (7,) int64, their forms (see `Cells`).
    """
    x0, x1 = max(p[0], q[0]), min(p[0] + one[4], q[0] + other[4])
    y0, y1 = max(p[1], q[1]), min(p[1] + one[5], q[1] + other[5])
    row, other_row, plane, other_plane = one[1], other[1], one[2], other[2]
    words, other_words = one[3], other[3]
    at = one[0] + (x0 - p[0]) * row + y0 - p[1]
    other_at = other[0] + (x0 - q[0]) * other_row + y0 - q[1]
    up = q[2] - p[2]
    if up < 0:  # the first is the lower one
        up = -up
        at, other_at = other_at, at
        row, other_row = other_row, row
        plane, other_plane = other_plane, plane
        words, other_words = other_words, words
    big = up >> 6
    small = np.uint64(up & 63)
    rest = np.uint64(64) - small
    width = y1 - y0
    total = 0
    for x in range(x1 - x0):
        for k in range(min(other_words, words - big)):
            low = at + x * row + (big + k) * plane
            high = other_at + x * other_row + k * other_plane
            lower = bits[low : low + width]
            upper = bits[high : high + width]
            count = 0
            if small > 0 and big + k + 1 < words:
                above = bits[low + plane : low + plane + width]
                for y in range(width):
                    count += count_bits(((lower[y] >> small) | (above[y] << rest)) & upper[y])
            else:
                for y in range(width):
                    count += count_bits((lower[y] >> small) & upper[y])
            total += count
        if total > enough:
            break
    return float(total)


@inner_kernel
def _cost(cells, state, grid, i, o, p, limit):
    """Return the weighted overlap of an item at a position; write what it shares to `found`.

    It ends at a limit; what it returns is then no cost.
    """
    form = cells.forms[state.types[i], o]
    low = np.int32(p[0]), np.int32(p[1]), np.int32(p[2])
    high = np.int32(p[0] + form[4]), np.int32(p[1] + form[5]), np.int32(p[2] + form[6])
    count = list_near(state, grid.bounds, i, low, high)
    total = 0.0
    for n in range(count):
        j = state.near[n]
        weight = grid.weights[i, j]
        root = (limit - total) / weight
        enough = int(min(root * root + grid.excused[i, j], 1e12))
        other = cells.forms[state.types[j], state.turned[j]]
        shared = _shared_cells(cells.bits, form, p, other, grid.bounds[j], enough)
        shared -= grid.excused[i, j]
        if shared > 0:
            grid.found[j] = shared
            total += weight * np.sqrt(shared)
            if total >= limit:
                break
    return total


@inlined
def _put_cells(cells, state, grid, i, o, p):
    """Move an item to a position of the grid."""
    form = cells.forms[state.types[i], o]
    state.turned[i] = o
    grid.moved[i] = 1
    for d in range(3):
        grid.bounds[i, d] = p[d]
        grid.bounds[i, 3 + d] = p[d] + form[4 + d]


@inlined
def _into_box(form, p, size):
    """Move a position (3,) into the box; return whether the item fits."""
    fits = True
    for d in range(3):
        most = size[d] - form[4 + d]
        fits = fits and most >= 0
        p[d] = max(0, min(p[d], most))
    return fits


@allocating_kernel
def _descent(cells, state, grid, i, o, p, cost, size, rng):
    """Improve a position by steps along the axes; return its cost."""
    form = cells.forms[state.types[i], o]
    trial = np.empty(3, np.int64)
    step = FIRST_STEP
    while step >= 1 and cost > 0:
        is_better = False
        first = int(random(rng) * 6)
        for n in range(6):
            way = (first + n) % 6
            d = way >> 1
            trial[:] = p
            trial[d] += step if way & 1 else -step
            if not _into_box(form, trial, size) or trial[d] == p[d]:
                continue
            other = _cost(cells, state, grid, i, o, trial, cost)
            if other < cost:
                cost = other
                p[:] = trial
                is_better = True
        if not is_better:
            step >>= 1
    return cost


@allocating_kernel
def _move(problem, cells, state, grid, i, size, near, far, rng):
    """Move an item to the position of least cost that samples and descents find."""
    a, o = state.types[i], state.turned[i]
    form = cells.forms[a, o]
    count = problem.allowed_counts[a]
    p = np.empty(3, np.int64)
    costs = np.full(KEPT, NO_LIMIT)
    kept = np.empty((KEPT, 3), np.int64)
    turned = np.zeros(KEPT, np.int64)
    reach = 0.5 * max(form[4], form[5], form[6])
    for n in range(near + far):
        other = o
        if n >= near or n % 3 == 0:
            other = problem.allowed[a, int(random(rng) * count)]
        own = cells.forms[a, other]
        for d in range(3):
            if n < near:  # about its centre, most often close to it
                way = (random(rng) + random(rng) - 1) * reach
                p[d] = grid.bounds[i, d] + (form[4 + d] - own[4 + d]) // 2 + int(np.floor(way))
            else:
                p[d] = int(random(rng) * (size[d] - own[4 + d] + 1))
        if not _into_box(own, p, size):
            continue
        cost = _cost(cells, state, grid, i, other, p, costs[KEPT - 1])
        if cost < costs[KEPT - 1]:
            k = KEPT - 1
            while k > 0 and costs[k - 1] > cost:
                costs[k], turned[k], kept[k] = costs[k - 1], turned[k - 1], kept[k - 1]
                k -= 1
            costs[k], turned[k], kept[k] = cost, other, p
    before = _cost(cells, state, grid, i, o, grid.bounds[i], NO_LIMIT)
    p[:] = grid.bounds[i, :3]
    best = p.copy()
    best_turned = o
    least = _descent(cells, state, grid, i, o, p, before, size, rng)
    best[:] = p
    for k in range(KEPT):
        if least == 0 or costs[k] == NO_LIMIT:
            break
        p[:] = kept[k]
        cost = _descent(cells, state, grid, i, turned[k], p, costs[k], size, rng)
        if cost < least:
            least, best_turned = cost, turned[k]
            best[:] = p
    if least < before:
        _put_cells(cells, state, grid, i, best_turned, best)
        _share(cells, state, grid, i)


@inlined
def _share(cells, state, grid, i):
    """Count the cells again that an item shares with others."""
    grid.found[:] = 0
    _cost(cells, state, grid, i, state.turned[i], grid.bounds[i], NO_LIMIT)
    grid.shared[i] = grid.found
    grid.shared[:, i] = grid.found


@kernel
def put_on_grid(cells, state, grid, places, size):
    """Put all items at the positions of the grid nearest to places, in the box; set overlaps.

    Parameters
    ----------
    cells : Cells
        The cells of all types.
    state : State
        Poses of all items, of which only rotations count; all are inside.
    grid : CellState
        Changed.
    places : ndarray
        (n, 3) float64, the places.
    size : ndarray
        (3,) int64, the cells of the box.
    """
    p = np.empty(3, np.int64)
    for i in range(len(state.types)):
        form = cells.forms[state.types[i], state.turned[i]]
        for d in range(3):
            p[d] = int(np.round((places[i, d] - grid.low[d]) / cells.side - 0.5 * form[4 + d]))
        if i < state.movable:
            _into_box(form, p, size)
        _put_cells(cells, state, grid, i, state.turned[i], p)
    grid.excused[:] = 0
    grid.weights[:] = 1
    for i in range(state.movable):
        _share(cells, state, grid, i)


@kernel
def separate_cells(problem, cells, state, grid, size, passes, samples, weights, rng):
    """Move overlapping items in passes; the weights of pairs that overlap grow.

    Parameters
    ----------
    cells : Cells
        The cells of all types.
    state : State
        Poses of all items, which get those of the grid.
    grid : CellState
        Poses on the grid; changed.
    size : ndarray
        (3,) int64, the cells of the box.
    passes : int
        The most passes.
    samples : tuple of int
        Samples of a move near the item, and in the whole box.
    weights : tuple of float
        As in `separation_kernels.separate`.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    float
        The overlap after the last pass, unweighted; 0 if the poses have no conflict.
    """
    count = state.movable
    order = np.arange(count)
    near, far = samples
    for _ in range(passes):
        if _excuse(problem, cells, state, grid) == 0:
            return 0.0
        shuffle(order, rng)
        for k in range(count):
            i = order[k]
            if grid.shared[i].max() > 0:
                _move(problem, cells, state, grid, i, size, near, far, rng)
        _reweight(grid, grid.shared.max(), weights)
    return _excuse(problem, cells, state, grid)


@allocating_kernel
def _excuse(problem, cells, state, grid):
    """Ask the surfaces about all pairs that share cells; return the overlap that is left."""
    p = np.empty(3)
    for i in range(state.movable):
        form = cells.forms[state.types[i], state.turned[i]]
        for d in range(3):
            p[d] = grid.low[d] + (grid.bounds[i, d] + 0.5 * form[4 + d]) * cells.side
        put(problem.lookup, state, i, state.turned[i], p)
    total = 0.0
    for i in range(state.movable):
        form = cells.forms[state.types[i], state.turned[i]]
        for j in range(len(state.types)):
            if (j >= i and j < state.movable) or apart(state, i, j):
                continue
            if not grid.moved[i] and not grid.moved[j]:
                total += np.sqrt(grid.shared[i, j])
                continue
            if grid.shared[i, j] == 0 and grid.excused[i, j] == 0:
                continue
            other = cells.forms[state.types[j], state.turned[j]]
            shared = _shared_cells(cells.bits, form, grid.bounds[i], other, grid.bounds[j], 1 << 40)
            if shared == 0:
                continue
            left, excused = 0.0, grid.excused[i, j]
            if are_in_conflict(problem, state, i, j):
                if shared <= excused:
                    excused = 0
                left = shared - excused
                total += np.sqrt(left)
            else:
                excused = max(excused, shared)
            grid.excused[i, j] = grid.excused[j, i] = excused
            grid.shared[i, j] = grid.shared[j, i] = left
    grid.moved[:] = 0
    return total


@inner_kernel
def _reweight(grid, most, weights):
    """Let the weights of pairs that overlap grow, the deeper the more, and the others decay."""
    least, deepest, decay = weights
    for i in range(len(grid.shared)):
        for j in range(i):
            weight = max(1.0, grid.weights[i, j] * decay)
            if grid.shared[i, j] > 0:
                depth = np.sqrt(grid.shared[i, j] / most)
                weight = grid.weights[i, j] * (1 + least + deepest * depth)
            grid.weights[i, j] = grid.weights[j, i] = min(weight, 1e6)
