"""The largest scale at which one part fits into a container."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from packit_sim.core.caches import cached_property
from packit_sim.core.checks import as_integer, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.core.length_units import Unit
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.convex_fits import ConvexSpace, convex_space, corners_of
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.filling.task_checks import check_margin
from packit_sim.parts.nesting.nest import NestingError, NestSettings, nest
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.bounds import SECONDS, SEEDS
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.containers import BoxContainer, Container
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import FREE, matrices
from packit_sim.parts.reading.boxes import BoxType, box_types, box_unit
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.reading.mesh_boxes import with_meshes
from packit_sim.parts.reading.named_containers import without_names
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import prepare

RANDOM = 60
"""Random rotations to begin with."""

ACCURACY = 0.002
"""Relative difference of two scales at which the search in a container that is not convex ends."""

PASSES = 20
"""Passes of the search for a place at one scale."""

_LEAST = 1e-3
"""Scale, relative to the largest that is possible, below which nothing is tried."""

_STEP = 0.9
"""Factor of scales until a place is found."""

_SHRINKAGE = 1e-6
"""Share by which a scale is made smaller while the exact check refuses it, doubled each time."""


@dataclass(frozen=True, eq=False)
class FittedPart:
    """A part at the largest scale at which it fits.

    Attributes
    ----------
    part : Part
        The part.
    scale : float
        The scale, relative to its size.
    packing : Packing
        The part at that scale in its container, which is valid.
    unit : str
        The unit of lengths.

    Examples
    --------
    >>> from trimesh import creation
    >>> from packit_sim import Part, fit
    >>> fitted = fit(Part("brick", creation.box((40, 20, 10)), rotations="fixed"), "80x80x80mm")
    >>> [round(side, 2) for side in fitted.size]
    [80.0, 40.0, 20.0]
    """

    part: Part
    scale: float
    packing: Packing
    unit: Unit

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of the scaled part's bounding box, in its own orientation."""
        x, y, z = (self.packing.types[0].extents * self.scale).tolist()
        return x, y, z


def fit(
    part: Part | Path | str,
    container: str | BoxType | Container,
    time: float = 20.0,
    seed: int = 0,
    settings: PackSettings | None = None,
) -> FittedPart:
    """Find the largest scale at which one part fits into a container.

    Parameters
    ----------
    part : Part, Path or str
        The part, or its file; only its rotations count, not its number. `free` is any rotation.
    container : str, BoxType or Container
        The container, as `pack` takes it.
    time : float
        Seconds, at most.
    settings : PackSettings, optional
        The wall clearance, the unit, and how files are read.

    Returns
    -------
    FittedPart
        The part at the scale. It is valid by the meshes; that no larger scale is possible is not
        proven.

    Raises
    ------
    ArgumentError
        If an argument is not possible, the file has several parts, or no place is found.
    MeshError
        If the mesh can't be used.

    Notes
    -----
    In a convex container, each rotation has its largest scale by linear programming, and small
    turns improve the best of many. In others, a place is searched for at one scale after the other,
    in the rotations of the set; `free` then stands for the 24 of `cube`.

    Examples
    --------
    >>> from trimesh import creation
    >>> from packit_sim import Part, fit
    >>> ball = Part("ball", creation.icosphere(radius=10))
    >>> round(fit(ball, "cylinder:40x30mm").scale, 3)
    1.5
    """
    end = clock.perf_counter() + time
    check_range("time", time, SECONDS)
    check_range("seed", as_integer("seed", seed), SEEDS)
    settings = settings or PackSettings()
    box, _ = without_names(container)
    unit: Unit = settings.unit or box_unit(box) or "mm"
    box, _ = with_meshes(box, unit, settings.reading, 1)
    boxes = box_types(box, unit, 1)
    if len(boxes) > 1:
        raise ArgumentError(f"one container is needed, not {len(boxes)}")
    walls = WallClearance.of(settings.wall_clearance)
    check_margin(walls, boxes, unit)
    own = part if isinstance(part, Part) else _read(part, settings)
    item_type = prepare(own, unit, 0.0).item_type.changed(demand=1)
    search = _Search(item_type, boxes[0].container, walls, end, seed)
    packing = search.run()
    return FittedPart(own, packing.placements[0].scale, packing, unit)


def _read(file: Path | str, settings: PackSettings) -> Part:
    found = find_parts([file], settings.reading)
    if found.unread:
        raise ArgumentError(f"{found.unread[0].source}: {found.unread[0].reason}")
    if len(found.parts) > 1:
        names = ", ".join(each.name for each in found.parts[:9])
        raise ArgumentError(f"{file} has {len(found.parts)} parts ({names}): one is needed")
    return found.parts[0]


