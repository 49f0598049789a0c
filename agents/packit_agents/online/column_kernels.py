"""Kernels of `ColumnGame`: placements, the values of states, learning, and looking ahead.

A state is the filled heights of the columns, and how many of each shape are visible. Its value is
the number of shapes that will still be placed. `game` is the sides of the box, `ColumnGame.firsts`
and `ColumnGame.forms`. `tables` is from `Patterns`: the columns of each pattern, the patterns of
each column, where the table of each pattern begins, and the entries of all tables. `scratch` holds
the entry of each pattern, zeros, and what is overwritten.
"""

from __future__ import annotations

import numpy as np

from packit_agents.online.columns import FORM_START
from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel

FEW = 5
"""Placements that are compared where two arrivals are looked ahead."""


@inner_kernel
def _rest(heights, row, x, y, sides):
    """Return the height at which a form comes to rest at (x, y); -1 if it does not fit."""
    base = 0
    for n in range(row[4]):
        at = FORM_START + 4 * n
        base = max(base, heights[(x + row[at]) * sides[1] + y + row[at + 1]] - row[at + 2])
    return base if base + row[3] <= sides[2] else -1


@inner_kernel
def _place(heights, row, x, y, sides, after):
    """Write the heights after a form has come down at (x, y)."""
    base = _rest(heights, row, x, y, sides)
    for n in range(len(heights)):
        after[n] = heights[n]
    for n in range(row[4]):
        at = FORM_START + 4 * n
        after[(x + row[at]) * sides[1] + y + row[at + 1]] = base + row[at + 3]


@inner_kernel
def _look_up(heights, tables, levels, now):
    """Write the entry of each pattern of columns; return their sum, the value of the state."""
    patterns, _, starts, entries = tables
    total = 0.0
    for n in range(len(starts)):
        found = 0
        for column in patterns[n]:
            if column < 0:
                break
            found = found * levels + heights[column]
        now[n] = starts[n] + found
        total += entries[now[n]]
    return total


@inner_kernel
def _gain(heights, row, x, y, base, sides, tables, now, moved, touched):
    """Return by how much the value changes with a form at (x, y): only its patterns count.

    `now` is from `_look_up`; `moved` holds zeros, before and after; `touched` is overwritten.
    """
    _, users, _, entries = tables
    count = 0
    for n in range(row[4]):
        at = FORM_START + 4 * n
        column = (x + row[at]) * sides[1] + y + row[at + 1]
        rise = base + row[at + 3] - heights[column]
        for pattern, weight in users[column]:
            if pattern < 0:
                break
            if moved[pattern] == 0:
                touched[count] = pattern
                count += 1
            moved[pattern] += rise * weight
    total = 0.0
    for pattern in touched[:count]:
        total += entries[now[pattern] + moved[pattern]] - entries[now[pattern]]
        moved[pattern] = 0
    return total


@inner_kernel
def _best(heights, shape, game, tables, scratch):
    """Return the largest gain of placing a shape; -inf if it does not fit."""
    sides, firsts, forms = game
    now, moved, touched = scratch
    best = -np.inf
    for form in range(firsts[shape], firsts[shape + 1]):
        row = forms[form]
        for x in range(sides[0] - row[1] + 1):
            for y in range(sides[1] - row[2] + 1):
                base = _rest(heights, row, x, y, sides)
                if base >= 0:
                    gain = _gain(heights, row, x, y, base, sides, tables, now, moved, touched)
                    best = max(best, gain)
    return best


@inner_kernel
def _expected(heights, counts, game, tables, scratch, bests):
    """Return the mean over arrivals of the shapes that will be placed then."""
    shapes = len(counts)
    value = _look_up(heights, tables, game[0][2] + 1, scratch[0])
    most = 0.0
    for shape in range(shapes):
        bests[shape] = max(0.0, 1 + value + _best(heights, shape, game, tables, scratch))
        if counts[shape] > 0:
            most = max(most, bests[shape])
    total = 0.0
    for shape in range(shapes):
        total += max(most, bests[shape])
    return total / shapes


@inner_kernel
def _list(heights, counts, game, tables, scratch, found, values, count):
    """Append the placements of all visible shapes, (shape, form, x, y), and the values after."""
    sides, firsts, forms = game
    now, moved, touched = scratch
    value = _look_up(heights, tables, sides[2] + 1, now)
    for shape in range(len(counts)):
        if counts[shape] == 0:
            continue
        for form in range(firsts[shape], firsts[shape + 1]):
            row = forms[form]
            for x in range(sides[0] - row[1] + 1):
                for y in range(sides[1] - row[2] + 1):
                    base = _rest(heights, row, x, y, sides)
                    if base >= 0:
                        found[count, 0], found[count, 1] = shape, form
                        found[count, 2], found[count, 3] = x, y
                        values[count] = value + _gain(
                            heights, row, x, y, base, sides, tables, now, moved, touched
                        )
                        count += 1
    return count


@allocating_kernel
def _scratch(tables):
    patterns = len(tables[2])
    return (
        np.empty(patterns, np.int64),
        np.zeros(patterns, np.int64),
        np.empty(patterns, np.int64),
    )


@allocating_kernel
def _expected_later(heights, counts, game, tables, scratch, bests, found, values):
    """Return the same as `_expected`, looking one arrival further after the best `FEW`."""
    sides, _, forms = game
    after, left = np.empty_like(heights), counts.copy()
    total = 0.0
    for arrival in range(len(counts)):
        left[arrival] += 1
        count = _list(heights, left, game, tables, scratch, found, values, 0)
        best = 0.0
        for n in np.argsort(-values[:count], kind="mergesort")[:FEW]:
            shape, form, x, y = found[n]
            _place(heights, forms[form], x, y, sides, after)
            left[shape] -= 1
            best = max(best, 1 + _expected(after, left, game, tables, scratch, bests))
            left[shape] += 1
        total += best
        left[arrival] -= 1
    return total / len(counts)


