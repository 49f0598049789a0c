"""Kernels for how deep two items overlap: stored fields first, surfaces where these leave doubt.

A field (`field_kernels`) is read by trilinear interpolation for rough costs, and in tetrahedra of
four nodes for fine ones: half as many nodes to compute, and the gradient is constant within each.
The tetrahedra are those of Kuhn's triangulation of a cube (1960), found by sorting the rests.

Near contact a node may be computed by the surfaces instead of by voxels, when it is first needed:
the distance of surfaces that don't cross, or by bisection the way along the field's gradient after
which they no longer do. Such a node is *final* and never changes until the field is dropped.

`in_conflict` is exact for the drawn-in surfaces (`Surfaces`): they cross, are closer than the
clearance, or one item is inside the other by a winding number or by enclosed voxels.

Invariants: fields are only written here; a thread that shares them may compute a node twice, but
never reads half of one. When memory for fields is full, all are dropped and computed again when
needed. Work arrays of the problem belong to one thread.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inlined, inner_kernel, kernel
from packit_sim.parts.nesting.field_kernels import SCALE, encoded, fill_field, padding
from packit_sim.parts.nesting.surface_kernels import surfaces_cross, surfaces_distance
from packit_sim.placement import holds

_REACH = 3.0
"""Voxels beyond the clearance up to which a node holds the surfaces' distance."""

_MOST_DEPTH = 3.5
"""Voxels of depth up to which the surfaces compute a node; deeper, the field's value stays."""

_PRECISION = 0.1
"""Voxels by which a computed depth may be too large."""


@inlined
def node_of(lookup, number, sx, sy, sz):
    """Return the index of the node below an offset, -1 outside, and the rest (3) in voxels."""
    u, v, w = lookup.fields[number, 1], lookup.fields[number, 2], lookup.fields[number, 3]
    per_voxel = 1 / lookup.voxel
    x = sx * per_voxel + (u - 1) * 0.5
    y = sy * per_voxel + (v - 1) * 0.5
    z = sz * per_voxel + (w - 1) * 0.5
    i, j, k = int(x), int(y), int(z)
    at = -1  # int() rounds to 0, so x itself is compared: -0.5 is outside
    if 0 <= x < u - 1 and 0 <= y < v - 1 and 0 <= z < w - 1:
        at = lookup.fields[number, 0] + (i * v + j) * w + k
    return at, x - i, y - j, z - k


@inlined
def interpolated(lookup, number, at, fx, fy, fz):
    """Return the distance in voxels, interpolated between the eight nodes around an offset."""
    values = lookup.values
    row = lookup.fields[number, 3]
    plane = row * lookup.fields[number, 2]
    gx, gy, gz = 1 - fx, 1 - fy, 1 - fz
    low = ((values[at] >> 1) * gz + (values[at + 1] >> 1) * fz) * gy + (
        (values[at + row] >> 1) * gz + (values[at + row + 1] >> 1) * fz
    ) * fy
    at += plane
    high = ((values[at] >> 1) * gz + (values[at + 1] >> 1) * fz) * gy + (
        (values[at + row] >> 1) * gz + (values[at + row + 1] >> 1) * fz
    ) * fy
    return (low * gx + high * fx) * (1 / SCALE)


@inlined
def simplex(lookup, number, at, fx, fy, fz):
    """Return the nodes (4) around an offset: steps along the axes, the largest rest first."""
    row = lookup.fields[number, 3]
    plane = row * lookup.fields[number, 2]
    if fx >= fy:
        if fy >= fz:
            one, two = plane, row
        elif fx >= fz:
            one, two = plane, 1
        else:
            one, two = 1, plane
    elif fx >= fz:
        one, two = row, plane
    elif fy >= fz:
        one, two = row, 1
    else:
        one, two = 1, row
    return at, at + one, at + one + two, at + 1 + row + plane


@inlined
def gradient(lookup, number, nodes):
    """Return the gradient (3) of the distance in a tetrahedron of nodes, in its steps."""
    values = lookup.values
    a, b, c, d = nodes
    row = lookup.fields[number, 3]
    plane = row * lookup.fields[number, 2]
    one = (values[b] >> 1) - (values[a] >> 1)
    two = (values[c] >> 1) - (values[b] >> 1)
    three = (values[d] >> 1) - (values[c] >> 1)
    x = one if b - a == plane else two if c - b == plane else three
    y = one if b - a == row else two if c - b == row else three
    z = one if b - a == 1 else two if c - b == 1 else three
    return x, y, z


