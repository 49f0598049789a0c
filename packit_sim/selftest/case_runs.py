"""Runs of `packit selftest`: cases until the time is over."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path

from packit_sim.core.files import claimed, lock_path, remove_unfinished, replace_text
from packit_sim.core.parallel import Workers
from packit_sim.selftest import volumes
from packit_sim.selftest.cases import draw_case, kind_of
from packit_sim.selftest.comparisons import CHECKS, differences
from packit_sim.selftest.reduction import reduced
from packit_sim.selftest.replays import replay_text
from packit_sim.selftest.tally import Difference, Tally
from packit_sim.selftest.totals import CaseOutcome, Totals

CHECKPOINT_SECONDS = 30.0
"""Time between two writings of the totals."""


def run(seed: int, minutes: float, workers: Workers, file: Path | None = None) -> Iterator[Totals]:
    """Compare cases until the time is over, and add them to the totals of a file.

    Parameters
    ----------
    seed : int
        The seed of the cases; a run continues with the first case that the file does not contain.
    minutes : float
        The time during which new cases are started.
    workers : Workers
        The processes.
    file : Path, optional
        The file of the totals. It is written every 30 seconds, and at the end, also after an error.

    Yields
    ------
    Totals
        The totals of the file, or of this run if there is no file, after each case.

    Raises
    ------
    SelftestError
        If the run can't be added to the file.
    BusyError
        If another run writes the file.
    """
    with ExitStack() as stack:
        if file is not None:
            stack.enter_context(claimed(lock_path(file), file))
            remove_unfinished(file)
        totals = Totals.begin(file, volumes.is_available())
        if file is not None:
            stack.callback(totals.write, file)
        earlier, written = totals.seconds, time.monotonic()
        start = written
        numbers = _numbers(totals.next_case(seed), start + 60 * minutes)
        for outcome in workers.as_done(run_case, ((seed, number) for number in numbers)):
            totals.add(seed, outcome, _write_replay(seed, outcome, file))
            totals.seconds = earlier + time.monotonic() - start
            if file is not None and time.monotonic() > written + CHECKPOINT_SECONDS:
                totals.write(file)
                written = time.monotonic()
            yield totals


def run_case(seed: int, number: int) -> CaseOutcome:
    """Draw a case and make all checks.

    Parameters
    ----------
    seed : int
        The seed of the run.
    number : int
        The number of the case.

    Returns
    -------
    CaseOutcome
        The counts of the comparisons; with a difference also the reduced case.
    """
    start = time.process_time()
    tally, replay = Tally(), None
    tally.counts["cases"] = 1
    try:
        case = draw_case(seed, number)
    except Exception as error:  # the engine failed while the box was filled
        tally.differences.append(Difference("filling", f"{type(error).__name__}: {error}"))
        failing = []
    else:
        failing = [name for name in CHECKS if differences(case, name, tally)]
    seconds = time.process_time() - start
    if failing:
        replay = replay_text(failing[0], reduced(case, failing[0]))
    return CaseOutcome(
        number, kind_of(number), dict(tally.counts), seconds, tally.differences, replay
    )


def _numbers(first: int, deadline: float) -> Iterator[int]:
    """Generate the numbers of cases until the time is over; at least one."""
    for number in count(first):
        yield number
        if time.monotonic() >= deadline:
            return


def _write_replay(seed: int, outcome: CaseOutcome, file: Path | None) -> str:
    """Write the reduced case of an outcome, and return the name of its file; "" without one."""
    if outcome.replay is None:
        return ""
    folder = file.parent if file else Path()
    path = folder / f"selftest-{seed}-{outcome.number}.json"
    replace_text(path, outcome.replay)
    return path.name
