"""Kernels that find the fine cells that a surface touches, and those outside it.

Touching is decided by the separating axes of a triangle and a cube (Akenine-Moeller, 2001), exact
up to rounding, for cells that are grown so much that rounding can't lose one. It is not asked cell
by cell: along the triangle's longest axis, all separating axes together leave one interval, which
is computed and filled at once (our own).

The outside is a flood fill from the border of the cell box through faces of untouched cells, 64
cells at a time: within a word by shifts and masks, between words over a stack, each word again when
a neighbour grows into it. What is neither touched nor reached is enclosed.

Words are indexed [x, y, z], bits as in `bits`. Results are new arrays.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.bits import HIGH, LOW, STRIDES

_X_LOW, _Y_LOW, _Z_LOW = LOW
_X_HIGH, _Y_HIGH, _Z_HIGH = HIGH
_1, _3, _4, _12, _16, _48 = (np.uint64(n) for n in (1, 3, 4, 12, 16, 48))


@kernel
def touched_cells(triangles, cells, cell, grow):
    """Return words [x, y, z] of the fine cells, grown on all sides, that a triangle meets.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64, corners relative to the centre of the cell box.
    cells : ndarray
        (3,) int64, cells along each axis of the cell box.
    cell : float
        Side of a cell.
    grow : float
        Length by which fine cells are grown on each side.

    Returns
    -------
    Words
        uint64 [x, y, z].

    Notes
    -----
    This is the separating-axis test of Akenine-Moeller (2001), with the box's 3 axes, the
    triangle's normal, and the 9 products of their edges. Along w, the longest axis of the
    triangle's bounding box, each test leaves an interval of fine cells; their intersection is set.
    """
    words = np.zeros((cells[0], cells[1], cells[2]), np.uint64)
    fine = cell / 4
    half = fine / 2 + grow
    corners = np.empty((3, 3))
    rows = np.empty((4, 4))  # axes that bound v: 3 products of edges with w, and v itself
    columns = np.empty((8, 5))  # that bound w: the normal, 6 products with u and v, and w
    low = np.empty(3)
    high = np.empty(3)
    place = np.empty(3, np.int64)
    for t in range(len(triangles)):
        for d in range(3):
            a, b, c = triangles[t, 0, d], triangles[t, 1, d], triangles[t, 2, d]
            low[d], high[d] = min(a, b, c), max(a, b, c)
        # Columns along the longest axis: fewest of them, and the longest intervals.
        w = 0
        for d in range(1, 3):
            if high[d] - low[d] > high[w] - low[w]:
                w = d
        u, v = (w + 1) % 3, (w + 2) % 3
        for c in range(3):
            corners[c, 0] = triangles[t, c, u]
            corners[c, 1] = triangles[t, c, v]
            corners[c, 2] = triangles[t, c, w]
        _separating_axes(corners, half, rows, columns)
        start_u, stop_u = _places(low[u] - half, high[u] + half, cells[u], fine)
        for at_u in range(start_u, stop_u):
            center_u = (at_u + 0.5 - 2 * cells[u]) * fine
            first, last = -np.inf, np.inf
            for a in range(4):
                first, last = _narrowed(
                    first, last, rows[a, 0] * center_u, rows[a, 1], rows[a, 2], rows[a, 3]
                )
            start_v, stop_v = _places(first, last, cells[v], fine)
            for at_v in range(start_v, stop_v):
                center_v = (at_v + 0.5 - 2 * cells[v]) * fine
                first, last = -np.inf, np.inf
                for a in range(8):
                    at = columns[a, 0] * center_u + columns[a, 1] * center_v
                    first, last = _narrowed(
                        first, last, at, columns[a, 2], columns[a, 3], columns[a, 4]
                    )
                start_w, stop_w = _places(first, last, cells[w], fine)
                if start_w < stop_w:
                    _set_column(words, (u, v, w), (at_u, at_v), start_w, stop_w, place)
    return words


@kernel
def reached_cells(touched):
    """Return words [x, y, z] of the untouched fine cells that are connected to the outside.

    Parameters
    ----------
    touched : Words
        uint64 [x, y, z], the touched fine cells of each cell.

    Returns
    -------
    Words
        uint64 [x, y, z], the fine cells that are connected to the outside of the cell box through
        faces of untouched fine cells.
    """
    nx, ny, nz = touched.shape
    reached = np.zeros_like(touched)
    queued = np.zeros(touched.shape, np.bool_)
    stack = np.empty((touched.size, 3), np.int32)
    top = 0
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                border = np.uint64(0)
                if x == 0:
                    border |= _X_LOW
                if x == nx - 1:
                    border |= _X_HIGH
                if y == 0:
                    border |= _Y_LOW
                if y == ny - 1:
                    border |= _Y_HIGH
                if z == 0:
                    border |= _Z_LOW
                if z == nz - 1:
                    border |= _Z_HIGH
                border &= ~touched[x, y, z]
                if border:
                    reached[x, y, z] = border
                    stack[top] = (x, y, z)
                    queued[x, y, z] = True
                    top += 1
    while top:
        top -= 1
        x, y, z = stack[top]
        queued[x, y, z] = False
        free = ~touched[x, y, z]
        flood = reached[x, y, z]
        # Within the word, until nothing grows; masks keep bits from wrapping into the next row.
        while True:
            grown = flood | (flood & ~_Z_HIGH) << _1 | (flood & ~_Z_LOW) >> _1
            grown |= (flood & ~_Y_HIGH) << _4 | (flood & ~_Y_LOW) >> _4
            grown |= flood << _16 | flood >> _16
            grown &= free
            if grown == flood:
                break
            flood = grown
        reached[x, y, z] = flood
        for side in range(6):
            u, v, w = x, y, z
            if side == 0:
                u, into = x + 1, flood >> _48
            elif side == 1:
                u, into = x - 1, flood << _48
            elif side == 2:
                v, into = y + 1, (flood & _Y_HIGH) >> _12
            elif side == 3:
                v, into = y - 1, (flood & _Y_LOW) << _12
            elif side == 4:
                w, into = z + 1, (flood & _Z_HIGH) >> _3
            else:
                w, into = z - 1, (flood & _Z_LOW) << _3
            if u < 0 or u >= nx or v < 0 or v >= ny or w < 0 or w >= nz:
                continue
            into &= ~(touched[u, v, w] | reached[u, v, w])
            if into:
                reached[u, v, w] |= into
                # Once in the stack is enough: so it never holds more words than there are.
                if not queued[u, v, w]:
                    queued[u, v, w] = True
                    stack[top] = (u, v, w)
                    top += 1
    return reached


@inner_kernel
def _separating_axes(corners, half, rows, columns):
    """Write each axis: its components along u, v and w, and the bounds that a center is within."""
    for e in range(3):
        f = (e + 1) % 3
        u = corners[f, 0] - corners[e, 0]
        v = corners[f, 1] - corners[e, 1]
        w = corners[f, 2] - corners[e, 2]
        rows[e, 0], rows[e, 1] = v, -u
        columns[e, 0], columns[e, 1], columns[e, 2] = 0.0, w, -v
        columns[3 + e, 0], columns[3 + e, 1], columns[3 + e, 2] = -w, 0.0, u
        if e == 0:
            first_u, first_v, first_w = u, v, w
        elif e == 1:
            columns[6, 0] = first_v * w - first_w * v
            columns[6, 1] = first_w * u - first_u * w
            columns[6, 2] = first_u * v - first_v * u
    rows[3, 0], rows[3, 1] = 0.0, 1.0
    columns[7, 0], columns[7, 1], columns[7, 2] = 0.0, 0.0, 1.0
    for a in range(4):
        reach = half * (abs(rows[a, 0]) + abs(rows[a, 1]))
        rows[a, 2], rows[a, 3] = np.inf, -np.inf
        for c in range(3):
            at = rows[a, 0] * corners[c, 0] + rows[a, 1] * corners[c, 1]
            rows[a, 2] = min(rows[a, 2], at - reach)
            rows[a, 3] = max(rows[a, 3], at + reach)
    for a in range(8):
        reach = half * (abs(columns[a, 0]) + abs(columns[a, 1]) + abs(columns[a, 2]))
        columns[a, 3], columns[a, 4] = np.inf, -np.inf
        for c in range(3):
            at = (
                columns[a, 0] * corners[c, 0]
                + columns[a, 1] * corners[c, 1]
                + columns[a, 2] * corners[c, 2]
            )
            columns[a, 3] = min(columns[a, 3], at - reach)
            columns[a, 4] = max(columns[a, 4], at + reach)


@inner_kernel
def _narrowed(first, last, at, slope, low, high):
    """Return the part of an interval of x in which `at + slope * x` is from low to high."""
    if slope == 0.0:  # the axis is across x: it separates all centers or none
        if at < low or at > high:
            return np.inf, -np.inf
        return first, last
    a, b = (low - at) / slope, (high - at) / slope
    return max(first, min(a, b)), min(last, max(a, b))


@inner_kernel
def _places(first, last, cells, fine):
    """Return the range, start and stop, of the fine cells with a center in an interval."""
    if not first <= last:
        return 0, 0
    start = np.ceil(max(first / fine + 2 * cells - 0.5, 0.0))
    stop = np.floor(min(last / fine + 2 * cells - 0.5, 4 * cells - 1.0)) + 1.0
    return np.int64(start), np.int64(max(start, stop))


@inner_kernel
def _set_column(words, axes, column, start_w, stop_w, place):
    """Set the bits of a column's fine cells from start to stop; place: (3,) scratch space."""
    u, v, w = axes
    at_u, at_v = column
    place[u], place[v] = at_u >> 2, at_v >> 2
    across = np.uint64((at_u & 3) * STRIDES[u] + (at_v & 3) * STRIDES[v])
    for cell in range(start_w >> 2, (stop_w + 3) >> 2):
        place[w] = cell
        bits = np.uint64(0)
        for at_w in range(max(start_w, 4 * cell), min(stop_w, 4 * cell + 4)):
            bits |= _1 << np.uint64((at_w & 3) * STRIDES[w])
        words[place[0], place[1], place[2]] |= bits << across
