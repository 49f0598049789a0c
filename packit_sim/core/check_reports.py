"""Reports of checks of files: how much was checked, and all problems."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FileProblem:
    """A problem of a checked file.

    Attributes
    ----------
    pack : int or None
        The number of the pack in the file, from 0 as `read_packs` counts; None for a problem of the
        whole file.
    sentence : str
        A description of the problem; it names the item if it concerns one.
    """

    file: Path
    pack: int | None
    sentence: str

    def __str__(self) -> str:
        where = f"{self.file}" if self.pack is None else f"{self.file}, pack {self.pack}"
        return f"{where}: {self.sentence}"


@dataclass(frozen=True)
class Report:
    """The result of a check: how much was checked, and all problems.

    Attributes
    ----------
    packs : int
        The number of packs, including unreadable ones.
    items : int
        The number of items of the readable packs.
    volume : float
        The volume of the items whose shapes could be loaded, in box units cubed, or in the unit of
        a packing's file cubed.
    space : float
        The volume of their boxes, in the same unit.
    settled : int
        The number of items off the grid. Whether these overlap or rest is not judged.
    unjudged_returns : int
        The number of results whose task is neither recorded nor built in: their return can't be
        computed. Former versions did not record the items that an agent left outside.
    unchecked : tuple of str
        What was not checked of a packing, since the file does not say what was asked for, or since
        it can't be checked.
    linked : str
        The linked pairs of a packing of parts by their names, or "none"; empty where they were not
        looked for.
    """

    problems: tuple[FileProblem, ...]
    files: int
    packs: int
    items: int
    volume: float
    space: float
    settled: int = 0
    unjudged_returns: int = 0
    unchecked: tuple[str, ...] = ()
    linked: str = ""

    @property
    def is_valid(self) -> bool:
        """True if there is no problem."""
        return not self.problems

    @property
    def not_judged(self) -> str:
        """A sentence that says what could not be checked; empty if everything was."""
        sentences = []
        if self.settled:
            sentences.append(
                f"not judged, of {self.settled} items that settled off the grid: whether they "
                "overlap, and whether they rest where they are"
            )
        if self.unjudged_returns:
            sentences.append(
                f"not judged, of {self.unjudged_returns} results of former versions: their "
                "returns, because the items of their tasks are not recorded"
            )
        if self.unchecked:
            sentences.append(f"not checked: {', '.join(self.unchecked)}")
        return "; ".join(sentences)

    @property
    def broken(self) -> int:
        """The number of packs with a problem."""
        return len({(p.file, p.pack) for p in self.problems if p.pack is not None})

    @property
    def density(self) -> float:
        """The volume over the space: the mean density if all boxes have the same size."""
        return self.volume / self.space if self.space else 0.0


def named(number: int, name: str) -> str:
    """Name an item in a problem."""
    return f"item {number} ({name!r})"
