"""Results of one method over several training runs: means with intervals over runs and tasks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.confidence import CONFIDENCE, RESAMPLES, Estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.game.evaluation.results import Rollout

_TRIMMED = 0.25
"""Share of the returns that the interquartile mean leaves out at each end."""


@dataclass(frozen=True)
class RunsScore:
    """The returns of a method that was trained several times, such as with several seeds.

    Attributes
    ----------
    runs : int
        The number of its runs.
    tasks : int
        The number of tasks that every run of every method has played.
    mean : Estimate
        The mean return.
    iqm : Estimate
        The interquartile mean: that of the middle half of the returns of all runs on all tasks.
    worst, best : float
        The mean returns of its worst and of its best run.
    difference : Estimate
        The mean return minus that of the first method.

    Notes
    -----
    Intervals are percentiles of a bootstrap that draws tasks, the same ones for all methods, and
    runs, for each method separately: they say what other seeds and other tasks would give. With a
    single run nothing is known of other seeds, and the interval is over tasks alone. The
    interquartile mean and the view that runs are a sample are those of Agarwal et al., *Deep
    Reinforcement Learning at the Edge of the Statistical Precipice*, NeurIPS 2021.

    Examples
    --------
    >>> from packit_sim import RunsScore, evaluate, load_tasks, score_runs
    >>> tasks = load_tasks("starter")[:3]
    >>> seeds = [evaluate(["random/aligned/blbf"], tasks, seed=seed) for seed in range(3)]
    >>> (score,) = score_runs({"random": seeds})
    >>> isinstance(score, RunsScore), score.worst < score.mean.mean < score.best
    (True, True)
    """

    name: str
    runs: int
    tasks: int
    mean: Estimate
    iqm: Estimate
    worst: float
    best: float
    difference: Estimate


def score_runs(methods: Mapping[str, Sequence[Iterable[Rollout]]]) -> list[RunsScore]:
    """Score methods by the results of their runs.

    Parameters
    ----------
    methods : mapping
        The rollouts of each run, by the name of the method.

    Returns
    -------
    list of RunsScore
        The scores, in the order of the methods.

    Raises
    ------
    ArgumentError
        If a method has no run, or there is no task that all runs have played.

    Examples
    --------
    >>> from packit_sim import evaluate, load_tasks, score_runs
    >>> tasks = load_tasks("starter")[:3]
    >>> agents = "random/aligned/blbf", "largest-first/aligned/blbf"
    >>> runs = {name: [evaluate([name], tasks, seed=seed) for seed in (0, 1)] for name in agents}
    >>> random, largest = score_runs(runs)
    >>> random.runs, random.tasks, round(largest.difference.mean, 2)
    (2, 3, 0.18)
    """
    played = {
        name: [{one.task_digest: one.total for one in rollouts} for rollouts in runs]
        for name, runs in methods.items()
    }
    for name, runs in played.items():
        if not runs:
            raise ArgumentError(f"{name!r} has no run")
    everyone = [run for runs in played.values() for run in runs]
    shared = [digest for digest in everyone[0] if all(digest in run for run in everyone)]
    if not shared:
        raise ArgumentError("there is no task that all runs have played")
    returns = [np.array([[run[d] for d in shared] for run in runs]) for runs in played.values()]
    drawn = _resampled(returns)
    first = returns[0].mean()
    return [
        RunsScore(
            name,
            own.shape[0],
            own.shape[1],
            _estimate(own.mean(), means),
            _estimate(float(_interquartile(own.ravel())), middles),
            float(own.mean(axis=1).min()),
            float(own.mean(axis=1).max()),
            _estimate(own.mean() - first, means - drawn[0][0]),
        )
        for name, own, (means, middles) in zip(played, returns, drawn, strict=True)
    ]


_Floats = npt.NDArray[np.float64]


def _resampled(returns: Sequence[_Floats]) -> list[tuple[_Floats, _Floats]]:
    """Draw runs and tasks; return the means and the interquartile means of each method."""
    rng = np.random.default_rng(0)
    tasks = returns[0].shape[1]
    found = [(np.empty(RESAMPLES), np.empty(RESAMPLES)) for _ in returns]
    for n in range(RESAMPLES):
        columns = rng.integers(tasks, size=tasks)
        for own, (means, middles) in zip(returns, found, strict=True):
            rows = rng.integers(len(own), size=len(own))
            drawn = own[np.ix_(rows, columns)].ravel()
            means[n], middles[n] = drawn.mean(), _interquartile(drawn)
    return found


def _interquartile(values: _Floats) -> np.float64:
    cut = int(_TRIMMED * len(values))
    middle: np.float64 = np.sort(values)[cut : len(values) - cut].mean()
    return middle


def _estimate(value: float, drawn: _Floats) -> Estimate:
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]).tolist()
    return Estimate(float(value), low, high)