@kernel
def play(arrivals, buffer, game, tables, learning):
    """Play games by the highest value, and learn from them.

    Parameters
    ----------
    arrivals : ndarray
        int64 (games, items), the shapes that arrive.
    buffer : int
        Visible shapes.
    learning : tuple of ndarray
        For each entry the sum of its errors, and the sum of their absolute values: its rate of
        learning is the ratio (temporal coherence, Beal and Smith, 1999). Empty: nothing is learned.

    Returns
    -------
    ndarray
        int64 (games,), the number of shapes that were placed.
    """
    sides, firsts, forms = game
    entries = tables[3]
    errors, sizes = learning
    shapes, levels = len(firsts) - 1, sides[2] + 1
    placed = np.zeros(len(arrivals), np.int64)
    heights, spare = np.empty((2, sides[0] * sides[1]), np.int64)
    counts = np.empty(shapes, np.int64)
    scratch = _scratch(tables)
    now = scratch[0]
    most = len(forms) * sides[0] * sides[1]
    found, values = np.empty((most, 4), np.int64), np.empty(most)
    for number in range(len(arrivals)):
        heights[:] = 0
        counts[:] = 0
        for shape in arrivals[number, :buffer]:
            counts[shape] += 1
        done = 0
        while True:
            count = _list(heights, counts, game, tables, scratch, found, values, 0)
            if done and len(errors):
                target = 1 + values[:count].max() if count else 0.0
                error = (target - _look_up(heights, tables, levels, now)) / len(now)
                for at in now:
                    rate = 1.0 if sizes[at] == 0 else abs(errors[at]) / sizes[at]
                    entries[at] += rate * error
                    errors[at] += error
                    sizes[at] += abs(error)
            if count == 0 or buffer + done >= arrivals.shape[1]:
                break
            shape, form, x, y = found[values[:count].argmax()]
            _place(heights, forms[form], x, y, sides, spare)
            heights[:] = spare
            counts[shape] -= 1
            counts[arrivals[number, buffer + done]] += 1
            done += 1
        placed[number] = done
    return placed


@kernel
def plan(heights, counts, known, game, tables, depth, width, plies):
    """Look ahead: a beam of the visible shapes, then the mean over what may arrive.

    Parameters
    ----------
    heights : ndarray
        int64 (x * y,).
    counts : ndarray
        int64 (shapes,), the visible ones.
    known : ndarray
        int64 (n,), the shapes that arrive next, where an agent knows them; empty in the game.
    depth, width : int
        Placements, and states after each.
    plies : int
        Arrivals after the beam over which the mean is taken: 0 to 2. Over two it is taken for the
        `FEW` states with the best means over one.

    Returns
    -------
    found : ndarray
        int64 (4,): the shape, its form, x and y; the shape is -1 if nothing fits.
    value : float
        Shapes that will be placed, from now on.
    """
    sides, _, forms = game
    shapes, columns = len(counts), len(heights)
    most = width * len(forms) * sides[0] * sides[1]
    found, values = np.empty((most, 4), np.int64), np.empty(most)
    parents = np.empty(most, np.int64)
    later, later_values = found[: most // width].copy(), values[: most // width].copy()
    scratch, bests = _scratch(tables), np.empty(shapes)
    kept, kept_counts = np.empty((width, columns), np.int64), np.empty((width, shapes), np.int64)
    new, new_counts = np.empty_like(kept), np.empty_like(kept_counts)
    roots, new_roots = np.empty((width, 4), np.int64), np.empty((width, 4), np.int64)
    kept[0], kept_counts[0] = heights, counts
    ends = np.empty(width)
    states, best = 1, -np.inf
    chosen = np.full(4, -1)
    for step in range(depth + 1):
        count = 0
        for state in range(states):
            before = count
            if step < depth:
                count = _list(
                    kept[state], kept_counts[state], game, tables, scratch, found, values, count
                )
                parents[before:count] = state
            ends[state] = -np.inf
            if count == before and step > 0:
                ends[state] = step
                if plies > 0:
                    ends[state] += _expected(
                        kept[state], kept_counts[state], game, tables, scratch, bests
                    )
                elif step == depth:
                    ends[state] += _look_up(kept[state], tables, sides[2] + 1, scratch[0])
        order = np.argsort(-ends[:states], kind="mergesort")
        for state in order[: FEW if plies == 2 else 1]:
            value = ends[state]
            if plies == 2 and value >= step:
                value = step + _expected_later(
                    kept[state],
                    kept_counts[state],
                    game,
                    tables,
                    scratch,
                    bests,
                    later,
                    later_values,
                )
            if value > best:
                best = value
                chosen[:] = roots[state]
        states = 0
        for n in np.argsort(-values[:count], kind="mergesort"):
            if states == width:
                break
            parent = parents[n]
            shape, form, x, y = found[n]
            _place(kept[parent], forms[form], x, y, sides, new[states])
            new_counts[states] = kept_counts[parent]
            new_counts[states, shape] -= 1
            if step < len(known):
                new_counts[states, known[step]] += 1
            new_roots[states] = found[n] if step == 0 else roots[parent]
            is_new = True
            for other in range(states):
                if (new[other] == new[states]).all() and (
                    new_counts[other] == new_counts[states]
                ).all():
                    is_new = False
                    break
            if is_new:
                states += 1
        kept, new = new, kept
        kept_counts, new_counts = new_counts, kept_counts
        roots, new_roots = new_roots, roots
        if states == 0:
            break
    return chosen, max(best, 0.0)
