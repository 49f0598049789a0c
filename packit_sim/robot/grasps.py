"""Places on an item where a suction cup holds it from above, found on the exact mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PosedItem, triangles
from packit_sim.geometry.rotations import MATRICES
from packit_sim.geometry.shapes import Item
from packit_sim.robot.cell import GRAVITY, TILTED_TOOL, TUBE, RobotCell
from packit_sim.robot.height_kernels import flat_discs, highest_in_disc, top_heights
from packit_sim.robot.presentation import turn_at_pick

GRASPS_BUDGET = 50_000
"""Cached answers about items in a rotation."""

MAX_TILT = 91.0
"""Largest angle between the tool of level 2 and the vertical, degrees: items need not lie exactly
on their sides."""

_ABOVE_TABLE = 0.003
"""Metres between a tilted cup and the table."""

_TILTS = 5
"""Tilts at which the weight's moment is bounded."""

_CANDIDATES = 50
"""Flat places that are looked at, the nearest first, for one without a tip between samples."""

_POINTS = 4
"""Points of the surface that are sampled along the radius of a cup."""


@dataclass(frozen=True)
class Grasp:
    """A place where a cup holds an item.

    Attributes
    ----------
    point : tuple of float
        The middle of the cup's face, from the centre of the item's bounding box, in box units.
    radius : float
        The radius of the cup, m.
    """

    point: tuple[float, float, float]
    radius: float


def best_grasp(item: Item, cell: RobotCell) -> Grasp | None:
    """Find where to hold an item in its rotation.

    Parameters
    ----------
    item : Item
        The item, in its rotation.
    cell : RobotCell
        The cell with the gripper.

    Returns
    -------
    Grasp or None
        The place nearest to the centre of mass, seen from above, of the largest cup that has one
        at all; None if no cup has.

    Notes
    -----
    The cup comes straight from above, and its tube is as slender as its rim. So it touches nothing
    where the item itself can come straight from above: what the cup meets on its way, the part of
    the item below it would meet too. A place is valid if every sample of the surface seen from
    above in the disc below the cup is within the compliance of a plane, if that plane is not
    tilted more than the gripper allows, if no tip between samples is higher than that, and if the
    weight's moment about the cup is less than the vacuum's about its rim, with the same safety as
    the payload. The cup's face is at the exact height of the highest point below it.

    At level 2 the same place holds the item where it is presented, in another rotation: the tool is
    tilted by at most `MAX_TILT` there, the cup is above the table, and no part of the item is so
    far above the cup's face that it could meet what carries the tool. The moment is bounded for all
    tilts in between.
    """
    side = item.turned(item.rotation - item.rotation % 4)
    at_level_1 = RobotCell(edge=cell.edge, density=cell.density, gripper=cell.gripper)
    found = _grasp_on_a_side(side, at_level_1 if cell.level == 1 else cell)
    if found is None:
        return None
    x, y, z = (MATRICES[item.rotation] @ MATRICES[side.rotation].T @ found.point).tolist()
    return Grasp((x, y, z), found.radius)


def grasp_off_the_grid(posed: PosedItem, cell: RobotCell) -> Grasp | None:
    """Find where to hold an item at a pose, in any rotation, as `best_grasp`."""
    center = posed.pose.direction(center_of_mass(posed.item.turned(0)))
    surface = triangles(posed) - posed.center
    turn = turn_at_pick(posed.item, posed.pose.rotation, cell)
    return _grasp(surface, center, posed.item.volume, cell, turn)


@bounded_cache(
    "grasps",
    GRASPS_BUDGET,
    "answers",
    size=lambda grasp: 1,
    key=lambda item, cell: (item.key, cell),
)
def _grasp_on_a_side(item: Item, cell: RobotCell) -> Grasp | None:
    surface = np.asarray(item.mesh.triangles, dtype=np.float64)
    turn = turn_at_pick(item, MATRICES[item.rotation], cell)
    return _grasp(surface, center_of_mass(item), item.volume, cell, turn)


