"""The faults of the campaign: where each can strike, and how a command may end."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from campaigns import injector, ray_nodes
from campaigns.disturbed import OUT
from campaigns.fault_trials import Bench, Ended, Running, contents, members
from campaigns.ray_nodes import RayCluster
from packit_sim.core.memory import limit_memory

Trial = Callable[[], Iterator[str]]
"""Disturbs the command of a bench, and yields problems."""

Trials = Iterator[tuple[str, Trial]]
"""Trials, each with where it strikes."""

NOBODY = 65534
"""The user nobody, who may write nothing of ours."""

MOMENTS = 8
"""Trials of a fault that strikes at random moments."""

KEPT = "nothing is lost, the same command resumes"

ONE_LINE = "one line with the path, exit code 2; nothing is lost, the same command resumes"


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes
    ----------
    promise : str
        What holds whenever it strikes.
    trials : callable
        Takes a bench and a random generator, and yields the trials.
    """

    promise: str
    trials: Callable[[Bench, np.random.Generator], Trials]


def killed(by: signal.Signals, ended: Ended) -> str | None:
    """Expect the end by a signal."""
    return None if ended.code == -by else f"not killed by {by.name}"


def stopped(ended: Ended, code: int = 130) -> str | None:
    """Expect the end by Ctrl-C, or another signal: a line, and no traceback."""
    if ended.code != code or not ("stopped" in ended.output or "is closed" in ended.output):
        return f"not stopped with a line and exit code {code}"
    return f"more than a line: {ended.errors[-300:]!r}" if ended.errors.strip() else None


def refused(ended: Ended, named: str = f"{OUT}/") -> str | None:
    """Expect one line that names a file of the output and exit code 2, or a command that ended."""
    if ended.code == 0:
        return None
    if ended.code != 2:
        return "not refused with exit code 2"
    if not ended.errors.startswith("error: ") or ended.errors.count("\n") != 1:
        return f"not one line: {ended.errors[-300:]!r}"
    return None if named in ended.errors else "the line does not have the path"


def ended_or(expected: Callable[[Ended], str | None], ended: Ended) -> str | None:
    """Expect an end, unless the command was faster than the fault."""
    return None if ended.code == 0 else expected(ended)


def at_each_change(kind: injector.Fault, expected: Callable[[Ended], str | None]) -> Fault:
    """Create a fault that strikes at each change of the folder."""

    def trials(bench: Bench, rng: np.random.Generator) -> Trials:
        for n in range(1, bench.changes() + 1):
            yield f"change {n}", partial(trial, bench, n)

    def trial(bench: Bench, n: int) -> Iterator[str]:
        ended = bench.start(partial(injector.watch, bench.folder, n, kind)).end()
        is_usual = kind == "interrupt" and bench.command.serves
        yield from bench.problems(ended, partial(ended_or, expected) if is_usual else expected)

    return Fault(ONE_LINE if kind in ("full", "readonly") else KEPT, trials)


def within_a_write(is_kill: bool) -> Fault:
    """Create a limit of the size of files, at which the process is killed or the write fails."""
    expected = partial(killed, signal.SIGXFSZ) if is_kill else refused

    def trials(bench: Bench, rng: np.random.Generator) -> Trials:
        for size in bench.sizes(rng):
            yield f"byte {size}", partial(trial, bench, size)

    def trial(bench: Bench, size: int) -> Iterator[str]:
        def limit() -> None:
            if is_kill:
                signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

        ended = bench.start(limit).end()
        yield from bench.problems(ended, partial(ended_or, expected))

    return Fault(KEPT if is_kill else ONE_LINE, trials)


def _small_disk(bench: Bench, rng: np.random.Generator) -> Trials:
    """Put the folder on disks of 4 kB more and more, as root."""

    def trial(pages: int) -> Iterator[str]:
        options = f"size={(bench.pages() + pages) * 4096}"
        folder = str(bench.folder)
        subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], check=True)
        try:
            bench.fill()
            ended = bench.start().end()
            larger = ["mount", "-o", "remount,size=64m", folder]
            subprocess.run(larger, check=True)
            yield from bench.problems(ended, refused)
        finally:
            subprocess.run(["umount", folder], check=True)

    if os.geteuid() == 0:
        for pages in range(0, 40, 2):
            yield f"{pages} pages", partial(trial, pages)


def _other_user(bench: Bench, rng: np.random.Generator) -> Trials:
    """Run the command as a user who may read everything and write nothing."""

    def trial() -> Iterator[str]:
        def become_nobody() -> None:
            os.setgid(NOBODY)
            os.setuid(NOBODY)

        before = contents(bench.folder)
        ended = bench.start(become_nobody).end()
        if contents(bench.folder) != before:
            yield "something was written"
        if ended.code != 2:
            yield "not refused"
        yield from bench.problems(ended, refused)

    if os.geteuid() == 0:
        yield "at the start", trial


