"""Conflicts of surfaces: meshes that cross, and parts of one inside the other (`containment`).

FCL decides whether meshes cross, unless there is a proof (`crossing_kernels`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.core.counters import count_mesh_comparisons
from packit_sim.engine.collision_meshes import collision_mesh
from packit_sim.engine.containment import nested, nested_oracle
from packit_sim.engine.crossing_kernels import APART, CROSSING, UNSURE
from packit_sim.engine.pair_kernels import relations
from packit_sim.engine.pairs import (
    Pair,
    canonical,
    canonical_offsets,
    relative_turn,
    shifts_at,
)
from packit_sim.geometry.items import ItemInBox, PlacedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item

COLLISIONS_BUDGET = 100_000
"""Cached answers about pairs of items on the grid, roughly 0.4 kB each."""

OFF_GRID_COLLISIONS_BUDGET = 100_000
"""Cached answers about items off the grid."""


def collides(placed: ItemInBox, other: ItemInBox) -> bool:
    """Decide by FCL whether the collision meshes of two items cross.

    Parameters
    ----------
    placed : ItemInBox
        An item on the grid or off it.
    other : ItemInBox
        Another one.

    Returns
    -------
    bool
        Whether a triangle of one mesh crosses a triangle of the other.

    Notes
    -----
    For two items on the grid the answer depends only on the items and the whole half cells between
    their centres: the first in a fixed order of items is put at the origin, independently of their
    places in the box and of which was placed first. The pose of an item off the grid is taken
    relative to the centre of the one on the grid; of two off the grid, in the frame of the first.
    """
    pair = Pair.of(placed, other)
    return collision_mesh(pair.item).crosses(collision_mesh(pair.other), pair)


def contains(placed: ItemInBox, other: ItemInBox) -> bool:
    """Decide by a plain loop whether a part of one collision mesh is inside the other.

    Parameters
    ----------
    placed : ItemInBox
        An item on the grid or off it.
    other : ItemInBox
        Another one. The meshes don't cross.

    Returns
    -------
    bool
        Whether a connected part of one mesh is inside a closed part of the other.
    """
    pair = Pair.of(placed, other)
    one, other_mesh = collision_mesh(pair.item), collision_mesh(pair.other)
    turn, other_turn = pair.turn, pair.other_turn
    return nested_oracle(
        other_mesh.parts.points, one.closed_parts, turn, other_turn, pair.shift
    ) or nested_oracle(one.parts.points, other_mesh.closed_parts, other_turn, turn, -pair.shift)


def surfaces_conflict(placed: PlacedItem, other: ItemInBox) -> bool:
    """Return whether `collides` or `contains` holds, from the cache if possible."""
    if isinstance(other, PlacedItem):
        return _on_grid_memo(*canonical(placed, other))
    return _off_grid_memo(placed, other)


def surfaces_conflicts(
    item: Item, locations: npt.NDArray[np.int64], other: ItemInBox
) -> npt.NDArray[np.bool_]:
    """Decide the same for an item at many locations, without the cache.

    Parameters
    ----------
    item : Item
        The item, in its rotation.
    locations : ndarray of int64, shape (n, 3)
        Its locations.
    other : ItemInBox
        An item on the grid or off it.

    Returns
    -------
    ndarray of bool, shape (n,)
        Whether the surfaces are in conflict.
    """
    if not isinstance(other, PlacedItem):
        at = ((i, j, k) for i, j, k in locations.tolist())
        return np.array([_off_grid_memo(PlacedItem(item, location), other) for location in at])
    return conflicts_at(*canonical_offsets(item, locations, other))


def conflicts_at(a: Item, b: Item, offsets: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Decide by a proof where there is one, otherwise by FCL: bool (n,) for offsets (n, 3)."""
    count_mesh_comparisons(len(offsets))
    shifts = shifts_at(a, b, offsets)
    mesh, other = collision_mesh(a), collision_mesh(b)
    states = relations(
        mesh.compared(a.rotation),
        other.compared(b.rotation),
        *relative_turn(a.rotation, b.rotation),
        shifts,
        (a.cells, a.voxels.fixed_arrays),
        b.voxels.arrays,
        offsets,
    )
    for n in np.flatnonzero(states == UNSURE).tolist():
        states[n] = CROSSING if _conflict(Pair(a, b, shifts[n], None)) else APART
    return np.asarray(states == CROSSING)


def _conflict(pair: Pair) -> bool:
    mesh, other = collision_mesh(pair.item), collision_mesh(pair.other)
    return mesh.crosses(other, pair) or nested(
        mesh.parts, other.parts, pair.turn, pair.other_turn, pair.shift
    )


@bounded_cache(
    "collisions",
    COLLISIONS_BUDGET,
    "answers",
    size=lambda answer: 1,
    key=lambda a, b, offset: (a.key, b.key, offset),
)
def _on_grid_memo(a: Item, b: Item, offset: Triple) -> bool:
    return bool(conflicts_at(a, b, np.array([offset]))[0])


@bounded_cache(
    "collisions off the grid",
    OFF_GRID_COLLISIONS_BUDGET,
    "answers",
    size=lambda answer: 1,
    key=lambda placed, other: (
        placed.item.key,
        placed.location,
        other.item.key,
        other.matrix.tobytes(),
    ),
)
def _off_grid_memo(placed: PlacedItem, other: ItemInBox) -> bool:
    count_mesh_comparisons(1)
    return _conflict(Pair.of(placed, other))
