"""Counts of the instructions that reading a file takes, by Valgrind's callgrind.

The process runs inside Valgrind: each file is read in a child of the process that has loaded its
reader and has read small files with it. A count does not depend on what other processes do.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import re
import resource
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

SECONDS = 120
"""CPU time of a read inside Valgrind, which slows it down some 50 times."""

VALGRIND = "valgrind"

NO_VALGRIND = "this campaign counts instructions by Valgrind, which is not installed"

_REQUEST = bytes.fromhex(
    "4889f8"  # mov rax, rdi: the address of the request
    "31d2"  # xor edx, edx: the answer outside Valgrind
    "48c1c703 48c1c70d 48c1c73d 48c1c733"  # rol rdi four times, by 128 bits in total
    "4887db"  # xchg rbx, rbx: with the rotations before it, Valgrind reads the request
    "4889d0 c3"  # mov rax, rdx; ret
)
"""A request to Valgrind in machine code for x86-64, as its header `valgrind.h` defines it."""

_CALLGRIND = int.from_bytes(b"CT", "big") << 16

_ZERO, _START, _STOP = (_CALLGRIND + number for number in (1, 4, 5))

_COLLECTED = re.compile(r"Collected : (\d+)")


def command(arguments: list[str], logs: Path) -> list[str]:
    """Return the command that runs a module of Python inside Valgrind."""
    return [
        *(VALGRIND, "--tool=callgrind", "--instr-atstart=no", "--callgrind-out-file=/dev/null"),
        *(f"--log-file={logs}/%p", sys.executable, *arguments),
    ]


def is_installed() -> bool:
    """Return whether Valgrind can be run."""
    return shutil.which(VALGRIND) is not None


class Counter:
    """Counts the instructions of functions, in a process that runs inside Valgrind.

    From its creation on, all that the process does is some 50 times slower.

    Parameters
    ----------
    logs : Path
        The folder of the logs of `command`.
    """

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._memory = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | 4)
        self._memory.write(_REQUEST)
        address = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))
        kind = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.POINTER(ctypes.c_uint64))
        self._request = kind(address)
        self._ask(_START)

    def count(self, function: Callable[[], object]) -> int | None:
        """Return the instructions of a function in a child process; None if it does not end."""
        child = os.fork()
        if child == 0:
            try:
                resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                self._ask(_ZERO)
                function()
            except Exception:  # a refusal counts as well
                pass
            finally:
                self._ask(_STOP)
                os._exit(0)
        _, status = os.waitpid(child, 0)
        log = self._logs / str(child)
        found = _COLLECTED.search(log.read_text())
        log.unlink()
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
            return None
        if found is None:
            raise RuntimeError(f"Valgrind counted nothing: status {status}")
        return int(found[1])

    def _ask(self, request: int) -> None:
        self._request((ctypes.c_uint64 * 6)(request))
