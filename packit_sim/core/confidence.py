"""Means with their uncertainty: 95% bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

CONFIDENCE = 0.95
RESAMPLES = 2000

_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95% bootstrap interval.

    Attributes
    ----------
    mean : float
        The mean of the sample.
    low, high : float or None
        The ends of the interval; None if the sample has a single value.
    """

    mean: float
    low: float | None
    high: float | None

    @classmethod
    def of(cls, sample: npt.ArrayLike) -> Estimate:
        """Estimate the mean of a sample of one value or more."""
        values = np.asarray(sample, dtype=float)
        mean = float(values.mean())
        if len(values) < 2:
            return cls(mean, None, None)
        if np.ptp(values) == 0:
            return cls(mean, mean, mean)
        return cls(mean, *_interval((values,), np.mean))


def format_estimate(estimate: Estimate, spec: str) -> str:
    """Format a mean with its interval in brackets, all by the same format specification."""
    mean = format(estimate.mean, spec)
    if estimate.low is None or estimate.high is None:
        return mean
    return f"{mean} ({format(estimate.low, spec)} to {format(estimate.high, spec)})"


@dataclass(frozen=True)
class Comparison:
    """A comparison of two samples, pair by pair.

    Attributes
    ----------
    difference : Estimate
        The mean of first minus second.
    ratio : Estimate
        The ratio of the two means, with the interval over resampled pairs.
    wins, ties, losses : int
        The pairs in which the first is larger, equal up to rounding, or smaller.
    """

    pairs: int
    difference: Estimate
    ratio: Estimate
    wins: int
    ties: int
    losses: int

    @classmethod
    def of(cls, first: Sequence[float], second: Sequence[float], tolerance: float) -> Comparison:
        """Compare two samples of the same length; differences up to `tolerance` are ties."""
        a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
        difference = a - b
        return cls(
            len(a),
            Estimate.of(difference),
            _ratio(a, b),
            int((difference > tolerance).sum()),
            int((np.abs(difference) <= tolerance).sum()),
            int((difference < -tolerance).sum()),
        )


def _ratio(a: _Floats, b: _Floats) -> Estimate:
    """Estimate the ratio of two means; it is not finite if the second is 0.

    It has no interval if the second is 0, or is 0 for some of the resampled pairs.
    """
    is_finite = True

    def ratio(a: _Floats, b: _Floats, axis: int) -> _Floats:
        nonlocal is_finite
        ratios = np.divide(a.mean(axis=axis), b.mean(axis=axis))
        is_finite &= bool(np.isfinite(ratios).all())
        return np.nan_to_num(ratios, posinf=0.0)

    with np.errstate(invalid="ignore", divide="ignore"):
        mean = float(np.divide(a.mean(), b.mean()))
        if len(a) < 2 or not np.isfinite(mean):
            return Estimate(mean, None, None)
        low, high = _interval((a, b), ratio)
        return Estimate(mean, low, high) if is_finite else Estimate(mean, None, None)


def _interval(samples: tuple[_Floats, ...], statistic: Callable[..., Any]) -> tuple[float, float]:
    """Compute the percentile bootstrap interval of a statistic of paired samples."""
    from scipy import stats  # takes half a second to import, and playing does not need it

    interval = stats.bootstrap(
        samples,
        statistic,
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        paired=True,
        vectorized=True,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)
