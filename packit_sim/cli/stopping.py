"""How Ctrl-C ends a command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import terminal

RESUMABLE = "repeat the command to resume"

NOTHING_WRITTEN = "nothing is written"


@contextmanager
def stoppable(hint: str) -> Iterator[None]:
    """Let Ctrl-C end the command with a message and exit code 130.

    Parameters
    ----------
    hint : str
        A note on what remains, or on how to resume.

    Yields
    ------
    None
        While the command works.
    """
    try:
        yield
    except KeyboardInterrupt:
        terminal.console.print(f"stopped: {hint}", markup=False)
        raise typer.Exit(130) from None
