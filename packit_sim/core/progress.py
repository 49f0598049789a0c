"""Progress of work in steps, for whoever shows it."""

from collections.abc import Callable

Progress = Callable[[str, int, int], object]
"""Called with the name of a step, how much of it is done, and how much there is."""


def unseen(step: str, done: int, total: int) -> None:
    """Show nothing."""
