"""Films of packing a box: each part comes in by straight moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from packit_sim.core.choices import Door
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.order import require_known_ways, ways_in
from packit_sim.parts.handling.removal import Route
from packit_sim.parts.handling.sweeps import AXES, OUT, sweeps_of
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.posed_parts import contents, outline_items
from packit_sim.parts.results.pictures import OUTLINE_COLOR
from packit_sim.render import films, video
from packit_sim.render.coloring import Colors, by_item
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import DEFAULT_LOOK, Look
from packit_sim.render.staging import corners

FPS = 20

SIZE = 720, 540
"""Pixels of a picture."""

_SIDE = 4.0
"""The box's longest side in box units."""

_SPEED = 5.0
"""Box units a second."""

_BEFORE = 0.4
"""Distance from the box at which parts begin, in box units."""

_REST = 1.5
"""Seconds after the last part."""


def film(packed: PackedParts, path: Path | str, box: int = 0) -> Path:
    """Film how the parts of a box are put in.

    Parameters
    ----------
    path : Path or str
        The file, .gif or .mp4.
    box : int
        The number of the box, from 0.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RenderError
        If the file can't be written.
    """
    return film_packing(path, packed.contents[box], packed.task.constraints)


def film_packing(
    path: Path | str, packing: Packing, constraints: Constraints | None = None
) -> Path:
    """Film how the parts of a box are put in, one after the other.

    Parameters
    ----------
    path : Path or str
        The file, .gif or .mp4.
    packing : Packing
        The parts in one box.
    constraints : Constraints, optional
        The constraints that the packing meets: the door through which parts come in and by which
        moves, the stops at which they are delivered, and which are fixed.

    Returns
    -------
    Path
        The file. A part for which no straight moves were found appears in its place.

    Raises
    ------
    ArgumentError
        If there is no part, or there are several boxes.
    RenderError
        If the file can't be written.
    """
    video.require(path)
    if len({placement.box for placement in packing.placements}) != 1:
        raise ArgumentError("a film is of the parts in one box")
    require_known_ways("films", packing.container.name, packing)
    met = constraints or Constraints()
    sweeps = sweeps_of(packing)
    order, routes = ways_in(sweeps, range(len(sweeps)), met)
    whole = contents(packing, order, _SIDE)
    scale = _SIDE / packing.container.longest
    lines = outline_items(packing, _SIDE)
    items = [*lines, *whole.placed]
    ways = [_way(item, None, scale) for item in lines]
    ways += [_way(item, routes.get(n), scale) for n, item in zip(order, whole.placed, strict=True)]
    first = len(lines) + len(met.fixed)
    look = Look(box="none", coloring=_with_lines) if lines else DEFAULT_LOOK
    frames = [(look, layout) for layout in _layouts(items, ways, first, met.door)]
    video.write(path, films.shot(BoxState(whole.cells, tuple(items)), frames, *SIZE), FPS)
    return Path(path)


def _with_lines(items: Sequence[Item]) -> Colors:
    """Give the container's lines, the first item, their own colour."""
    return Colors((OUTLINE_COLOR, *by_item(items[1:]).of))


def _way(item: PosedItem, route: Route | None, scale: float) -> Floats:
    """Return the places (n, 3) through which an item comes to its own, the last."""
    places = [item.pose.translation]
    if route is not None:
        for direction, length in route.moves:
            axis, sign = AXES[direction]
            places.append(places[-1] + np.eye(3)[axis] * sign * length * scale)
        axis, sign = AXES[route.out]
        places.append(places[-1] + np.eye(3)[axis] * sign * (_SIDE + _BEFORE))
    return np.array(places[::-1])


def _layouts(
    items: list[PosedItem], ways: list[Floats], first: int, door: Door
) -> Iterator[Layout]:
    """Yield where the items are in each frame; the first ones are there from the start."""
    vertices = np.concatenate([item.vertices for item in items])
    low, sides = vertices.min(axis=0), np.ptp(vertices, axis=0)
    axis, sign = AXES[OUT[door]]
    before = np.eye(3)[axis] * _BEFORE  # the space in which parts begin
    points = low - before * (sign < 0) + corners(sides + before)
    poses: list[Motion | None] = [item.pose if n < first else None for n, item in enumerate(items)]
    for n, way in enumerate(ways[first:], start=first):
        lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
        reached = np.r_[0, np.cumsum(lengths)]
        count = int(np.ceil(reached[-1] / _SPEED * FPS))
        for k in range(1, count + 1):
            there = np.sin(k / count * np.pi / 2) * reached[-1]
            place = np.array([np.interp(there, reached, way[:, axis]) for axis in range(3)])
            poses[n] = items[n].pose.at(place)
            yield Layout(tuple(poses), points)
        poses[n] = items[n].pose
    for _ in range(round(_REST * FPS)):
        yield Layout(tuple(poses), points)
