"""The balance of a box: where the centre of gravity of its parts is, and where it has to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.nesting.balance import Balance, excess
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.limits import Limits

_ROUNDING = 1e-6
"""Share of the largest distance from the middle that is kept free for rounding in a search."""


def off_middle(task: PackTask, packing: Packing) -> Floats:
    """Return where the centre of gravity of the parts in a box is, without the fixed ones.

    Returns
    -------
    ndarray of float64, shape (2,)
        The way along x and y from the middle of the container's bounding box, in shares of the
        sides of that; 0 if nothing is in the box.
    """
    if not packing.placements:
        return np.zeros(2)
    weights, centres = _centres(task, packing)
    return np.asarray(np.average(centres, axis=0, weights=weights))


def over_balance(task: PackTask, packing: Packing) -> dict[int, str]:
    """Return the parts to leave out of a box so that it keeps its balance, with the reason."""
    limits = task.limits(packing)
    if limits.balance is None or not limits.beyond((off := off_middle(task, packing)).tolist()):
        return {}
    weights, centres = _centres(task, packing)
    values = np.array([task.weights[one.type] for one in packing.placements])
    goes: Ints = excess(weights, centres, values, np.full(2, limits.balance))
    return dict.fromkeys(goes.tolist(), balance_fault(limits, off))


def balance_fault(limits: Limits, off: Floats) -> str:
    """Return how a centre of gravity breaks the balance of a box; empty if it does not."""
    if limits.balance is None or not limits.beyond(off.tolist()):
        return ""
    x, y = (np.abs(off) * 100).tolist()
    return (
        f"the centre of gravity is {x:.4g}% and {y:.4g}% of the sides off the middle: at most "
        f"{100 * limits.balance:.4g}%"
    )


def nest_balance(
    task: PackTask, limits: Limits, numbers: Sequence[int], inner: Container | Sequence[Container]
) -> Balance | None:
    """Return the balance of a box, if it has one, for a search inside the margin of its walls."""
    if limits.balance is None:
        return None
    assert isinstance(inner, Container)  # boxes with limits are filled one by one
    margin = task.search_margin
    sides = (np.array(inner.size) + margin.lower + margin.upper)[:2]
    x, y = (limits.balance * (1 - _ROUNDING) * sides).tolist()
    parts = [task.parts[n] for n in numbers]
    return Balance(
        [task.gravities[n] for n in numbers], [each.centre.tolist() for each in parts], (x, y)
    )


def centred(task: PackTask, packing: Packing) -> Packing:
    """Move all parts in a box without obstacles together, until they keep its balance.

    They stay as far from the walls as they are, at the nearer one.
    """
    balance = task.limits(packing).balance
    if balance is None or not packing.placements:
        return packing
    sides = np.array(packing.container.size)[:2]
    off = off_middle(task, packing) * sides
    lows = [packing.vertices(one)[:, :2].min(axis=0) for one in packing.placements]
    highs = [packing.vertices(one)[:, :2].max(axis=0) for one in packing.placements]
    low, high = np.min(lows, axis=0), sides - np.max(highs, axis=0)
    least = np.minimum(low, high)
    wanted = -np.sign(off) * np.maximum(np.abs(off) - balance * (1 - _ROUNDING) * sides, 0)
    x, y = np.clip(wanted, np.minimum(least - low, 0), np.maximum(high - least, 0)).tolist()
    moved = [
        replace(one, pose=Motion.shift(np.array((x, y, 0.0))) @ one.pose)
        for one in packing.placements
    ]
    return replace(packing, placements=tuple(moved))


def _centres(task: PackTask, packing: Packing) -> tuple[Floats, Floats]:
    """Return the weight of each part (n,), and its centre (n, 2) from the middle, in sides."""
    sides = np.array(packing.container.size)[:2]
    weights = np.array([task.gravities[one.type] for one in packing.placements])
    centres = [one.pose.apply(task.parts[one.type].centre)[:2] for one in packing.placements]
    return weights, np.array(centres) / sides - 0.5
