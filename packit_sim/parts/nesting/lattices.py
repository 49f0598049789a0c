"""Lattices of equal items: one or two of them, repeated along three vectors.

Algorithm: the offsets at which two items are in conflict are a correlation of their cells, for each
pair of rotations. A unit is one item, or two of which the second one goes where the bounding box of
both is least. It is repeated along an axis by the shortest way that is free, these rows by the
shortest way across, with any shift, and these layers likewise, in all orders of the axes. The
lattices of which most fit into the box are then narrowed, as far as the surfaces allow: the vectors
become shorter, one after the other. The method is our own; lattices of polygons go back to
Milenkovic (2002).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import numpy.typing as npt
from scipy import fft

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.pose_kernels import put
from packit_sim.parts.nesting.problem import Problem, state_of
from packit_sim.parts.nesting.settling_kernels import count_conflicts
from packit_sim.parts.nesting.tasks import Poses, SearchTask
from packit_sim.parts.nesting.voxel_sets import voxelized

Mask = npt.NDArray[np.bool_]

FEWEST = 12
"""Fewest equal items for which a lattice is looked for."""

CELLS = 40
"""Cells along the longest side of an item."""

MOST_TURNS = 48
"""Most rotations that are tried: each takes time with each other one."""

PAIRS = 12
"""Pairs of items that are repeated: those with the least bounding boxes."""

NARROWED = 24
"""Lattices that are narrowed."""

STEP = 0.1
"""Step of a vector that becomes shorter, in cells."""

REACH = 2.5, 1.0
"""Cells by which a vector may become shorter, and longer where those before became shorter."""


LOOSE = 0.2
"""Share by which a grid in cells may be higher than one of bounding boxes."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """A unit of items, and the vectors along which it is repeated.

    Attributes
    ----------
    turns : tuple of int
        The rotations of the unit's items.
    places : ndarray of float64, shape (u, 3)
        Their places; the first one is at the origin.
    vectors : ndarray of float64, shape (3, 3)
        Along the row, from row to row, and from layer to layer.
    axes : tuple of int
        The axes of rows, layers and heights, for which the vectors are lower triangular.
    """

    turns: tuple[int, ...]
    places: Floats
    vectors: Floats
    axes: tuple[int, ...]

    @property
    def volume(self) -> float:
        """The space that an item takes."""
        return abs(float(np.linalg.det(self.vectors))) / len(self.turns)


def has_copies(task: SearchTask) -> bool:
    """Return whether all items are equal, and many, without obstacles."""
    return len(np.unique(task.numbers)) == 1 and task.count >= FEWEST


def lattice_poses(problem: Problem, task: SearchTask) -> Poses | None:
    """Fill the box of a task of equal items with the lattice of which most fit.

    Returns
    -------
    Poses or None
        The poses, or None if there are several types, few items, or obstacles.
    """
    if not has_copies(task):
        return None
    boxes, allowed = problem.lookup.boxes[0], problem.allowed[0, : problem.allowed_counts[0]]
    sides = boxes[:, 3:] - boxes[:, :3]
    size = np.array(task.size)
    fitting = [o for o in allowed.tolist() if (sides[o] <= size + problem.lookup.slack).all()]
    if not fitting:
        return None
    fitting = fitting[:: -(-len(fitting) // MOST_TURNS)]
    if task.size[2] == np.inf:
        size[2] = min(_grid_height(sides[o], size, task.count) for o in fitting)
    cell = float(sides[fitting[0]].max()) / CELLS

    def filled(lattice: Lattice) -> tuple[Ints, Floats]:
        return _filled(lattice, boxes, size, task.count)

    rough = {
        (*_rank(filled(one), boxes), one.volume): one  # mirrored lattices are the same
        for one in _lattices(_Cells(problem, fitting, cell))
    }
    close = [_narrowed(problem, rough[rank], cell) for rank in sorted(rough)[:NARROWED]]
    close += [_grid(o, sides[o] + problem.lookup.clearance) for o in fitting]
    turned, places = min(map(filled, close), key=lambda each: _rank(each, boxes))
    poses = task.unplaced
    own = slice(len(turned))
    poses.inside[own], poses.turned[own], poses.places[own] = 1, turned, places
    return poses


def _grid(turned: int, steps: Floats) -> Lattice:
    """Return the lattice of an item's bounding boxes."""
    return Lattice((turned,), np.zeros((1, 3)), np.diag(steps), (0, 1, 2))