@allocating_kernel
def add_field(lookup, first, other, rel):
    """Compute the field of two types and a relative rotation, and return its number."""
    one = _voxels(lookup, first, lookup.identity)
    two = _voxels(lookup, other, rel)
    clearance = lookup.clearance / lookup.voxel
    around = 2 * padding(clearance) - 1
    u = one.shape[0] + two.shape[0] + around
    v = one.shape[1] + two.shape[1] + around
    w = one.shape[2] + two.shape[2] + around
    number, start = lookup.used[0], lookup.used[1]
    size = u * v * w
    # Full: drop all fields; those that are in use are soon computed again.
    if start + size > len(lookup.values) or number == len(lookup.fields):
        lookup.numbers[:] = -1
        number, start = 0, 0
        lookup.used[2] += 1
    fill_field(one, two, clearance, lookup.values[start : start + size].reshape((u, v, w)))
    lookup.fields[number, 0] = start
    lookup.fields[number, 1] = u
    lookup.fields[number, 2] = v
    lookup.fields[number, 3] = w
    lookup.numbers[first, other, rel] = number
    lookup.used[0] = number + 1
    lookup.used[1] = start + size
    return number


@kernel
def add_fields(lookup):
    """Compute the fields of all pairs of types; return whether there is space for all of them."""
    types, _, relative = lookup.numbers.shape
    for first in range(types):
        for other in range(first, types):
            for rel in range(relative):
                add_field(lookup, first, other, rel)
                if lookup.used[2] > 0:
                    return False
    return True


@allocating_kernel
def _voxels(lookup, a, rel):
    """Return the voxels (x, y, z) of a type in one of the relative rotations."""
    start, x, y, z = lookup.voxel_fields[a, rel]
    return lookup.voxels[start : start + x * y * z].reshape((x, y, z))


@inner_kernel
def refine_node(problem, first, other, rel, at):
    """Compute a node by the surfaces; it is final then."""
    lookup = problem.lookup
    number = lookup.numbers[first, other, rel]
    start, u, v, w = lookup.fields[number]
    field = lookup.values[start : start + u * v * w].reshape((u, v, w))
    z = (at - start) % w
    y = (at - start) // w % v
    x = (at - start) // (w * v)
    found = _node(problem, first, other, rel, field, x, y, z)
    field[x, y, z] = encoded(found, True)


@inner_kernel
def _node(problem, first, other, rel, field, x, y, z):
    """Return the signed distance at a node, less the clearance, by the surfaces, in voxels."""
    u, v, w = field.shape
    voxel = problem.lookup.voxel
    shift = problem.shift
    shift[0] = (x - (u - 1) * 0.5) * voxel
    shift[1] = (y - (v - 1) * 0.5) * voxel
    shift[2] = (z - (w - 1) * 0.5) * voxel
    clearance = problem.lookup.clearance / voxel
    rough = (field[x, y, z] >> 1) / SCALE
    if not cross_at_shift(problem, first, other, rel):
        # Surfaces that don't cross: apart, or one item inside the other, which has no depth here.
        if rough + clearance < 0.5 and _nested(problem, first, other, rel):
            return min(rough, -0.5)
        most = (_REACH + clearance) * voxel
        return distance_at_shift(problem, first, other, rel, most) / voxel - clearance
    gx = float((field[min(u - 1, x + 1), y, z] >> 1) - (field[max(0, x - 1), y, z] >> 1))
    gy = float((field[x, min(v - 1, y + 1), z] >> 1) - (field[x, max(0, y - 1), z] >> 1))
    gz = float((field[x, y, min(w - 1, z + 1)] >> 1) - (field[x, y, max(0, z - 1)] >> 1))
    length = np.sqrt(gx * gx + gy * gy + gz * gz)
    if length == 0:  # in the middle of a symmetric overlap no way out is shorter than the others
        return min(rough, -0.5 - clearance)
    ox, oy, oz = shift[0], shift[1], shift[2]
    # Bisect the way out, from a first guess by the field; `high` is never too small, so that a
    # depth is overestimated by up to the precision and no overlap is lost.
    low, high = 0.0, _MOST_DEPTH
    middle = min(high, max(1.0, 1.5 - rough))
    scale = voxel / length
    while high - low > _PRECISION:
        shift[0] = ox + middle * scale * gx
        shift[1] = oy + middle * scale * gy
        shift[2] = oz + middle * scale * gz
        if cross_at_shift(problem, first, other, rel):
            low = middle
        else:
            high = middle
        middle = (low + high) * 0.5
    if high == _MOST_DEPTH:  # this way leads nowhere: keep what voxels say
        return min(rough, -0.5 - clearance)
    return -high - clearance


