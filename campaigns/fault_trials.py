"""Trials of the campaign of faults: a command is disturbed, inspected, and run again."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import re
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
from safetensors import safe_open

from campaigns import injector
from campaigns.disturbed import OUT, Command
from campaigns.fault_commands import FOREIGN, prepare_inputs

SECONDS = 120.0
"""The most that a command may take."""

HUNG = -1000
"""The exit code of a command that took longer."""

SIZES = 24
"""Number of file sizes at which a write is cut off."""

LARGEST_SERVED = 10**6
"""Size of the largest file of a page, which keeps none."""

GRACE = 10.0
"""Seconds in which the processes of a command must end after it."""

_DURATION = re.compile(rb'"(seconds": ?[0-9.e-]+|sha256": ?"[0-9a-f]+")')

VOLATILE = ("tensorboard",)
"""Folders whose files have the time in them and in their names."""


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : int
        Its exit code, negative for a signal.
    output, errors : str
        What it printed.
    left : tuple of int
        The processes that it left alive.
    """

    code: int
    output: str
    errors: str
    left: tuple[int, ...]


@dataclass
class Running:
    """A command in a forked process, which leads a session of its own.

    Parameters
    ----------
    work : callable
        What the process does; it may end by `sys.exit`.
    """

    work: Callable[[], object]
    process: BaseProcess = field(init=False)

    def __post_init__(self) -> None:
        self._pipes, ends = zip(*(os.pipe() for _ in range(2)), strict=True)

        def begin() -> None:
            os.setsid()
            signal.signal(signal.SIGINT, signal.default_int_handler)  # shells may ignore it
            for number, end in enumerate(ends, start=1):
                os.dup2(end, number)
            self.work()

        sys.stdout.flush()
        sys.stderr.flush()
        self.process = multiprocessing.get_context("fork").Process(target=begin)
        self.process.start()
        for end in ends:
            os.close(end)

    @property
    def leader(self) -> int:
        """The id of the process, which is that of its session."""
        assert self.process.pid is not None
        return self.process.pid

    def wait(self, seconds: float) -> bool:
        """Wait for the end of the process, though not of those that it started."""
        until = time.monotonic() + seconds
        while self.process.exitcode is None and time.monotonic() < until:
            time.sleep(0.005)
        return self.process.exitcode is not None

    def end(self) -> Ended:
        """Wait for the end of the command, and of its processes, which are killed if need be."""
        has_ended = self.wait(SECONDS)
        if not has_ended:
            self.process.kill()
            self.process.join()
        code, leader = self.process.exitcode, self.leader
        assert code is not None
        until = time.monotonic() + GRACE
        while (left := members(leader)) and time.monotonic() < until:
            time.sleep(0.02)
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, 9)
        output, errors = map(_drained, self._pipes)
        self.process.close()
        return Ended(code if has_ended else HUNG, output, errors, left)