def _grid_height(sides: Floats, size: Floats, count: int) -> float:
    """Return the height of a strip with items in a grid of their bounding boxes."""
    across = np.maximum(1, size[:2] // sides[:2]).prod()
    return float(np.ceil(count / across) * sides[2] * (1 + LOOSE))


def _rank(found: tuple[Ints, Floats], boxes: Floats) -> tuple[float, float]:
    """Return what to minimise: more items are better, and then less height."""
    turned, places = found
    height = float((places[:, 2] + boxes[turned, 5]).max(initial=0.0))
    return -float(len(turned)), height


class _Cells:
    """The cells of an item in its rotations, and the offsets at which two of it share any."""

    def __init__(self, problem: Problem, allowed: Sequence[int], cell: float) -> None:
        lookup, surfaces = problem.lookup, problem.surfaces
        triangles = surfaces.other[surfaces.triangle_starts[0] : surfaces.triangle_starts[1]]
        self.cell = cell
        self.turns = tuple(allowed)
        grow = lookup.clearance / 2
        solids = [voxelized(triangles @ lookup.turns[o].T, cell, grow) for o in allowed]
        self.sides = [np.array(each.shape) for each in solids]
        most = 2 * max(int(each.max()) for each in self.sides)
        self._side = fft.next_fast_len(most, real=True)
        shape = (self._side,) * 3
        self._transforms = [fft.rfftn(each.astype(np.float32), shape) for each in solids]
        self._known: dict[tuple[int, int], Mask] = {}

    def blocked(self, one: int, other: int) -> Mask:
        """Return the offsets of a second item at which it shares cells with the first.

        Offsets are those of the lowest cells, from the least at which the bounding boxes meet.
        """
        if (one, other) not in self._known:
            if (other, one) in self._known:
                return self._known[other, one][::-1, ::-1, ::-1]
            product = self._transforms[one] * self._transforms[other].conj()
            shared = fft.irfftn(product, (self._side,) * 3) > 0.5
            low = self.sides[other] - 1
            rolled = np.roll(shared, low, axis=(0, 1, 2))
            x, y, z = self.sides[one] + low
            self._known[one, other] = np.ascontiguousarray(rolled[:x, :y, :z])
        return self._known[one, other]


@dataclass(frozen=True, eq=False)
class _Unit:
    """Items of a unit by numbers of rotations, and their lowest cells (u, 3), the least 0."""

    items: tuple[int, ...]
    lows: Ints
    sides: Ints

    def blocked(self, cells: _Cells) -> Mask:
        """Return the offsets (2 x - 1, 2 y - 1, 2 z - 1) at which the unit meets itself."""
        found = np.zeros(2 * self.sides - 1, bool)
        for m, n in product(range(len(self.items)), repeat=2):
            own = cells.blocked(self.items[m], self.items[n])
            # The offset of the items is that of the units, and what they differ by.
            start = self.sides - cells.sides[self.items[n]] - self.lows[n] + self.lows[m]
            x, y, z = (slice(s, s + k) for s, k in zip(start, own.shape, strict=True))
            found[x, y, z] |= own
        return found


def _units(cells: _Cells) -> Iterator[_Unit]:
    """Yield items alone, and the pairs that have the least bounding boxes."""
    count = len(cells.turns)
    for a in range(count):
        yield _Unit((a,), np.zeros((1, 3), np.int64), cells.sides[a])
    # Turning a pair as a whole is left to the order of the axes, apart from different sides.
    firsts = {tuple(each.tolist()): a for a, each in reversed(list(enumerate(cells.sides)))}
    pairs = [pair for a in firsts.values() for b in range(count) for pair in _pairs(cells, a, b)]
    pairs.sort(key=lambda unit: int(unit.sides.prod()))
    yield from pairs[:PAIRS]


def _pairs(cells: _Cells, a: int, b: int) -> Iterator[_Unit]:
    """Yield the pair of two rotations with the least bounding box."""
    blocked = cells.blocked(a, b)
    one, other = cells.sides[a], cells.sides[b]
    spans = []
    for d in range(3):
        offset = np.arange(blocked.shape[d]) - other[d] + 1
        spans.append(np.maximum(one[d], offset + other[d]) - np.minimum(0, offset))
    volumes = spans[0][:, None, None] * spans[1][:, None] * spans[2]
    volumes[blocked] = np.iinfo(np.int64).max
    at = np.array(np.unravel_index(volumes.argmin(), volumes.shape))
    if blocked[tuple(at)]:
        return
    lows = np.array([(0, 0, 0), at - other + 1])
    lows -= lows.min(axis=0)
    sides = (lows + np.array([one, other])).max(axis=0)
    yield _Unit((a, b), lows, sides)


def _lattices(cells: _Cells) -> Iterator[Lattice]:
    """Yield the lattices of each unit for each order of the axes."""
    for unit in _units(cells):
        blocked = unit.blocked(cells)
        middles = (unit.lows + [cells.sides[n] / 2 for n in unit.items]) * cells.cell
        turns = tuple(cells.turns[n] for n in unit.items)
        for axes in permutations(range(3)):
            for shortest in _shortest(blocked.transpose(axes), unit.sides[list(axes)]):
                vectors = np.zeros((3, 3))
                vectors[:, axes] = shortest
                yield Lattice(turns, middles - middles[0], vectors * cells.cell, axes)


def _shortest(blocked: Mask, sides: Ints) -> Iterator[Ints]:
    """Yield shortest vectors (3, 3) along the axes, one after the other, that are free.

    Rows and layers are shifted as is best, or not at all, which loses less at the walls.
    """
    x, y, z = sides - 1  # the offset 0
    row = next(t for t in range(1, x + 2) if not blocked[x + t :: t, y, z].any())
    # Offsets along rows count modulo the row's vector.
    half = blocked[:, :, z:]
    before = -x % row
    padded = np.pad(half, ((before, -(before + len(half)) % row), (0, 0), (0, 0)))
    rows: Mask = np.logical_or.reduce(padded.reshape(-1, row, *half.shape[1:]))
    found = set()
    for shifts in (np.arange(row), np.zeros(1, np.int64)):
        shift, way = _across(rows[:, y:, 0], shifts)
        layers = np.zeros((row, way, rows.shape[2]), bool)
        for m in range(-(y // way) - 1, y // way + 1):
            low, high = max(0, y + m * way), min(rows.shape[1], y + (m + 1) * way)
            if low < high:
                own = np.roll(rows[:, low:high], -m * shift, axis=0)
                layers[:, low - y - m * way : high - y - m * way] |= own
        for sides_tried in ((row, way), (1, 1)):
            up = _upwards(layers, shift, *np.indices(sides_tried))
            found.add(((row, 0, 0), (shift, way, 0), up))
    yield from (np.array(vectors) for vectors in sorted(found))


def _across(rows: Mask, shifts: Ints) -> tuple[int, int]:
    """Return the shift and the shortest way from row to row."""
    length, span = rows.shape
    for way in range(1, span):
        free = np.ones(len(shifts), bool)
        for m in range(1, (span - 1) // way + 1):
            free &= ~rows[m * shifts % length, m * way]
        if free.any():
            return int(shifts[free.argmax()]), way
    return 0, span


def _upwards(layers: Mask, shift: int, x: Ints, y: Ints) -> tuple[int, int, int]:
    """Return the shifts, among x and y, and the shortest way from layer to layer."""
    length, width, span = layers.shape
    for way in range(1, span):
        free = np.ones(x.shape, bool)
        for m in range(1, (span - 1) // way + 1):
            rows = m * y // width
            free &= ~layers[(m * x - rows * shift) % length, m * y - rows * width, m * way]
            if not free.any():
                break
        if free.any():
            at = np.unravel_index(free.argmax(), free.shape)
            return int(x[at]), int(y[at]), way
    return 0, 0, span


def _narrowed(problem: Problem, lattice: Lattice, cell: float) -> Lattice:
    """Shorten the vectors as far as the surfaces allow; what is not free becomes longer."""
    is_free = _test(problem, lattice)
    vectors = lattice.vectors.copy()
    for n, axis in enumerate(lattice.axes):
        before = vectors[n, axis]
        for way in np.arange(before - REACH[0] * cell, before + REACH[1] * cell, STEP * cell):
            vectors[n, axis] = way
            if way > 0 and is_free(vectors[: n + 1]):
                break
        else:
            vectors[n, axis] = before
    return replace(lattice, vectors=vectors)


def _test(problem: Problem, lattice: Lattice) -> Callable[[Floats], bool]:
    """Return a function: whether a unit is free of those along the last of some vectors."""
    lookup = problem.lookup
    boxes = lookup.boxes[0, list(lattice.turns)]
    low = (lattice.places + boxes[:, :3]).min(axis=0) - lookup.clearance
    high = (lattice.places + boxes[:, 3:]).max(axis=0)
    state = state_of([0, 0], 2)

    def is_free(vectors: Floats) -> bool:
        for shift in _near(vectors, high - low, lattice.axes):
            for one, other in product(range(len(lattice.turns)), repeat=2):
                put(lookup, state, 0, lattice.turns[one], lattice.places[one])
                put(lookup, state, 1, lattice.turns[other], lattice.places[other] + shift)
                if count_conflicts(problem, state):
                    return False
        return True

    return is_free


def _near(vectors: Floats, reach: Floats, axes: Sequence[int]) -> Iterator[Floats]:
    """Yield the points of a lattice in a box about 0 that are above 0 along the last vector."""
    last = len(vectors) - 1
    along = vectors[last, axes[last]]
    for k in range(1, int(reach[axes[last]] / along) + 1):
        yield from _rest(vectors, reach, axes, last - 1, k * vectors[last])


def _rest(
    vectors: Floats, reach: Floats, axes: Sequence[int], n: int, point: Floats
) -> Iterator[Floats]:
    if n < 0:
        yield point
        return
    axis = axes[n]
    along = vectors[n, axis]
    least = int(np.ceil((-reach[axis] - point[axis]) / along))
    most = int(np.floor((reach[axis] - point[axis]) / along))
    for k in range(least, most + 1):
        yield from _rest(vectors, reach, axes, n - 1, point + k * vectors[n])


def _filled(lattice: Lattice, boxes: Floats, size: Floats, most: int) -> tuple[Ints, Floats]:
    """Return the rotations (n,) and places (n, 3) of a lattice's lowest items in a box."""
    own = boxes[list(lattice.turns)]
    starts = -own[:, :3] - lattice.places  # of the unit, for each item at the walls
    found: tuple[Ints, Floats] = np.zeros(0, np.int64), np.zeros((0, 3))
    for corner in product(*starts.T):
        turned, places = [], []
        for o, place, box in zip(lattice.turns, lattice.places, own, strict=True):
            points = _points(lattice, np.array(corner) + place, -box[:3], size - box[3:], most)
            turned.append(np.full(len(points), o))
            places.append(points)
        all_turned, all_places = np.concatenate(turned), np.concatenate(places)
        tops = all_places[:, 2] + boxes[all_turned, 5]
        kept = np.argsort(tops, kind="stable")[:most]
        if len(kept) > len(found[0]):
            found = all_turned[kept], all_places[kept]
    return found


def _points(lattice: Lattice, origin: Floats, low: Floats, high: Floats, most: int) -> Floats:
    """Return the points of a lattice through an origin that lie in a box."""
    first, second, third = lattice.axes
    (row,), (shift, way), (x, y, up) = (
        lattice.vectors[n, list(lattice.axes[: n + 1])] for n in range(3)
    )
    slack = 1e-9 * float(high[np.isfinite(high)].max())

    def steps(start: float, axis: int, along: float, limit: int) -> Ints:
        least = int(np.ceil((low[axis] - start - slack) / along))
        highest = min(high[axis], low[axis] + limit * along)
        return np.arange(least, int(np.floor((highest - start + slack) / along)) + 1)

    found = []
    for k in steps(origin[third], third, up, most):
        for j in steps(origin[second] + k * y, second, way, most):
            start = origin[first] + k * x + j * shift
            i = steps(start, first, row, most)
            own = np.empty((len(i), 3))
            own[:, first] = start + i * row
            own[:, second] = origin[second] + k * y + j * way
            own[:, third] = origin[third] + k * up
            found.append(own)
    return np.concatenate(found) if found else np.zeros((0, 3))