class _Search:
    """The search for the largest scale."""

    def __init__(
        self,
        item_type: ItemType,
        container: Container,
        walls: WallClearance,
        end: float,
        seed: int,
    ) -> None:
        self._type, self._container, self._walls = item_type, container, walls
        self._end, self._seed = end, seed

    def run(self) -> Packing:
        """Search until the time is over, or the largest scale is known."""
        space = convex_space(self._container, self._walls)
        found = self._in_convex(space) if space else self._in_any()
        if found is None:
            raise ArgumentError(
                f"no place for {self._type.name!r} was found in {self._container.name!r} at any "
                "scale: allow more time"
            )
        return Packing((self._type,), self._container, (found,), objective="knapsack")

    @cached_property
    def _turns(self) -> Floats:
        """The rotations (n, 3, 3) of its set; for free ones, those of its own and smallest box."""
        found = searched_rotations(self._type)
        return np.concatenate((matrices("cube"), found)) if self._type.rotations == FREE else found

    def _is_over(self) -> bool:
        return clock.perf_counter() > self._end

    def _in_convex(self, space: ConvexSpace) -> Placement | None:
        corners = corners_of(self._type.vertices - self._type.middle)
        if self._type.rotations == FREE:
            best = space.best(corners, self._rotations(), self._is_over)
        else:
            turns = self._turns
            best = max((space.largest(corners, turn) for turn in turns), key=lambda b: b.scale)
        scale, shrinkage = best.scale, _SHRINKAGE
        while scale > _LEAST * best.scale:
            middle = Motion(best.rotation).direction(self._type.middle) * scale
            placement = Placement(0, Motion(best.rotation, best.place - middle), 0, scale)
            if self._is_valid(placement):
                return placement
            scale, shrinkage = scale * (1 - shrinkage), 2 * shrinkage
        return None

    def _rotations(self) -> Iterator[Floats]:
        """Yield rotations to begin with: those of its set, and random ones."""
        yield from self._turns
        yield from Rotation.random(RANDOM, np.random.default_rng(self._seed)).as_matrix()

    def _is_valid(self, placement: Placement) -> bool:
        item = CheckedItem(self._type.name, self._type, placement, self._container.longest)
        slack = 1e-9 * self._container.longest if self._walls.largest else None
        return not any(True for _ in self._container.faults(item, self._walls, slack))

    def _in_any(self) -> Placement | None:
        """Search for a place at one scale after the other, between a free and a blocked one."""
        inner = self._inner()
        vertices = self._type.vertices
        sides = np.array([np.ptp(vertices @ turn.T, axis=0) for turn in self._turns])
        high = float((np.array(inner.size) / sides).min(axis=1).max())
        high = min(high, (self._container.volume / self._type.volume) ** (1 / 3))
        scale, low, blocked, best = high, 0.0, math.inf, None
        while scale > _LEAST * high:
            found = self._aligned(scale) or self._placed(scale, inner)
            if found is None:
                blocked = scale
            else:
                best, low = found, scale
            is_known = blocked == math.inf or blocked < low * (1 + ACCURACY)
            if best and (is_known or self._is_over()):
                break
            scale = math.sqrt(low * blocked) if best else blocked * _STEP
        return best

    def _inner(self) -> BoxContainer:
        """Return the bounding box inside the walls, with bodies around the container in it."""
        low, high = self._walls.lower, self._walls.upper
        walls = self._container.walls()
        bodies = [replace(w, vertices=w.vertices - low, known_volume=w.volume) for w in walls]
        x, y, z = (np.array(self._container.size) - low - high).tolist()
        return BoxContainer((x, y, z), tuple(bodies))

    def _aligned(self, scale: float) -> Placement | None:
        """Return a place at the middle, the low or the high end along each axis, if one is valid.

        Where a part fits closely on all sides, the search would find it only by chance.
        """
        low, high = self._walls.lower, np.array(self._container.size) - self._walls.upper
        for turn in self._turns:
            vertices = self._type.vertices @ turn.T * scale
            least, most = low - vertices.min(axis=0), high - vertices.max(axis=0)
            if (least > most + 1e-9 * self._container.longest).any():
                continue
            for place in product(*np.array(((least + most) / 2, least, most)).T):
                placement = Placement(0, Motion(turn, np.array(place)), 0, scale)
                if self._is_valid(placement):
                    return placement
        return None

    def _placed(self, scale: float, inner: BoxContainer) -> Placement | None:
        """Search for a place at one scale."""
        own = self._type
        vertices, volume = own.vertices * scale, own.volume * scale**3
        kind = (1, "cube" if own.rotations == FREE else own.rotations, None, None, volume)
        scaled = ItemType(own.name, vertices, own.faces, *kind)
        settings = NestSettings(workers=1, iterations=PASSES)
        try:
            found = nest(
                [scaled],
                inner,
                "knapsack",
                seed=self._seed,
                clearance=self._walls.largest,  # from the bodies around the container
                settings=settings,
            )
        except (NestingError, ArgumentError):  # the clearance is too large for so small a part
            return None
        for one in found.placements:
            pose = one.pose.shifted(self._walls.lower)
            placement = Placement(0, pose, 0, scale)
            return placement if self._is_valid(placement) else None
        return None