def members(session: int) -> tuple[int, ...]:
    """List the living processes of a session."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            with contextlib.suppress(OSError):
                fields = Path("/proc", entry, "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == session and fields[0] != "Z":
                    found.append(int(entry))
    return tuple(found)


def _drained(pipe: int) -> str:
    os.set_blocking(pipe, False)
    parts = []
    with contextlib.suppress(BlockingIOError):
        while part := os.read(pipe, 65536):
            parts.append(part)
    os.close(pipe)
    return b"".join(parts).decode(errors="replace")


class Bench:
    """A workspace in which a command is disturbed again and again.

    Parameters
    ----------
    command : Command
        The command.
    workspace : Path
        An empty folder; it becomes the working directory.

    Attributes
    ----------
    folder : Path
        The folder of the output.
    """

    def __init__(self, command: Command, workspace: Path) -> None:
        self.command = command
        self.workspace = workspace
        self.folder = workspace / OUT
        self._first, self._whole = workspace / "first", workspace / "whole"
        prepare_inputs(workspace)
        os.chdir(workspace)
        for name, content in FOREIGN.items():
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_text(content)
        if command.before:
            self._run_here(command.before)
        shutil.copytree(self.folder, self._first)
        self._run_here()
        shutil.copytree(self.folder, self._whole)
        self._wanted = contents(self._whole)
        command.check(self._whole, self._whole)

    def _run_here(self, arguments: tuple[str, ...] | None = None) -> None:
        """Run the command in this process, so that its caches serve all trials.

        Raises
        ------
        RuntimeError
            If the command fails, with what it printed.
        """
        log = io.StringIO()
        try:
            with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
                self.command.run(arguments=arguments)
        except SystemExit as end:
            if end.code:
                raise RuntimeError(
                    f"{self.command.title} failed without a fault, with exit code {end.code}: "
                    f"{log.getvalue()[-2000:]}"
                ) from None

    def restore(self) -> None:
        """Restore what was there before the command."""
        shutil.rmtree(self.folder)
        shutil.copytree(self._first, self.folder)

    def fill(self) -> None:
        """Write what was there before the command into the folder, which is empty."""
        shutil.copytree(self._first, self.folder, dirs_exist_ok=True)

    def pages(self) -> int:
        """Count the pages of 4096 bytes that files and folders have before the command."""
        paths = [self._first, *self._first.rglob("*")]
        return sum(1 + path.stat().st_size // 4096 for path in paths)

    def sizes(self, rng: np.random.Generator) -> list[int]:
        """Draw sizes up to that of the largest file: 0, and others on a logarithmic scale.

        The locks of worker processes are files of 32 bytes: none is smaller.
        """
        kept = max(map(len, self._wanted.values()))
        largest = LARGEST_SERVED if self.command.serves else kept
        drawn = np.exp(rng.uniform(np.log(min(32, largest)), np.log(largest), SIZES))
        return sorted({0, *drawn.astype(int).tolist()})

    def start(self, prepare: Callable[[], object] = lambda: None, workers: int = 1) -> Running:
        """Start the command in a forked process, which first calls a function."""

        def work() -> None:
            prepare()
            self.command.run(workers)

        return Running(work)

    def start_anew(self, *options: str) -> Running:
        """Start the command with further options in a new interpreter: Ray can't be forked."""
        words = [*self.command.name.split(), *self.command.arguments, *options]
        command = [sys.executable, "-m", "packit_sim", *words]
        return Running(lambda: os.execv(sys.executable, command))

    def changes(self) -> int:
        """Count how often an undisturbed run changes the folder."""
        self.restore()
        ended = self.start(lambda: injector.watch(self.folder)).end()
        assert ended.code == 0, ended
        return len(injector.changes(self.folder))

    def problems(self, ended: Ended, expected: Callable[[Ended], str | None]) -> Iterator[str]:
        """Inspect what a disturbed command left, run it again, and yield what is wrong.

        Parameters
        ----------
        ended : Ended
            How the command ended.
        expected : callable
            What is wrong with that end, None if nothing is.

        Yields
        ------
        str
            A problem.
        """
        if wrong := expected(ended):
            yield f"{wrong}: {_short(ended)}"
        if ended.left:
            yield f"{len(ended.left)} processes were left"
        try:
            self.command.check(self.folder, self._whole)
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            yield f"unreadable ({place.name}): {type(error).__name__}: {error}"
        again = self.start().end()
        if again.code != 0:
            yield f"the same command again failed: {_short(again)}"
        differ = self._differences()
        if again.code == 0 and differ:
            yield f"after the same command again, these files differ: {', '.join(differ)}"
        for name, content in FOREIGN.items():
            file = self.folder / name
            if not file.is_file() or file.read_text() != content:
                yield f"the foreign file {name} was changed"

    def _differences(self) -> list[str]:
        """List the files that are not those of an undisturbed run."""
        found, wanted = contents(self.folder), self._wanted
        if self.command.repeats:
            return sorted(n for n in found.keys() | wanted.keys() if found.get(n) != wanted.get(n))
        self.command.check(self.folder, self._whole)
        return sorted(found.keys() ^ wanted.keys())


def contents(folder: Path) -> dict[str, bytes]:
    """Read all files of a folder; an empty folder counts as a file.

    What is different in each run is left out: `VOLATILE` folders, the duration of episodes with the
    digest of their file, and the order of the metadata in files of weights.
    """
    found = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if any(each in VOLATILE for each in name.split("/")):
            continue
        if path.suffix == ".safetensors" and not path.name.startswith("."):
            with safe_open(path, "np") as file:
                tensors = {key: file.get_tensor(key).tolist() for key in sorted(file.keys())}
                found[name] = repr((sorted(file.metadata().items()), tensors)).encode()
        elif path.is_file():
            found[name] = _DURATION.sub(b"", path.read_bytes())
        elif not any(path.iterdir()):
            found[f"{name}/"] = b""
    return found


def _short(ended: Ended) -> str:
    """Describe an end in one line."""
    lines = (ended.errors or ended.output).strip().splitlines()[-1:]
    return f"exit code {ended.code}, {' '.join(lines)[-300:]!r}"
