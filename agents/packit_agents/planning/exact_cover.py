"""Exact cover: pieces that fill a box completely, without a heuristic's blind spots.

Cuboids are packed by a depth-first search over the lowest free corner, polycubes by the SAT solver
CaDiCaL. Both find a filling, or prove that there is none, or run out of time.
"""

from __future__ import annotations

import enum
import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_agents.planning import sat
from packit_agents.planning.budgets import Budget
from packit_agents.planning.cuboid_kernels import NONE, STOPPED, fill_box
from packit_agents.planning.grid_pieces import GridPieces
from packit_agents.planning.rollouts import Best, fill_up
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent, OnProgress, play_placement
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.rules import PACKIT, Rules

FIRST_TRIES = 100_000
"""Partial fillings of cuboids before the first restart."""

GROWTH = 1.2
"""Factor on them after each restart: the search stays complete."""

NOISE = 0.5
"""Volumes are multiplied by a number from this to 1 before the choices are sorted by them."""

MAX_SIDE = 61
"""Cubes along a box of cuboids: sums of sides are bits of an integer."""

MAX_PLACEMENTS = 200_000
"""Placements of polycubes, each a variable of the SAT problem."""


class Outcome(enum.StrEnum):
    """Outcome of an exact cover search on a task."""

    FILLED = "filled"
    IMPOSSIBLE = "impossible"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Cover:
    """An outcome, and with `FILLED` the placements."""

    outcome: Outcome
    placed: tuple[PlacedItem, ...] = ()


def exact_cover(
    items: Sequence[Item], cells: Triple, seconds: float, seed: int = 0, rules: Rules = PACKIT
) -> Cover:
    """Fill a box completely, or find out that it is impossible.

    Parameters
    ----------
    items : Sequence of Item
        The items: cuboids or polycubes on the grid that have the volume of the box.
    cells : tuple of int
        Cells of the box.
    seconds : float
        Limit: processor time for cuboids, time for polycubes, whose solver is another process.
    seed : int
        Of the restarts for cuboids.
    rules : Rules
        The rules, whose rotations are allowed.

    Returns
    -------
    Cover
        What was found.

    Raises
    ------
    ArgumentError
        If an item is no union of cubes on the grid, the items don't fill the box, or there are too
        many placements.
    MissingPackageError
        If there are polycubes, and python-sat is not installed.
    """
    pieces = GridPieces.of(items, cells, rules)
    if all(one.is_cuboid for one in pieces.types) and max(pieces.box) <= MAX_SIDE:
        return _cover_with_cuboids(pieces, seconds, np.random.default_rng(seed))
    return _cover_with_polycubes(pieces, seconds)


@dataclass(frozen=True)
class ExactCover:
    """Exact cover: cuboids or polycubes fill the box completely, if there is a way.

    If there is none, or none is found in time, the policies play.

    Parameters
    ----------
    seconds : float
        The time limit (see `exact_cover`).
    """

    seconds: float

    @classmethod
    def parse(cls, value: str) -> ExactCover:
        """Parse the time limit, such as "60s"; a number of rollouts is no limit here."""
        budget = Budget.parse(value)
        if budget.seconds is None:
            raise ArgumentError(f"exact cover needs a time, such as 60s, not {value!r}")
        return cls(budget.seconds)

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        rules = episode.rules
        if rules.kinematic or rules.moves_items or rules.support or rules.boxes > 1:
            raise ArgumentError(f"exact cover can't play by the rules {rules}")
        items, cells = episode.task.items, episode.box.cells
        found = exact_cover(items, cells, self.seconds, int(rng.integers(2**31)), rules)
        if found.outcome is not Outcome.FILLED:
            fill_up(agent, episode, rng)
        for placed in found.placed:
            play_placement(episode, placed)
        Best(on_progress).add(episode)


def _cover_with_cuboids(pieces: GridPieces, seconds: float, rng: np.random.Generator) -> Cover:
    """Search from the largest piece, then with restarts in other orders."""
    started = time.thread_time()
    choices = [(kind, item) for kind, one in enumerate(pieces.types) for item in one.turned]
    types = np.array([kind for kind, _ in choices])
    extents = np.array([pieces.types[kind].turned[item].shape for kind, item in choices])
    sides = np.array([next(iter(one.turned.values())).shape for one in pieces.types])
    counts = np.array([one.count for one in pieces.types])
    volumes, box = extents.prod(axis=1), np.array(pieces.box)
    tries, order = float(FIRST_TRIES), np.argsort(-volumes, kind="stable")
    while True:
        outcome, placed = fill_box(sides, counts, types[order], extents[order], box, int(tries))
        if outcome == NONE:
            return Cover(Outcome.IMPOSSIBLE)
        if outcome != STOPPED:
            found = [
                pieces.placed(choices[order[n]][1], (x, y, z)) for n, x, y, z in placed.tolist()
            ]
            return Cover(Outcome.FILLED, tuple(found))
        if time.thread_time() - started > seconds:
            return Cover(Outcome.UNKNOWN)
        tries *= GROWTH
        order = np.argsort(-volumes * rng.uniform(NOISE, 1, len(types)), kind="stable")


def _cover_with_polycubes(pieces: GridPieces, seconds: float) -> Cover:
    """Solve exact cover as a SAT problem: each cube and each piece has exactly one placement."""
    placements: list[tuple[Item, Triple]] = []
    groups = []
    cubes: list[list[int]] = [[] for _ in range(int(np.prod(pieces.box)))]
    for kind, one in enumerate(pieces.types):
        first = len(placements) + 1
        for item, own in one.turned.items():
            spans = (range(n - side + 1) for n, side in zip(pieces.box, own.shape, strict=True))
            for corner in itertools.product(*spans):
                x, y, z = corner
                placements.append((item, (x, y, z)))
                at = np.ravel_multi_index(tuple((np.argwhere(own) + corner).T), pieces.box)
                for cube in at.tolist():
                    cubes[cube].append(len(placements))
        groups.append((list(range(first, len(placements) + 1)), one.count))
        if len(placements) > MAX_PLACEMENTS:
            raise ArgumentError(
                f"exact cover of a box of {' x '.join(map(str, pieces.box))} cubes has more than "
                f"{MAX_PLACEMENTS:,} placements of {kind + 1} kinds of polycubes"
            )
    wanted = [(names, 1) for names in cubes] + groups
    try:
        chosen = sat.solve(wanted, len(placements), seconds)
    except sat.OutOfTimeError:
        return Cover(Outcome.UNKNOWN)
    if chosen is None:
        return Cover(Outcome.IMPOSSIBLE)
    return Cover(Outcome.FILLED, tuple(pieces.placed(*placements[n - 1]) for n in chosen))