@inner_kernel
def in_conflict(problem, first, other, rel, sx, sy, sz, maybe_nested):
    """Return whether items at an offset cross, are too close, or one is in the other, if it may."""
    problem.shift[0], problem.shift[1], problem.shift[2] = sx, sy, sz
    limit = problem.lookup.clearance
    # In this order: a crossing is the most frequent conflict, and a distance or an inside are only
    # defined for surfaces that don't cross.
    return (
        cross_at_shift(problem, first, other, rel)
        or (limit > 0 and distance_at_shift(problem, first, other, rel, limit) < limit)
        or (maybe_nested and _nested(problem, first, other, rel))
    )


@inner_kernel
def cross_at_shift(problem, first, other, rel):
    """Return whether the surfaces of two types cross at `problem.shift`."""
    s = problem.surfaces
    a, b = first, other
    return surfaces_cross(
        s.first[s.triangle_starts[a] : s.triangle_starts[a + 1]],
        s.boxes[s.box_starts[a] : s.box_starts[a + 1]],
        s.leaves[s.leaf_starts[a] : s.leaf_starts[a + 1]],
        s.other[s.triangle_starts[b] : s.triangle_starts[b + 1]],
        s.boxes[s.box_starts[b] : s.box_starts[b + 1]],
        s.leaves[s.leaf_starts[b] : s.leaf_starts[b + 1]],
        problem.relative_turns[rel],
        problem.shift,
        problem.waiting,
        problem.triangle,
    )


@inner_kernel
def distance_at_shift(problem, first, other, rel, limit):
    """Return the distance of surfaces that don't cross at `problem.shift`, or the limit."""
    s = problem.surfaces
    a, b = first, other
    return surfaces_distance(
        s.first[s.triangle_starts[a] : s.triangle_starts[a + 1]],
        s.owned[s.triangle_starts[a] : s.triangle_starts[a + 1]],
        s.boxes[s.box_starts[a] : s.box_starts[a + 1]],
        s.leaves[s.leaf_starts[a] : s.leaf_starts[a + 1]],
        s.other[s.triangle_starts[b] : s.triangle_starts[b + 1]],
        s.owned[s.triangle_starts[b] : s.triangle_starts[b + 1]],
        s.boxes[s.box_starts[b] : s.box_starts[b + 1]],
        s.leaves[s.leaf_starts[b] : s.leaf_starts[b + 1]],
        problem.relative_turns[rel],
        problem.shift,
        problem.waiting,
        problem.triangle,
        limit,
    )


@allocating_kernel
def _nested(problem, first, other, rel):
    """Return whether a part of one of two items at `problem.shift` is inside the other."""
    turn = problem.relative_turns[rel]
    unturned = problem.relative_turns[problem.lookup.identity]
    return _holds(problem, first, other, unturned, turn, problem.shift) or _holds(
        problem, other, first, turn, unturned, -problem.shift
    )


@inner_kernel
def _holds(problem, around, inside, turn, inside_turn, shift):
    """Return whether a closed part of an item holds a part of another one, or its solid does."""
    s, c = problem.solids, problem.closed
    points = s.points[s.point_starts[inside] : s.point_starts[inside + 1]]
    if len(points) == 0:
        return False
    if c.triangle_starts[around + 1] > c.triangle_starts[around] and holds(
        points,
        c.triangles[c.triangle_starts[around] : c.triangle_starts[around + 1]],
        c.part[c.triangle_starts[around] : c.triangle_starts[around + 1]],
        c.boxes[c.box_starts[around] : c.box_starts[around + 1]],
        c.leaves[c.leaf_starts[around] : c.leaf_starts[around + 1]],
        turn,
        inside_turn,
        shift,
    ):
        return True
    # A surface that is not closed may enclose space all the same, by voxels.
    start = s.starts[around]
    if s.dims[around, 0] == 0:
        return False
    per_voxel = 1 / s.voxels[around]
    for n in range(len(points)):
        at, bit = 0, 0
        for d in range(3):
            place = 0.0
            for e in range(3):
                whole = shift[e]
                for f in range(3):
                    whole += inside_turn[e, f] * points[n, f]
                place += turn[e, d] * whole
            cell = int(np.floor((place - s.lows[around, d]) * per_voxel))
            if not 0 <= cell < 4 * s.dims[around, d]:
                at = -1
                break
            at = at * s.dims[around, d] + (cell >> 2)
            bit = 4 * bit + (cell & 3)
        if at >= 0 and s.enclosed[start + at] >> np.uint64(bit) & np.uint64(1):
            return True
    return False
