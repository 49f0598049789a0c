"""The counts of one case: comparisons by name, and the differences found."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from packit_sim.placement import Mask


@dataclass(frozen=True)
class Difference:
    """Two answers that should be equal and are not.

    Attributes
    ----------
    check : str
        The name of the check.
    message : str
        A description of the difference.
    """

    check: str
    message: str


@dataclass
class Tally:
    """The counts of a case.

    Attributes
    ----------
    counts : Counter of str
        The number of comparisons by name.
    differences : list of Difference
        The differences found.
    """

    counts: Counter[str] = field(default_factory=Counter)
    differences: list[Difference] = field(default_factory=list)

    def compare_masks(self, name: str, found: Mask, expected: Mask) -> None:
        """Count a mask and its locations, and compare it at all of them."""
        self.counts[name] += 1
        if found.shape != expected.shape:
            message = f"masks of {found.shape} and {expected.shape}"
            self.differences.append(Difference(name, message))
            return
        wrong = np.argwhere(found != expected)
        if len(wrong):
            first = tuple(wrong[0].tolist())
            message = f"{len(wrong)} locations, the first is {first}: {found[first]}"
            self.differences.append(Difference(name, message))

    def compare(self, name: str, found: object, expected: object, where: object = "") -> None:
        """Count a comparison of two answers."""
        self.counts[name] += 1
        if found != expected:
            self.differences.append(
                Difference(name, f"{where}: {found}, not {expected}".lstrip(": "))
            )
