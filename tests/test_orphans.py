"""Worker processes end with their block, and when the process that started them is killed."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from packit_sim.core.orphans import without_interrupts
from packit_sim.core.parallel import Workers

GENERATE = """
from pathlib import Path
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.generation.jobs import GenerationJob, generate
from packit_sim.libraries.library import ShapeLibrary

settings = EvolutionSettings(pool=8, population=100, generations=1000)
job = GenerationJob(ShapeLibrary.open("everyday"), 9, 0, settings=settings)
with Workers(2) as workers:
    generate(job, Path("packs.jsonl"), workers)
"""

WORK = """
import time
from packit_sim.core.parallel import Workers

with Workers(2) as workers:
    {call}
"""

PROGRAMS = {
    "generate": GENERATE,
    "map": WORK.format(call="workers.map(time.sleep, [(60,)] * 2)"),
    "as done": WORK.format(call="list(workers.as_done(time.sleep, [(60,)] * 3))"),
    "idle": WORK.format(call="workers.map(time.sleep, [(0.1,)] * 2); time.sleep(60)"),
}


def children(process: int) -> set[int]:
    """The processes that a process started, and those that they started."""
    found: set[int] = set()
    for file in Path(f"/proc/{process}/task").glob("*/children"):
        for child in map(int, file.read_text().split()):
            found |= {child, *children(child)}
    return found


def is_worker(process: int) -> bool:
    return b"resource_tracker" not in Path(f"/proc/{process}/cmdline").read_bytes()


def is_alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def wait(holds, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name == "idle" else [pytest.mark.slow]) for name in PROGRAMS],
)
def test_workers_end_when_their_parent_is_killed(name, tmp_path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", PROGRAMS[name]], cwd=tmp_path)
    begun: set[int] = set()

    def has_workers() -> bool:
        begun.update(filter(is_worker, children(parent.pid)))
        return len(begun) >= 2

    try:
        assert wait(has_workers, 60) and parent.poll() is None
        time.sleep(1)  # they are at work
        begun |= children(parent.pid)
    finally:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
    try:
        assert wait(lambda: not any(map(is_alive, begun)), 15)
    finally:
        for process in filter(is_alive, begun):
            os.kill(process, signal.SIGKILL)


def test_workers_end_with_their_block() -> None:
    """Otherwise joblib keeps them for five minutes."""
    with Workers(2) as workers:
        started = {*workers.map(os.getpid, [()] * 4), *workers.as_done(os.getpid, [()] * 4)}
        assert os.getpid() not in started
    assert not any(map(is_alive, started))
    with Workers(2) as workers:
        assert not started & set(workers.map(os.getpid, [()] * 2))


STOPPED = """
import os, signal, time
from joblib.externals.loky.process_executor import _ExecutorManagerThread as Manager
from packit_sim.core.parallel import Workers

forget = Manager.flag_executor_shutting_down

def forget_jobs_but_not_a_number(self):
    forget(self)
    self.work_ids_queue.put(9)

if {moment!r} == "before all are handed out":
    Manager.flag_executor_shutting_down = forget_jobs_but_not_a_number

def arguments():
    for n in range(4):
        if n == 1 and {moment!r} == "while they start":
            os.kill(os.getpid(), signal.SIGINT)
        yield (0.2 if n == 0 else 60,)

try:
    with Workers(2) as workers:
        for _ in workers.as_done(time.sleep, arguments()):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60)
except KeyboardInterrupt:
    print("stopped")
"""


@pytest.mark.parametrize(
    "moment",
    [
        "while they start",
        pytest.param("before all are handed out", marks=pytest.mark.slow),
        pytest.param("between two results", marks=pytest.mark.slow),
    ],
)
def test_ctrl_c_stops_workers_without_a_word_of_theirs(moment: str) -> None:
    """On a busy machine joblib's tracker of resources may warn of a lock that is gone already."""
    command = [sys.executable, "-c", STOPPED.format(moment=moment)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    of_tracker = ("resource_tracker", "warnings.warn(")
    said = [line for line in done.stderr.splitlines() if not any(w in line for w in of_tracker)]
    assert (done.returncode, done.stdout, said) == (0, "stopped\n", [])


def test_ctrl_c_waits_for_the_end_of_a_block_whichever_thread_gets_it() -> None:
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()
    seen = []
    try:
        with without_interrupts():
            signal.pthread_kill(other.ident, signal.SIGINT)
            time.sleep(0.5)
            seen.append("the end of the block")
    except KeyboardInterrupt:
        seen.append("Ctrl-C")
    over.set()
    other.join()
    assert seen == ["the end of the block", "Ctrl-C"]


def blocked() -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.slow
def test_workers_leave_ctrl_c_to_the_process_that_started_them() -> None:
    with Workers(2) as workers:
        assert all(workers.map(blocked, [()] * 2))
    assert not blocked()
