"""Faults at the n-th change of a folder, in a subprocess: what a kill or a full disk leaves behind.

A change is whatever happens to files under one folder: an `open` for writing, an fsync, a rename, a
removal, a new folder. Python announces each to an audit hook before it happens (an fsync is patched
instead), so no change is missed, and none depends on luck. Child processes are armed as well, and
count for themselves.

    changes = injector.count(command, folder)
    for n in range(1, changes + 1):
        injector.run(command, folder, at=n, fault="kill")
"""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

Fault = Literal["none", "kill", "full", "readonly", "interrupt", "terminate"]

_UNDER, _AT, _FAULT, _LOG = (f"PACKIT_FAULT_{name}" for name in ("UNDER", "AT", "KIND", "LOG"))
_REMOVALS = ("os.remove", "os.rmdir")
_OTHERS = ("os.mkdir", "os.link", "os.symlink", "os.truncate")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_START = "from campaigns import injector; injector.arm()\n"


def run(
    command: Sequence[str],
    folder: Path,
    at: int = 0,
    fault: Fault = "kill",
    timeout: float = 120.0,
    cwd: Path | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a Python command that fails at one change of a folder.

    Parameters
    ----------
    command : sequence of str
        Arguments of Python, such as ["-m", "packit_sim", "demo"] or ["-c", code].
    folder : Path
        The folder whose changes count.
    at : int
        The number of the change, from 1; 0 for none.
    fault : Fault
        What happens then: SIGKILL, SIGINT, SIGTERM; "full": OSError ENOSPC at this and every later
        write (a removal still works); "readonly": OSError EROFS at this and every later change.
    timeout : float
        The limit in seconds.
    cwd : Path, optional
        The working directory.

    Returns
    -------
    CompletedProcess
        Its exit code and output.
    """
    root, start = Path(__file__).parents[1], folder.parent / f".{folder.name}-faults"
    start.mkdir(exist_ok=True)
    (start / "sitecustomize.py").write_text(_START)
    paths = [str(start), str(root), str(root / "agents")]
    settings = {
        _UNDER: str(folder.resolve()),
        _AT: str(at),
        _FAULT: fault,
        _LOG: str(_log(folder)),
        "PYTHONPATH": os.pathsep.join(paths),
    }
    return subprocess.run(
        [sys.executable, *command],
        env={**os.environ, **settings},
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=cwd,
        check=False,
    )


def count(command: Sequence[str], folder: Path, cwd: Path | None = None) -> int:
    """Run a command to its end without a fault, and count how often it changes a folder."""
    done = run(command, folder, fault="none", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return len(changes(folder))


def fork(function: Callable[[], object], folder: Path, at: int = 0, fault: Fault = "kill") -> int:
    """Call a function in a forked process, as `run` runs a command, but without its start.

    Parameters
    ----------
    function : callable
        What to call.
    folder : Path
        The folder whose changes count.
    at : int
        The number of the change, from 1; 0 for none.
    fault : Fault
        What happens then.

    Returns
    -------
    int
        The exit code, negative for a signal; 0 if the function returned, 1 if it raised.
    """

    def armed() -> None:
        watch(folder, at, fault)
        function()

    process = multiprocessing.get_context("fork").Process(target=armed)
    process.start()
    process.join(120.0)
    assert process.exitcode is not None
    return process.exitcode


def changes_of(function: Callable[[], object], folder: Path) -> int:
    """Call a function in a forked process, and count how often it changes a folder."""
    assert fork(function, folder, fault="none") == 0
    return len(changes(folder))


def arm() -> None:
    """Watch the changes of this process as the environment says; called as Python starts."""
    under = os.environ.get(_UNDER)
    if under is not None:
        _watch(under, int(os.environ[_AT]), os.environ[_FAULT], os.environ[_LOG])


def watch(folder: Path, at: int = 0, fault: str = "none") -> None:
    """Watch the changes of this process, and fail at one, as `run` says; there is no way back."""
    _watch(str(folder.resolve()), at, fault, str(_log(folder)))


def changes(folder: Path) -> list[str]:
    """List the changes of a folder that were watched without a fault, and forget them."""
    found = _log(folder).read_text().splitlines()
    _log(folder).unlink()
    return found


def _log(folder: Path) -> Path:
    """Return the file that lists the changes of a folder when no fault is asked for."""
    return folder.parent / f".{folder.name}-changes"


def _watch(under: str, at: int, fault: str, log_file: str) -> None:
    changes, busy = 0, False

    def change(event: str, path: object, parent: int = -1) -> None:
        nonlocal changes, busy
        if busy or isinstance(path, int) or path is None:
            return
        base = os.getcwd() if parent < 0 else os.readlink(f"/proc/self/fd/{parent}")
        name = os.path.normpath(os.path.join(base, os.fsdecode(path)))  # type: ignore[arg-type]
        if not name.startswith(under + os.sep):
            return
        changes += 1
        if fault == "none":
            busy = True
            with open(log_file, "a") as log:
                log.write(f"{event} {name}\n")
            busy = False
        elif fault in ("full", "readonly"):
            if at and changes >= at and (fault == "readonly" or event not in _REMOVALS):
                code = errno.ENOSPC if fault == "full" else errno.EROFS
                where = () if event == "fsync" else (name,)  # as the system's own errors
                raise OSError(code, os.strerror(code), *where)
        elif changes == at:
            kinds = {"kill": "SIGKILL", "interrupt": "SIGINT", "terminate": "SIGTERM"}
            os.kill(os.getpid(), signal.Signals[kinds[fault]])

    def hook(event: str, args: tuple[Any, ...]) -> None:
        if event == "open" and (args[2] or 0) & _WRITES:
            change(event, args[0])
        elif event == "os.rename":
            change(event, args[1], args[3])
        elif event in ("os.remove", "os.rmdir"):
            change(event, args[0], args[1])
        elif event in _OTHERS:
            change(event, args[0])

    fsync = os.fsync

    def watched(handle: int) -> None:
        change("fsync", os.readlink(f"/proc/self/fd/{handle}"))
        fsync(handle)

    os.fsync = watched  # type: ignore[assignment]
    sys.addaudithook(hook)
