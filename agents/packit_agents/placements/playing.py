"""Plays for training: tasks are played with placements drawn at random."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from packit_agents.placements.scored_layout import ScoredLayout, Scorer
from packit_sim.core.caches import limit
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.episode import ordered
from packit_sim.rules import PACKIT, Rules

TRAINING_BUDGET = 3 * 2**30
"""Maximum size of all cached items in their rotations while tasks are played again, in bytes."""

MAX_PLACEMENTS = 64
"""Placements of a state from which one is drawn: those with the highest scores."""


@dataclass(frozen=True, eq=False)
class Decision:
    """A state, and the placement that was chosen.

    Attributes
    ----------
    features : ndarray
        float32 (n, features), of the placements with the highest scores.
    chosen : int
        The number of the chosen placement.
    """

    features: npt.NDArray[np.float32]
    chosen: int


@dataclass(frozen=True)
class Play:
    """The decisions and the return of one play.

    Attributes
    ----------
    total : float
        The return.
    decisions : list of Decision
        The decisions of this play, without those that it has in common with others.
    """

    total: float
    decisions: list[Decision]


def new_layout(task: Task, rules: Rules = PACKIT) -> ScoredLayout:
    """Create the empty layout of a task."""
    box = rules.new_box(task.cells)
    items = ordered(task, rules).items
    return ScoredLayout(items, box, tuple(rules.allowed_rotations), rules.buffer)


def play(layout: ScoredLayout, scorer: Scorer, rng: np.random.Generator) -> list[Decision]:
    """Draw placements with the probabilities that a scorer gives them, until nothing fits.

    Parameters
    ----------
    layout : ScoredLayout
        The layout, at its beginning; it is full afterwards.
    scorer : callable
        Scores the best placements, of which one is drawn.

    Returns
    -------
    list of Decision
        The decisions, one for each item that was placed.
    """
    decisions = []
    while len(found := layout.placements()):
        scores = scorer(found.features)
        best = np.argsort(-scores, kind="stable")[:MAX_PLACEMENTS]
        drawn = best[np.argsort(-(scores[best] + rng.gumbel(size=len(best))), kind="stable")]
        chosen = layout.place(found, drawn.tolist())
        if chosen is not None:
            decisions.append(Decision(found.features[best], int(np.flatnonzero(best == chosen)[0])))
    return decisions


def plays(
    task: Task, rules: Rules, scorer: Scorer, count: int, seed: tuple[int, ...]
) -> list[Play]:
    """Play a task several times from the same state on, with placements drawn at random.

    Parameters
    ----------
    scorer : callable
        Its scores mean the probabilities of placements.
    count : int
        The number of plays.
    seed : tuple of int
        Seed of the random numbers.

    Returns
    -------
    list of Play
        The plays. They begin with the items that the first one had placed at a random time.
    """
    _keep_items_of_many_tasks()
    rng = np.random.default_rng(seed)
    layout = new_layout(task, rules)
    decisions = play(layout, scorer, rng)
    common = int(rng.integers(len(decisions)))
    placed = layout.placed[:common]
    found = [Play(layout.volume / task.volume, decisions[common:])]
    space = layout.restart(placed).free_space()
    while len(found) < count:
        decisions = play(layout.restart(placed, space), scorer, rng)
        found.append(Play(layout.volume / task.volume, decisions))
    return found


def best_return(task: Task, rules: Rules, scorer: Scorer) -> float:
    """Play a task by the placements with the highest scores; return its return."""
    return new_layout(task, rules).fill(scorer, np.random.default_rng(0)).volume / task.volume


@cache
def _keep_items_of_many_tasks() -> None:
    """Let this process cache the items of a training in all their rotations."""
    limit("items in all rotations", TRAINING_BUDGET)