def _two_processes(bench: Bench, rng: np.random.Generator) -> Trials:
    """Run the command twice at the same time."""

    def trial(delay: float) -> Iterator[str]:
        one = bench.start()
        time.sleep(delay)
        other = bench.start()
        ends = sorted((one.end(), other.end()), key=lambda ended: ended.code)
        if ends[0].code != 0:
            yield "neither of them ended"
        yield from bench.problems(ends[1], refused)

    for delay in rng.uniform(0, 0.3, MOMENTS):
        yield f"after {delay:.3f} s", partial(trial, delay)


def at_a_moment(
    strike: Callable[[int], object], expected: Callable[[Ended], str | None], promise: str
) -> Fault:
    """Create a fault that strikes a command with two workers at random moments."""

    def trials(bench: Bench, rng: np.random.Generator) -> Trials:
        for seconds in rng.uniform(0, 4, MOMENTS if bench.command.workers else 0):
            yield f"after {seconds:.3f} s with two workers", partial(trial, bench, seconds)

    def trial(bench: Bench, seconds: float) -> Iterator[str]:
        running = bench.start(workers=2)
        wait_for_workers(running)
        if not running.wait(seconds):
            strike(running.leader)
        yield from bench.problems(running.end(), partial(ended_or, expected))

    return Fault(promise, trials)


def workers_of(leader: int) -> list[int]:
    """List the workers of a command, without loky's tracker of resources."""
    found = []
    for process in members(leader):
        with open(f"/proc/{process}/cmdline", "rb") as file:
            if process != leader and b"resource_tracker" not in file.read():
                found.append(process)
    return found


def wait_for_workers(running: Running) -> None:
    """Wait until a command has a worker, or has ended."""
    while not running.wait(0.02) and not workers_of(running.leader):
        pass


def _kill_worker(leader: int) -> None:
    if found := workers_of(leader):
        os.kill(max(found), signal.SIGKILL)


def _lost_machine(bench: Bench, rng: np.random.Generator) -> Trials:
    """Kill one of the two machines of a Ray cluster at a random moment."""

    def trial(cluster: RayCluster, seconds: float) -> Iterator[str]:
        cluster.refill()
        running = bench.start_anew("--backend", "ray", "--address", cluster.address)
        if not running.wait(seconds):
            cluster.lose()
        ended = running.end()
        if ended.code != 0:
            yield "the command did not end"
        yield from bench.problems(ended, lambda ended: None)

    if bench.command.cluster and ray_nodes.is_available():
        with ray_nodes.ray_cluster() as cluster:
            for seconds in rng.uniform(1, 5, MOMENTS):
                yield f"after {seconds:.3f} s", partial(trial, cluster, seconds)


def _little_memory(bench: Bench, rng: np.random.Generator) -> Trials:
    """Limit the address space to little more than the process has.

    With less than 4 MiB Python itself may wait forever for a thread that could not begin.
    """

    def trial(megabytes: int) -> Iterator[str]:
        ended = bench.start(partial(limit_memory, megabytes * 2**20)).end()
        yield from bench.problems(ended, partial(refused, named=""))

    for megabytes in () if bench.command.serves else (4, 8, 16, 32, 64, 128, 256):
        yield f"{megabytes} MiB", partial(trial, megabytes)


FAULTS = {
    "kill -9": at_each_change("kill", partial(killed, signal.SIGKILL)),
    "kill -9 within a write": within_a_write(is_kill=True),
    "SIGTERM": at_each_change("terminate", partial(stopped, code=143)),
    "Ctrl-C": at_each_change("interrupt", stopped),
    "disk full": at_each_change("full", refused),
    "disk full within a write": within_a_write(is_kill=False),
    "small disk": Fault(ONE_LINE, _small_disk),
    "disk turned read-only": at_each_change("readonly", refused),
    "folder of another user": Fault("one line with the path, nothing is written", _other_user),
    "two processes": Fault("one ends, the other too or refuses in one line", _two_processes),
    "worker killed": at_a_moment(_kill_worker, partial(refused, named="worker"), KEPT),
    "machine of a cluster lost": Fault(
        "its jobs are repeated on another one: the command ends with the same files", _lost_machine
    ),
    "Ctrl-C with workers": at_a_moment(
        lambda leader: os.killpg(leader, signal.SIGINT), stopped, f"{KEPT}, no process is left"
    ),
    "kill -9 with workers": at_a_moment(
        lambda leader: os.kill(leader, signal.SIGKILL),
        partial(killed, signal.SIGKILL),
        f"{KEPT}, no process is left",
    ),
    "memory limit": Fault("one line; nothing is lost, the same command resumes", _little_memory),
}
"""The faults by name, in the order of the table."""
