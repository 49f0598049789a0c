"""Budgets of searches: a number of rollouts, or processor time."""

from __future__ import annotations

import time
from dataclasses import dataclass

from packit_sim.core.errors import ArgumentError


@dataclass(frozen=True)
class Budget:
    """A number of rollouts, or processor time; exactly one of them is given.

    Results are the same on every machine only with a number of rollouts. Processor time does not
    pass while a process waits: searches that share the cores of a machine still have equal time.

    Parameters
    ----------
    seconds : float, optional
        Seconds of processor time of the thread that searches.
    """

    rollouts: int | None = None
    seconds: float | None = None

    @classmethod
    def parse(cls, text: str) -> Budget:
        """Parse "200" (rollouts) or "10s" (seconds of processor time).

        Parameters
        ----------
        text : str
            A number, followed by "s" if it is a time.

        Returns
        -------
        Budget
            The budget.

        Raises
        ------
        ArgumentError
            If the text is neither, or not positive.
        """
        try:
            if text.endswith("s"):
                budget = cls(seconds=float(text[:-1]))
            else:
                budget = cls(rollouts=int(text))
        except ValueError:
            budget = cls()
        if not ((budget.rollouts or 0) >= 1 or 0 < (budget.seconds or 0) < float("inf")):
            raise ArgumentError(
                "a budget is a number of rollouts, such as 200, or a time, such as 10s, "
                f"not {text!r}"
            )
        return budget

    def start(self) -> Clock:
        """Start to spend the budget."""
        return Clock(self, time.thread_time())


@dataclass
class Clock:
    """The part of a budget that is spent.

    Parameters
    ----------
    started : float
        The start of the search, in seconds of `time.thread_time`.
    rollouts : int
        Number of rollouts so far; the search counts them.
    """

    budget: Budget
    started: float
    rollouts: int = 0

    @property
    def share_left(self) -> float:
        """The share of the budget that is left, from 1 to 0."""
        if self.budget.rollouts is not None:
            return max(0.0, 1 - self.rollouts / self.budget.rollouts)
        assert self.budget.seconds is not None
        return max(0.0, 1 - (time.thread_time() - self.started) / self.budget.seconds)

    def is_over(self) -> bool:
        """Check whether the budget is spent."""
        return self.share_left == 0
