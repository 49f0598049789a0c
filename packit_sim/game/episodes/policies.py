"""Policies: functions that choose the action of one sub-task."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from packit_sim.game.episodes.episode import Episode


class Policy(Protocol):
    """A function that chooses the next action of one sub-task.

    Notes
    -----
    A policy that loads weights from a file may have an attribute `weights_digest`, a str: it is
    recorded with results, so that they are not mistaken for those of other weights. Results that
    record an attribute `former_weights_digest` instead are taken for those of the same weights.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        """Choose an action.

        Parameters
        ----------
        episode : Episode
            The episode; it must not be changed.

        Returns
        -------
        int
            An index at which `episode.action_mask()` is True: of a shape, of a rotation, or of a
            grid node in C order.
        """
        ...


@runtime_checkable
class Scored(Protocol):
    """A policy that scores every action, so that searches can try the best alternatives."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int: ...

    def scores(self, episode: Episode, rng: np.random.Generator) -> npt.NDArray[np.float64]:
        """Compute the log-probabilities of the stage's actions.

        Parameters
        ----------
        episode : Episode
            The episode; it must not be changed.

        Returns
        -------
        ndarray of float64, shape (n actions,)
            -inf for an action that is not valid. The policy chooses the first of the largest.
        """
        ...
