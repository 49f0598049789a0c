"""A command that the campaign of faults disturbs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from packit_sim.cli.app import main

OUT = "out"
"""The folder of a command's output, in its workspace; `meshes` and `tasks` are next to it."""


@dataclass(frozen=True)
class Command:
    """A command with its output in one folder.

    Attributes
    ----------
    name : str
        The name, as in `packit NAME`.
    arguments : tuple of str
        The rest of the command; the workspace is its working directory.
    before : tuple of str
        The same command with less to do, which has already ended; empty if there was none.
    check : callable
        Reads what is there and raises if it can't be read: the folder, and that of an undisturbed
        run.
    workers : bool
        Whether `--workers` sets the number of processes.
    repeats : bool
        Whether the command always ends with the same bytes; if not, the same command again begins
        with the last answer, and may end with another that is as good.
    cluster : bool
        Whether the fault of a lost machine of a cluster is tried.
    change : str
        What is other than in the command before it, where a command is tried with several changes.
    serves : bool
        Whether it serves a page until Ctrl-C, which ends it with exit code 0.
    """

    name: str
    arguments: tuple[str, ...]
    before: tuple[str, ...]
    check: Callable[[Path, Path], None]
    workers: bool = True
    repeats: bool = True
    cluster: bool = False
    change: str = ""
    serves: bool = False

    @property
    def title(self) -> str:
        """The name of the command and the change."""
        return f"{self.name} {self.change}".strip()

    def run(self, workers: int = 1, arguments: Iterable[str] | None = None) -> None:
        """Run the command in this process, in the working directory, up to its `sys.exit`."""
        words = [*self.name.split(), *(self.arguments if arguments is None else arguments)]
        sys.argv = ["packit", *words, *(["--workers", str(workers)] if self.workers else [])]
        main()
