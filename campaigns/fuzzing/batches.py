"""Batches: a child process in which atheris lets one reader read changed files for some time."""

from __future__ import annotations

import faulthandler
import hashlib
import json
import mmap
import os
import re
import struct
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from random import Random

import atheris

from campaigns.fuzzing import children
from campaigns.fuzzing.hostile_values import Change
from campaigns.fuzzing.reader import Reader
from campaigns.fuzzing.verdicts import Finding, judge
from packit_sim.core.errors import PackItError

STRUCTURED = 0.6
"""The share of changes that know the structure of the file; atheris makes the others."""

MAX_BYTES = 2**16
"""Most bytes of a file."""

STUCK_SECONDS = 600
"""After so many seconds a file that no alarm could stop counts as a crash; wall time, of which a
process may get little on a busy machine."""

_COVERAGE = re.compile(r"\bcov: (\d+)")
_DONE = re.compile(r"(?m)^Done \d+ runs")
"""After it no file is read: a fork that ends may crash in the threads of a library in C++ that it
does not have."""

_ARTIFACTS = ("crash-*", "timeout-*", "oom-*", "leak-*")


@dataclass(frozen=True)
class Batch:
    """What a batch did.

    Attributes
    ----------
    inputs : int
        The number of files that were read.
    seconds : float
        Its duration.
    edges : int
        Edges of the code that the files so far reached, in this batch or an earlier one.
    """

    inputs: int
    seconds: float
    edges: int


def run(reader: Reader, seconds: int, seed: int, work: Path) -> Batch:
    """Run a batch in a child process.

    Parameters
    ----------
    reader : Reader
        The reader.
    seconds : int
        Its duration.
    seed : int
        The seed of the changes.
    work : Path
        The reader's folder: it keeps the files that reached new code in "corpus", and what was
        found in "found".

    Returns
    -------
    Batch
        What was done. A batch ends early at a crash, or when a file took too much memory.
    """
    corpus, found, log = work / "corpus", work / "found", work / "log"
    for folder in (corpus, found):
        folder.mkdir(parents=True, exist_ok=True)
    for data in reader.seeds():
        (corpus / hashlib.sha1(data).hexdigest()).write_bytes(data)
        with suppress(PackItError):
            reader.read(data)  # kernels are compiled before the time of a file is measured
    count = mmap.mmap(-1, 8)
    started = time.monotonic()
    child = children.start(partial(_fuzz, reader, seconds, seed, work, count))
    status = children.wait(child, seconds + 2 * STUCK_SECONDS)
    said = log.read_text(errors="replace")
    is_done = _DONE.search(said) is not None
    if status < 0 and not is_done:
        keep(found, Finding("crash", f"the process was ended by signal {-status}"), b"")
    for pattern in _ARTIFACTS:
        for file in found.glob(pattern):
            kind = file.name.partition("-")[0]
            if not is_done:
                keep(found, Finding("crash", f"the process ended: {kind}"), file.read_bytes())
            file.unlink()
    reached = _COVERAGE.findall(said)
    return Batch(_number(count), time.monotonic() - started, int(reached[-1]) if reached else 0)


def keep(found: Path, finding: Finding, data: bytes) -> None:
    """Keep a file with which something is wrong, the shortest of those with one reason."""
    name = hashlib.sha1(repr(finding.key).encode()).hexdigest()[:12]
    file, about = found / f"{name}.file", found / f"{name}.json"
    if not file.exists() or len(file.read_bytes()) > len(data):
        file.write_bytes(data)
        about.write_text(json.dumps(asdict(finding)))


def _fuzz(reader: Reader, seconds: int, seed: int, work: Path, count: mmap.mmap) -> None:
    """Fuzz until the time is over, and end the process."""
    faulthandler.disable()  # libFuzzer leaves the signals alone that have a handler
    log = os.open(work / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    is_changed = False

    def read(data: bytes) -> None:
        finding = judge(reader, data)
        if is_changed:
            count[:] = struct.pack("<Q", _number(count) + 1)
        if finding is not None:
            keep(work / "found", finding, data)
            if finding.kind == "memory":
                os._exit(0)  # the peak of this process would hide the next

    def mutate(data: bytes, size: int, seed: int) -> bytes:
        nonlocal is_changed
        is_changed = True
        rng = Random(seed)

        def change(data: bytes) -> bytes:
            return atheris.Mutate(data, max(size, len(data)))

        return changed(reader, data, rng, change)[:size]

    options = (
        f"-max_total_time={seconds}",
        f"-seed={seed % 2**31 + 1}",
        f"-max_len={MAX_BYTES}",
        f"-timeout={STUCK_SECONDS}",
        "-rss_limit_mb=0",
        f"-artifact_prefix={work / 'found'}/",
    )
    atheris.Setup(["fuzzing", *options, str(work / "corpus")], read, custom_mutator=mutate)
    atheris.Fuzz()


def changed(reader: Reader, data: bytes, rng: Random, change: Change) -> bytes:
    """Change a file, in its structure or without regard to it."""
    if rng.random() < STRUCTURED:
        try:
            return reader.mutator(data, rng, change)
        except (ValueError, RecursionError):
            pass  # no longer of its structure
    return change(data)


def _number(count: mmap.mmap) -> int:
    (number,) = struct.unpack("<Q", count[:8])
    return int(number)
