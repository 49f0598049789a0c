"""Child processes with the bounds under which readers read hostile files."""

from __future__ import annotations

import os
import resource
import signal
import time
import warnings
from collections.abc import Callable

from campaigns.fuzzing.verdicts import MAX_ADDRESSES
from packit_sim.core.memory import limit_memory


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
            limit_memory(MAX_ADDRESSES)
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
