"""The validity of packings off the grid, by the meshes themselves.

The check is independent of every search. It decides about original meshes at their poses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.checked_meshes import CheckedMesh
from packit_sim.parts.packings.containers import Container

MAX_PROBLEMS = 1000
"""The check ends after so many problems: n items at one place have n² / 2."""


def outside(item: CheckedItem, container: Container) -> Iterator[str]:
    """Yield a sentence for each wall that an item reaches beyond by more than its tolerance."""
    for fault in container.faults(item):
        yield f"{item.name} {fault}"


def pair_problems(
    one: CheckedItem,
    other: CheckedItem,
    clearance: float = 0.0,
    slack: float | None = None,
    stretch: float = 1.0,
) -> Iterator[str]:
    """Yield a sentence for each problem of two items.

    Parameters
    ----------
    one : CheckedItem
        An item.
    other : CheckedItem
        Another, in the same container.
    clearance : float
        The smallest distance that their surfaces may have, unless one of their own is larger.
    slack : float, optional
        How much smaller it may be; by default the tolerance of the pair.
    stretch : float
        By what lengths along z are multiplied before the distance is measured.

    Yields
    ------
    str
        That they cross; or that one lies inside the other; or that they are too close.

    Notes
    -----
    Meshes cross if their triangles do when both are drawn in by half the tolerance a side. A part
    lies inside a shell of the other item, which is closed after filling the holes that the importer
    would fill, also if it is in a cavity. Most real meshes are not closed: nothing may be in a
    voxel that the other item encloses either, of 1/200 of its longest side. The tolerance of a pair
    is the smaller one of the two.
    """
    clearance = max(clearance, one.clearance, other.clearance)
    gaps = np.maximum(one.low, other.low) - np.minimum(one.high, other.high)
    gaps *= (1, 1, stretch)
    overlap = bool((gaps < 0).all())
    if not overlap and np.linalg.norm(np.maximum(gaps, 0)) >= clearance:
        return
    smaller = min(one.tolerance, other.tolerance)
    unit = smaller / CONTACT_TOLERANCE
    mesh = CheckedMesh(one.item_type, one.scale, unit, smaller)
    other_mesh = CheckedMesh(other.item_type, other.scale, unit, smaller)
    turn, shift = other.seen_from(one, unit)
    if overlap:
        if mesh.crosses(other_mesh, turn, shift):
            yield f"{other.name} crosses {one.name}"
            return
        inside = mesh.holds(other_mesh, turn, shift)
        if inside:
            yield f"{other.name} lies, in part or whole, inside {one.name}"
        around = other_mesh.holds(mesh, *one.seen_from(other, unit))
        if around:
            yield f"{one.name} lies, in part or whole, inside {other.name}"
        if inside or around:
            return
    if clearance > 0:
        if stretch == 1:
            distance = mesh.distance(other_mesh, turn, shift)
        else:
            distance = one.stretched_distance(other, stretch)
        if not distance >= clearance - (smaller if slack is None else slack):
            yield (
                f"{other.name} is {other.length(max(distance, 0.0))} from {one.name}: "
                f"less than the clearance of {other.length(clearance)}"
            )


def problems(
    items: Iterable[CheckedItem],
    container: Container,
    clearance: float = 0.0,
    obstacles: Sequence[CheckedItem] = (),
    stretch: float = 1.0,
) -> list[str]:
    """Check placed items.

    Parameters
    ----------
    clearance : float
        The smallest distance that the surfaces of two items may have.
    obstacles : sequence of CheckedItem
        What is in each container, and may itself be anywhere.
    stretch : float
        By what lengths along z are multiplied before distances are measured.

    Returns
    -------
    list of str
        A sentence for each problem, and after `MAX_PROBLEMS` one that there may be more; empty if
        the packing is valid.
    """
    every = _problems(list(items), container, clearance, obstacles, stretch)
    found = list(islice(every, MAX_PROBLEMS))
    if len(found) == MAX_PROBLEMS:
        found.append(f"there may be more: the check ended after {MAX_PROBLEMS} problems")
    return found


def _problems(
    items: Sequence[CheckedItem],
    container: Container,
    clearance: float,
    obstacles: Sequence[CheckedItem],
    stretch: float,
) -> Iterator[str]:
    for item in items:
        yield from outside(item, container)
    low = np.array([item.low for item in items]).reshape(-1, 3)
    high = np.array([item.high for item in items]).reshape(-1, 3)
    boxes = np.array([item.box for item in items])
    largest = max((clearance, *(item.clearance for item in items)))
    upwards = np.lexsort((low[:, 2], boxes))  # neighbours follow each other: few meshes are in use
    for at, n in enumerate(upwards.tolist()):
        rest = upwards[at + 1 :]
        gaps = np.maximum(low[n], low[rest]) - np.minimum(high[n], high[rest])
        near = (gaps * (1, 1, stretch) <= largest).all(axis=1) & (boxes[rest] == boxes[n])
        for m in rest[near].tolist():
            one, other = items[min(n, m)], items[max(n, m)]
            yield from pair_problems(one, other, clearance, stretch=stretch)
    for obstacle in obstacles:
        for item in items:
            yield from pair_problems(obstacle, item, clearance, stretch=stretch)
