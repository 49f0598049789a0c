"""Methods that were trained several times: their means, and intervals over runs and tasks."""

from dataclasses import replace

import numpy as np
import pytest

from packit_sim.core.errors import ArgumentError
from packit_sim.game.evaluation import training_runs
from packit_sim.game.evaluation.training_runs import score_runs
from tests.runs import packit, results, rollout


def run(*totals: float) -> list:
    """The results of a run with these returns, on tasks that are counted up."""
    whole = rollout("a/b/c", 0, 3)
    return [
        replace(
            whole,
            pack=replace(
                whole.pack,
                provenance=type(whole.played)(
                    agent="a/b/c", task=n, task_digest=f"{n}", seed=0, total=total, end="no room"
                ),
            ),
        )
        for n, total in enumerate(totals)
    ]


def test_means_are_over_runs_and_tasks() -> None:
    first, second = score_runs(
        {"first": [run(0.1, 0.2, 0.3, 0.4)], "second": [run(0.2, 0.3, 0.4, 0.5), run(0, 0, 1, 1)]}
    )
    assert (first.runs, first.tasks, second.runs) == (1, 4, 2)
    assert first.mean.mean == pytest.approx(0.25) == first.iqm.mean
    assert second.iqm.mean == pytest.approx((0.2 + 0.3 + 0.4 + 0.5) / 4)
    assert (second.worst, second.best) == pytest.approx((0.35, 0.5))
    assert first.difference.mean == first.difference.low == 0
    assert second.difference.mean == pytest.approx(0.425 - 0.25)
    assert first.mean.low < 0.25 < first.mean.high


def test_runs_that_differ_make_an_interval_wider_than_tasks_alone() -> None:
    tasks = np.linspace(0.3, 0.5, 100)
    same = score_runs({"a": [run(*tasks), run(*tasks)]})[0].mean
    apart = score_runs({"a": [run(*tasks - 0.2), run(*tasks + 0.2)]})[0].mean
    assert same.mean == pytest.approx(apart.mean)
    assert apart.high - apart.low > 5 * (same.high - same.low)


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_intervals_hold_the_truth_about_as_often_as_they_say(count, monkeypatch) -> None:
    """Of 20 draws of 10 runs, 95% of the intervals should hold the true mean."""
    monkeypatch.setattr(training_runs, "RESAMPLES", 100)
    rng, held = np.random.default_rng(count), 0
    for _ in range(20):
        own = rng.normal(0.5, 0.05, size=(10, 1)) + rng.normal(0, 0.1, size=(10, count))
        means, _ = training_runs._resampled([own])[0]
        low, high = np.quantile(means, [0.025, 0.975])
        held += low < 0.5 < high
    assert held >= 16


def test_runs_without_a_shared_task_are_refused() -> None:
    other = run(0.5)[0]
    other = replace(
        other, pack=replace(other.pack, provenance=replace_digest(other.played, "other"))
    )
    with pytest.raises(ArgumentError, match="no task that all runs have played"):
        score_runs({"a": [run(0.5)], "b": [[other]]})
    with pytest.raises(ArgumentError, match="'a' has no run"):
        score_runs({"a": []})


def replace_digest(played, digest):
    return type(played)(
        agent=played.agent, task=0, task_digest=digest, seed=0, total=0.5, end="no room"
    )


def test_compare_groups_agents_by_patterns(tmp_path) -> None:
    one = results(tmp_path / "one.jsonl", {"seed-0/x/y": (9, 5), "seed-1/x/y": (7, 4)})
    two = results(tmp_path / "two.jsonl", {"seed-0/x/y": (8, 6), "largest/x/y": (9, 9)})
    printed = packit("compare", one, two, "--runs", "seed-*", "--runs", "largest/*")
    lines = [line.split() for line in printed.splitlines()]
    assert ["1", "seed-*"] in lines and ["2", "largest/*"] in lines
    assert [line[:3] for line in lines if line[:1] in (["1"], ["2"])][2:4] == [
        ["1", "3", "2"],
        ["2", "1", "2"],
    ]
    with pytest.raises(ArgumentError, match="matches no agent: the results have seed-0/x/y, seed"):
        packit("compare", one, "--runs", "smallest*")
    with pytest.raises(ArgumentError, match="--seconds has no effect with --runs"):
        packit("compare", one, "--runs", "seed-*", "--seconds", 1)
