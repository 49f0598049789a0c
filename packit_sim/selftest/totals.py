"""Totals of `packit selftest` over all runs of a file: comparisons and differences."""

from __future__ import annotations

import json
import os
import platform
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from packit_sim.core import typed_json
from packit_sim.core.errors import PackItError, located
from packit_sim.core.files import read_whole, replace_text
from packit_sim.core.version import __version__
from packit_sim.selftest.tally import Difference


class SelftestError(PackItError, ValueError):
    """A file of `packit selftest` that can't be read, or to which a run can't be added."""


@dataclass
class KindTotals:
    """The comparisons for one kind of items.

    Attributes
    ----------
    counts : dict of str to int
        Numbers of cases, masks, locations and other comparisons by name.
    differences : int
        Comparisons with two answers.
    core_seconds : float
        Processor time.
    """

    counts: dict[str, int] = field(default_factory=dict)
    differences: int = 0
    core_seconds: float = 0.0


@dataclass(frozen=True)
class FoundDifference:
    """A difference, and the case in which it was found.

    Attributes
    ----------
    seed, number : int
        The seed of the run and the number of the case.
    check : str
        The name of the check.
    message : str
        A description of the difference.
    replay : str
        The name of the file with the reduced case, in the folder of the totals.
    """

    seed: int
    number: int
    check: str
    message: str
    replay: str


@dataclass(frozen=True)
class CaseOutcome:
    """The counts of one case.

    Attributes
    ----------
    number : int
        The number of the case.
    kind : str
        The kind of its items.
    counts : dict of str to int
        Comparisons by name.
    core_seconds : float
        Processor time.
    replay : str, optional
        The reduced case as JSON, if there are differences.
    """

    number: int
    kind: str
    counts: dict[str, int]
    core_seconds: float
    differences: list[Difference]
    replay: str | None


@dataclass
class Totals:
    """The totals of all runs that were added to a file.

    Attributes
    ----------
    format : int
        The version of this format.
    version : str
        The version of PackIt-Sim that was tested.
    machine : str
        The system, the processor architecture, its cores and the version of Python.
    volumes : bool
        Whether boolean volumes were compared.
    seeds : dict of str to int
        The number of the next case by the seed of the run.
    seconds : float
        Wall time of all runs.
    kinds : dict of str to KindTotals
        The comparisons by the kind of items.
    """

    format: Literal[1] = 1
    version: str = __version__
    machine: str = ""
    volumes: bool = False
    seeds: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    kinds: dict[str, KindTotals] = field(default_factory=dict)
    differences: list[FoundDifference] = field(default_factory=list)

    @classmethod
    def begin(cls, file: Path | None, volumes: bool) -> Totals:
        """Read the totals of a file, or create new ones if there is none.

        Parameters
        ----------
        file : Path or None
            The file of the totals.
        volumes : bool
            Whether boolean volumes are compared.

        Returns
        -------
        Totals
            Totals to which a run can be added.

        Raises
        ------
        SelftestError
            If the file is no such file, or of another version or machine.
        """
        machine = (
            f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, "
            f"Python {platform.python_version()}"
        )
        new = cls(machine=machine, volumes=volumes)
        if file is None or not file.exists():
            return new
        old = cls.read(file)
        for name in ("version", "machine", "volumes"):
            was, now = getattr(old, name), getattr(new, name)
            if was != now:
                raise SelftestError(
                    f"{file}: its totals are of {name} {was!r}, this run would be of {now!r}: "
                    "choose another --out"
                )
        return old

    @classmethod
    def read(cls, file: Path) -> Totals:
        """Read the totals of a file. Raises SelftestError if it is no such file."""
        with located(file, SelftestError):
            return typed_json.decode(read_whole(file), cls, SelftestError, "the totals")

    def add(self, seed: int, outcome: CaseOutcome, replay: str) -> None:
        """Add what a case counted."""
        kind = self.kinds.setdefault(outcome.kind, KindTotals())
        kind.counts = dict(Counter(kind.counts) + Counter(outcome.counts))
        kind.differences += len(outcome.differences)
        kind.core_seconds += outcome.core_seconds
        self.seeds[str(seed)] = max(self.next_case(seed), outcome.number + 1)
        self.differences += [
            FoundDifference(seed, outcome.number, found.check, found.message, replay)
            for found in outcome.differences
        ]

    def next_case(self, seed: int) -> int:
        """Return the number of the first case that is not done yet."""
        return self.seeds.get(str(seed), 0)

    def count(self, name: str) -> int:
        """Return a count over all kinds."""
        return sum(kind.counts.get(name, 0) for kind in self.kinds.values())

    def write(self, file: Path) -> None:
        """Write the file, whole or not at all."""
        replace_text(file, json.dumps(asdict(self), indent=1) + "\n")
