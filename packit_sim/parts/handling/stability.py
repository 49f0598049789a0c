"""Stability: the motion of parts under gravity at each stage of packing."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.core.checks import POSITIVE, check_range
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts.handling.supports import stacking_of
from packit_sim.parts.handling.sweeps import PartSweeps, sweeps_of
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.posed_parts import posed
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import fitted_items
from packit_sim.physics.world import World

PHYSICS = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))
"""The simulated world by default. Parts are new in each packing: bisection takes less than a second
for one, and stages move much as with CoACD's pieces, which take many seconds."""

LEAST_MASS = 1e-6
"""Smallest mass of a part in a simulation, in kg: without a mass it would be fixed."""


@dataclass(frozen=True)
class StageMotion:
    """The largest motion of a part of a packing.

    Attributes
    ----------
    part : int
        The number of its placement.
    distance : float
        The largest distance that a point of it moves in any stage, in the container's unit.
    stage : int
        The number of parts that are in its box at that stage; 0 if it never moves.
    """

    part: int
    distance: float
    stage: int


def stage_motions(
    packing: Packing,
    order: Sequence[int],
    masses: Sequence[float],
    metres: float = 0.001,
    settings: PhysicsSettings | None = None,
) -> tuple[StageMotion, ...]:
    """Simulate each stage of packing under gravity.

    Parameters
    ----------
    order : sequence of int
        The numbers of the placements in the order of packing; others are left out.
    masses : sequence of float
        The mass of each placement of the packing, in kg.
    metres : float, default: 0.001
        The container's unit of length, in metres.
    settings : PhysicsSettings, optional
        The simulated world, by default `PHYSICS`; its side and density are not used.

    Returns
    -------
    tuple of StageMotion
        The motion of each part, box after box, in the order of packing.

    Raises
    ------
    ArgumentError
        If `metres` is not above 0.
    MissingPackageError
        If PyBullet is missing, or CoACD if the settings choose it.
    PhysicsError
        If a part can't be decomposed into convex pieces.

    Notes
    -----
    Parts start where they are after all of them moved straight down (see `stacking`), for a hand
    puts them there and not into the air. In the stage of k parts, the first k of the order are
    released at once, without speed. Parts that are not at rest after the time limit moved as far
    as they got.
    """
    sweeps = sweeps_of(packing)
    boxes = [placement.box for placement in packing.placements]
    found: list[StageMotion] = []
    for box in sorted({boxes[n] for n in order}):
        numbers = [n for n in order if boxes[n] == box]
        motions = {n: StageMotion(n, 0.0, 0) for n in numbers}
        for stage, moved in stages(sweeps, numbers, masses, metres, settings):
            for n, distance in moved.items():
                if distance > motions[n].distance:
                    motions[n] = StageMotion(n, distance, stage)
        found += motions.values()
    return tuple(found)


def stages(
    sweeps: PartSweeps,
    order: Sequence[int],
    masses: Sequence[float],
    metres: float = 0.001,
    settings: PhysicsSettings | None = None,
    first: int = 1,
    fixed: Collection[int] = (),
) -> Iterator[tuple[int, dict[int, float]]]:
    """Simulate the stages of packing one box; parameters as `stage_motions`.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    order : sequence of int
        The numbers of the placements in the order of packing, all in one box.
    masses : sequence of float
        The mass of each placement of the packing, in kg.
    metres : float, default: 0.001
        The container's unit of length, in metres.
    settings : PhysicsSettings, optional
        The simulated world.
    first : int, default: 1
        The first stage that is simulated.
    fixed : collection of int
        The numbers of parts that can't move.

    Yields
    ------
    int
        The stage: the number of parts in the box.
    dict of int to float
        How far each of them moves, by its number, in the container's unit.
    """
    check_range("metres", metres, POSITIVE)
    packing, unit = sweeps.packing, sweeps.unit
    settings = replace(settings or PHYSICS, side=unit * metres)
    size = np.array(packing.sides) / unit
    whole, items = posed(packing), []
    for n, drop in zip(order, stacking_of(sweeps, order, fixed=fixed).drops, strict=True):
        items.append(whole[n].moved(Motion.shift((0, 0, -drop / unit))))
    pieces = fitted_items(items, settings).pieces
    least = max(settings.min_mass_ratio * max((masses[n] for n in order), default=0.0), LEAST_MASS)
    for stage in range(first, len(order) + 1):
        with World(size, settings) as world:
            for own, n in zip(pieces[:stage], order, strict=False):
                world.add(own, 0.0 if n in fixed else max(masses[n], least))
            world.run()
            moves = world.moves
        yield (
            stage,
            {
                n: _farthest(item.vertices, move) * unit
                for n, item, move in zip(order, items, moves, strict=False)
            },
        )


def _farthest(corners: Floats, move: Motion) -> float:
    """Compute the largest distance that a motion moves points (n, 3)."""
    return float(np.linalg.norm(move.apply(corners) - corners, axis=1).max())
