"""Exactly-n problems for a SAT solver, in a process of its own that ends in time."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import TimeoutError as OutOfTimeError

from pebble import ProcessPool

from packit_sim.core.extras import needed_for
from packit_sim.core.orphans import end_with, without_interrupts

SOLVER = "cadical195"
"""CaDiCaL 1.9.5 (Biere et al.), by its name in PySAT. It has no time limit of its own."""

MAX_PAIRWISE = 5
"""Variables of which one is chosen, up to which all pairs are excluded one by one."""

OneOf = tuple[Sequence[int], int]
"""Variables, numbered from 1, and how many of them are true."""


def solve(wanted: Sequence[OneOf], variables: int, seconds: float) -> list[int] | None:
    """Find values of variables of which given numbers are true.

    Parameters
    ----------
    wanted : Sequence
        Groups of variables, and how many of each are true.
    variables : int
        The number of variables.
    seconds : float
        The time limit, without the start of the process.

    Returns
    -------
    list of int or None
        The variables that are true; None if there is no solution.

    Raises
    ------
    concurrent.futures.TimeoutError
        If the time is over.
    MissingPackageError
        If python-sat is not installed.
    """
    with needed_for("exact covers with polycubes"):
        import pysat.solvers  # noqa: F401 # the process needs it
    with ProcessPool(
        1,
        context=multiprocessing.get_context("spawn"),  # type: ignore[arg-type,unused-ignore]
        initializer=end_with,
        initargs=(os.getpid(),),
    ) as pool:
        with without_interrupts():
            future = pool.schedule(_solve, args=(wanted, variables), timeout=seconds)
        try:
            found: list[int] | None = future.result()
        except BaseException:
            pool.stop()
            raise
    return found


def _solve(wanted: Sequence[OneOf], variables: int) -> list[int] | None:
    from pysat.card import CardEnc, EncType
    from pysat.solvers import Solver

    with Solver(name=SOLVER) as solver:
        top = variables
        for names, count in wanted:
            encoding = EncType.seqcounter if count > 1 else EncType.ladder
            if count == 1 and len(names) <= MAX_PAIRWISE:
                encoding = EncType.pairwise
            clauses = CardEnc.equals(list(names), count, top_id=top, encoding=encoding)
            top = max(top, clauses.nv)
            solver.append_formula(clauses.clauses)
        if not solver.solve():
            return None
        return [name for name in solver.get_model() if 0 < name <= variables]


__all__ = ["OutOfTimeError", "solve"]
