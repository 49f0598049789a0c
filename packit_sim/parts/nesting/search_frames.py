"""Frames of the search: the mesh's own, or its smallest bounding box's for free rotations."""

from __future__ import annotations

from threading import RLock
from weakref import WeakKeyDictionary

import numpy as np
import trimesh
from cachetools import cached

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import split
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.rotation_sets import FREE, matrices
from packit_sim.parts.packings.turning import ANY_TURN

SMALLER = 0.999
"""Share of the volume of a mesh's bounding box, below which another box is worth a rotation."""

FLATTEST = 1e-5
"""Smallest to largest standard deviation of vertices along an axis, so that a turned mesh is not
flat."""


def search_frame(item_type: ItemType) -> Floats:
    """Return the rotation from the mesh's frame to that of the search.

    For free rotations, the axes of the frame are parallel to the sides of the mesh's smallest
    bounding box, if that is smaller than the one in the mesh's own frame.

    Returns
    -------
    ndarray of float64, shape (3, 3)
        The rotation; the identity unless rotations are free.
    """
    return np.eye(3) if item_type.rotations != FREE else _framed(item_type)[0]


def in_search_frame(item_type: ItemType) -> ItemType:
    """Return an item type in the frame of the search.

    Returns
    -------
    ItemType
        The type itself, or that of the turned mesh, with the rotations `cube` or a list.
    """
    return item_type if item_type.rotations != FREE else _framed(item_type)[1]


def searched_rotations(item_type: ItemType) -> Floats:
    """Return the rotations that are searched, from the mesh's own frame.

    Returns
    -------
    ndarray of float64, shape (n, 3, 3)
        Its own list, or the rotations of its set that it may take; for `free`, the 24 of `cube`
        after that to the search's frame, and with limits on turning also the 24 alone.
    """
    return _searched(item_type, search_frame(item_type))


def _searched(item_type: ItemType, frame: Floats) -> Floats:
    if item_type.turns is not None:
        return item_type.turns
    if item_type.rotations != FREE:
        found = matrices(item_type.rotations)
    elif item_type.turning == ANY_TURN:
        found = matrices("cube") @ frame
    else:
        found = np.concatenate((matrices("cube"), matrices("cube") @ frame))
    return found[item_type.turning.allows(found)]


@cached(WeakKeyDictionary(), key=lambda item_type: item_type, lock=RLock())
def _framed(item_type: ItemType) -> tuple[Floats, ItemType]:
    """Return the frame and the turned type; they are forgotten with the type."""
    turn = _to_smallest_box(item_type)
    is_any = item_type.turns is None and item_type.turning == ANY_TURN
    turns = None if is_any else _searched(item_type, turn) @ turn.T
    if np.array_equal(turn, np.eye(3)):
        return turn, item_type.changed(rotations="cube", turning=ANY_TURN, turns=turns)
    turned = ItemType(
        item_type.name,
        item_type.vertices @ turn.T,
        item_type.faces,
        item_type.demand,
        "cube",
        item_type.value,
        known_volume=item_type.volume,
        clearance=item_type.clearance,
        turns=turns,
    )
    return turn, turned


def _to_smallest_box(item_type: ItemType) -> Floats:
    vertices = item_type.vertices
    deviations = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if deviations[-1] < FLATTEST * deviations[0]:
        return np.eye(3)
    unit = 2.0 ** np.floor(np.log2(item_type.extents.max()))  # trimesh has absolute tolerances
    to_box, sides = trimesh.bounds.oriented_bounds(vertices / unit)
    if sides.prod() > SMALLER * (item_type.extents / unit).prod():
        return np.eye(3)
    left, _, right = np.linalg.svd(split(to_box)[0])
    return np.asarray(left @ right)
