"""Layouts of items in pictures: in their places, moved apart, or next to the box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import ItemInBox, PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item

ITEM_GAP = 0.06
"""Gap in box units between neighbouring items, and between them and the box."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The poses in which the items of a box are shown.

    Attributes
    ----------
    poses : tuple[Motion or None, ...]
        One for each item, in order of placing; None hides the item.
    points : ndarray of float64, shape (n, 3)
        Points that a picture contains in addition to the box, in box units.

    Examples
    --------
    >>> from packit_sim import Layout, load_tasks
    >>> layout = Layout.standing(load_tasks("starter")[0].items)  # in rows on the floor
    >>> len(layout.poses)
    35
    >>> layout.poses[0].translation.round(2).tolist()
    [1.3, 1.06, 0.02]
    """

    poses: tuple[Motion | None, ...]
    points: Floats

    @classmethod
    def packed(cls, placed: Sequence[ItemInBox], size: Floats, explode: float = 0.0) -> Layout:
        """Show each item in its place, or farther from the middle of the floor.

        Parameters
        ----------
        size : Floats
            Extents (3,) of the box in box units.
        explode : float
            The additional distance, as a share of the distance.

        Returns
        -------
        Layout
            Poses of the items in order.
        """
        middle = size * (0.5, 0.5, 0.0)
        poses = [p.pose for p in placed]
        moved = [p.shifted(explode * (p.translation - middle)) for p in poses]
        return cls(tuple(moved), _corners([p.item for p in placed], moved))

    @classmethod
    def settled(cls, items: Sequence[ItemInBox]) -> Layout:
        """Show items in the poses in which they came to rest."""
        points = [np.empty((0, 3)), *(item.vertices for item in items)]
        return cls(tuple(item.pose for item in items), np.concatenate(points))

    @classmethod
    def standing(cls, items: Sequence[Item], size: Floats | None = None) -> Layout:
        """Show items in canonical orientation on the floor, in rows, the tallest at the back.

        Parameters
        ----------
        size : Floats | None
            Extents (3,) of a box next to them, on the left of its usual picture; by
            default there is none.

        Returns
        -------
        Layout
            Poses of the items in order.
        """
        upright = [item.turned(0) for item in items]
        centers = _rows(np.array([item.extents for item in upright]).reshape(-1, 3), size)
        poses = [Motion.shift(center) for center in centers]
        return cls(tuple(poses), _corners(upright, poses))

    def posed(self, items: Sequence[Item]) -> tuple[PosedItem, ...]:
        """Put items where this layout shows them; it must hide none."""
        poses = [pose for pose in self.poses if pose is not None]
        return tuple(PosedItem.at(item, pose) for item, pose in zip(items, poses, strict=True))

    def all_round(self, size: Floats) -> Layout:
        """Extend `points` so that a camera that circles a box of extents (3,) keeps all in view."""
        points = np.concatenate((self.points, np.indices((2, 2, 2)).reshape(3, 8).T * size))
        middle = size[:2] / 2
        radius = float(np.linalg.norm(points[:, :2] - middle, axis=1).max())
        angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
        ring = middle + radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)
        heights = points[:, 2].min(), points[:, 2].max()
        rings = [np.column_stack((ring, np.full(len(ring), height))) for height in heights]
        return replace(self, points=np.concatenate(rings))


def _rows(extents: Floats, size: Floats | None) -> list[Floats]:
    """Compute centres (3,) of boxes with extents (n, 3), in rows along x from back to front."""
    x, middle = (0.0, 0.0) if size is None else (float(size[0]) + 2 * ITEM_GAP, float(size[1]) / 2)
    area = float(np.prod(extents[:, :2] + ITEM_GAP, axis=1).sum())
    length = max(1.3 * np.sqrt(area), extents[:, 0].max(initial=0.0))
    rows: list[list[int]] = []
    used = np.inf
    for n in np.argsort(-extents[:, 2], kind="stable").tolist():
        if used + extents[n, 0] > length:
            rows.append([])
            used = 0.0
        rows[-1].append(n)
        used += extents[n, 0] + ITEM_GAP
    depths = [max(extents[n, 1] for n in row) for row in rows]
    y = middle - (sum(depths) + ITEM_GAP * (len(rows) - 1)) / 2
    centers = [np.zeros(3)] * len(extents)
    for row, deep in zip(rows, depths, strict=True):
        at = x
        for n in row:
            centers[n] = np.array((at + extents[n, 0] / 2, y + deep / 2, extents[n, 2] / 2))
            at += extents[n, 0] + ITEM_GAP
        y += deep + ITEM_GAP
    return centers


def _corners(items: Sequence[Item], poses: Sequence[Motion]) -> Floats:
    """Compute the corners (8n, 3) of items' bounding boxes, rotated with them."""
    signs = np.indices((2, 2, 2)).reshape(3, 8).T - 0.5
    boxes = [
        pose.apply(signs * item.turned(0).extents) for item, pose in zip(items, poses, strict=True)
    ]
    return np.concatenate([np.empty((0, 3)), *boxes])
