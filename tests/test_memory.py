"""Freed memory goes back to the system."""

import platform
from pathlib import Path

import pytest

from packit_sim.core.memory import release_memory


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1])


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep less")
def test_freed_memory_below_what_is_in_use_is_given_back() -> None:
    arrays = [bytearray(4000) for _ in range(20_000)]
    last = arrays.pop()  # above the others
    used = resident()
    del arrays
    release_memory()
    assert resident() < used - 10_000  # pages of 4,000 bytes and more
    assert len(last) == 4000
