"""Means with their uncertainty: 95% bootstrap intervals (DESIGN: the environment)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95% bootstrap interval; without an interval where the sample is one task."""

    mean: float
    low: float | None
    high: float | None

    @classmethod
    def of(cls, sample: npt.ArrayLike) -> Estimate:
        values = np.asarray(sample, dtype=float)
        mean = float(values.mean())
        if len(values) < 2:
            return cls(mean, None, None)
        if np.ptp(values) == 0:
            return cls(mean, mean, mean)
        from scipy import stats  # takes half a second to import: not for everyone who plays

        interval = stats.bootstrap(
            (values,),
            np.mean,
            confidence_level=CONFIDENCE,
            n_resamples=RESAMPLES,
            method="percentile",
            rng=np.random.default_rng(0),
        ).confidence_interval
        return cls(mean, float(interval.low), float(interval.high))


def told(estimate: Estimate, spec: str) -> str:
    """A mean with its interval in brackets, as text."""
    mean = format(estimate.mean, spec)
    if estimate.low is None or estimate.high is None:
        return mean
    return f"{mean} ({format(estimate.low, spec)} to {format(estimate.high, spec)})"


@dataclass(frozen=True)
class Comparison:
    """One sample against another, pair by pair.

    pairs: how many. difference: of the first from the second. ratio: of the two means, with the
    interval over resampled pairs. wins, ties, losses: pairs in which the first is more, equal (but
    for rounding), or less.
    """

    pairs: int
    difference: Estimate
    ratio: Estimate
    wins: int
    ties: int
    losses: int

    @classmethod
    def of(cls, first: Sequence[float], second: Sequence[float], slack: float) -> Comparison:
        """slack: differences up to it are rounding."""
        a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
        difference = a - b
        return cls(
            len(a),
            Estimate.of(difference),
            _ratio(a, b),
            int((difference > slack).sum()),
            int((np.abs(difference) <= slack).sum()),
            int((difference < -slack).sum()),
        )


def _ratio(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> Estimate:
    """Of means; not a number where the second is 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = float(np.divide(a.mean(), b.mean()))
        if len(a) < 2 or not np.isfinite(ratio):
            return Estimate(ratio, None, None)
        drawn = np.random.default_rng(0).integers(len(a), size=(RESAMPLES, len(a)))
        ratios = a[drawn].mean(axis=1) / b[drawn].mean(axis=1)
    tail = 100 * (1 - CONFIDENCE) / 2
    low, high = np.percentile(ratios, (tail, 100 - tail))
    return Estimate(ratio, float(low), float(high))
