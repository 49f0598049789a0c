"""Child processes with the bounds under which readers read hostile files."""

from __future__ import annotations

import os
import resource
import signal
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from campaigns.fuzzing.verdicts import MAX_ADDRESSES


def start(function: Callable[[], object]) -> int:
    """Call a function in a child process, which ends with it; return the process's id.

    The child may have so many more addresses than it begins with, and writes no core files.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which only wait
        child = os.fork()
    if child == 0:
        status = 1
        try:
            has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (has + MAX_ADDRESSES,) * 2)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            function()
            status = 0
        finally:
            os._exit(status)
    return child


def wait(child: int, seconds: float) -> int:
    """Wait for a child, and end it after so many seconds; return its exit status."""
    until = time.monotonic() + seconds
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.02)
