"""How long a search may look."""

from __future__ import annotations

import time
from dataclasses import dataclass

from packit_sim.core.errors import ArgumentError


@dataclass(frozen=True)
class Budget:
    """So many rollouts, or so many seconds: the one that is given.

    Only with rollouts is what is found the same on every machine.
    """

    rollouts: int | None = None
    seconds: float | None = None

    @classmethod
    def parse(cls, text: str) -> Budget:
        """Of "200", rollouts, or "10s", seconds. Raises ValueError that says so."""
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
        """Begins to spend it."""
        return Clock(self, time.monotonic())


@dataclass
class Clock:
    """What is spent of a budget. rollouts: so far."""

    budget: Budget
    started: float
    rollouts: int = 0

    def is_over(self) -> bool:
        if self.budget.rollouts is not None:
            return self.rollouts >= self.budget.rollouts
        assert self.budget.seconds is not None
        return time.monotonic() - self.started >= self.budget.seconds