def _grasp(
    surface: Floats,
    center: Floats,
    volume: float,
    cell: RobotCell,
    turn: Floats,
) -> Grasp | None:
    """Find a place on triangles (n, 3, 3), which `turn` rotates to where they are presented."""
    gripper = cell.gripper
    if turn[2, 2] < math.cos(math.radians(MAX_TILT)):
        return None
    low, high = surface.min(axis=(0, 1))[:2], surface.max(axis=(0, 1))[:2]
    weight = cell.mass(volume) * GRAVITY
    for radius in sorted(gripper.cups, reverse=True):
        if cell.mass(volume) > gripper.payload(radius):
            return None  # smaller ones lift less
        own = radius / cell.edge
        spacing = own / _POINTS
        if (high - low < 2 * own).any():
            continue
        nx, ny = (np.floor((high - low) / spacing).astype(int) + 1).tolist()
        heights = top_heights(surface, low, spacing, (nx, ny))
        points = np.argwhere(np.isfinite(heights))
        away = np.linalg.norm(low + points * spacing - center[:2], axis=1)
        arm = gripper.force(radius) * own / (gripper.safety * weight)
        near = np.argsort(away, kind="stable")
        if cell.level == 2:
            x, y = points.T
            places = np.column_stack((low + points * spacing, heights[x, y]))
            is_held = _is_held_while_turned(places, surface, center, arm, own, cell, turn)
            near = near[is_held[near]]
        near = near[away[near] <= arm]
        slope = math.tan(math.radians(gripper.tilt))
        soft = gripper.compliance / cell.edge
        found = flat_discs(heights, points[near], own, spacing, soft, slope, _CANDIDATES)
        for n in near[found].tolist():
            i, j = points[n].tolist()
            x, y = (low + points[n] * spacing).tolist()
            top = highest_in_disc(surface, x, y, own)
            if top - _highest_sample(heights, i, j, own, spacing) <= soft:
                return Grasp((x, y, top), radius)
    return None


def _is_held_while_turned(
    places: Floats,
    surface: Floats,
    center: Floats,
    arm: float,
    radius: float,
    cell: RobotCell,
    turn: Floats,
) -> npt.NDArray[np.bool_]:
    """Decide which places (n, 3) on a surface hold an item from where it is presented, too.

    arm: the longest arm of the weight. radius: of the cup, in box units.
    """
    up = turn[2]  # the vertical where it is presented
    sine = math.hypot(up[0], up[1])
    above_table = places @ up - (surface @ up).min() - radius * sine
    beyond = surface[..., 2].max() - places[:, 2]
    found = above_table * cell.edge > _ABOVE_TABLE
    found &= beyond * cell.edge < TILTED_TOOL - 2 * TUBE
    for tilt in np.linspace(0.0, math.atan2(sine, up[2]), _TILTS):
        vertical = np.append(up[:2] * (math.sin(tilt) / max(sine, 1e-12)), math.cos(tilt))
        found &= np.linalg.norm(np.cross(center - places, vertical), axis=1) <= arm
    return np.asarray(found)


def center_of_mass(item: Item) -> Floats:
    """Return the centre of mass of an item from the centre of its bounding box, (3,) box units."""
    mesh = item.mesh
    return np.asarray(mesh.center_mass if item.shape.is_solid else mesh.centroid)


def _highest_sample(heights: Floats, x: int, y: int, radius: float, spacing: float) -> float:
    """Return the largest height of the samples in a disc, and of those next to it."""
    reach = int(np.floor(radius / spacing + 1e-9)) + 1
    i, j = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    inside = (i**2 + j**2) * spacing**2 <= (radius + spacing) ** 2
    rows = np.clip(x + i, 0, heights.shape[0] - 1)
    columns = np.clip(y + j, 0, heights.shape[1] - 1)
    return float(heights[rows, columns][inside].max())
