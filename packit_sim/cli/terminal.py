"""The terminal: the console, progress bars, logs and errors."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.logging import RichHandler
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment

from packit_sim.cli.compilation_bar import NoteColumn
from packit_sim.core.plain_text import plain

LOGGERS = ("packit_sim", "packit_agents")


class PlainConsole(Console):
    """A console that ignores control characters in texts: names from files may contain some."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(plain(segment.text), segment.style)


console = PlainConsole()


def progress_bars() -> Progress:
    """Create progress bars with a count, the elapsed and remaining time, and a field `note`.

    They are only shown in a terminal. While kernels are compiled, a bar of these replaces the note.
    """
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        NoteColumn(),
        console=console,
        disable=not console.is_terminal,
    )


def show_logs(level: int) -> None:
    """Print log records of this level and above to stderr."""
    handler = RichHandler(console=PlainConsole(stderr=True), show_path=False)
    for name in LOGGERS:
        logger = logging.getLogger(name)
        logger.setLevel(level)
        logger.handlers = [handler]


def print_error(line: str) -> None:
    """Print an error to stderr, as one line."""
    text = f"[bold red]error:[/] {escape(line)}"
    PlainConsole(stderr=True).print(text, highlight=False, soft_wrap=True)
