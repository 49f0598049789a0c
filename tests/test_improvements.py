"""Searches record when they found something better, and one run gives the whole curve."""

from dataclasses import replace
from itertools import count, pairwise

import pytest
from msgspec import structs

from packit_sim import compare, evaluate, load_tasks, read_results
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.provenance import Improvement
from packit_sim.game.datasets.result_checks import result_problems
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.paper.portfolio import divided
from tests.runs import packit

RULE = "largest-first/aligned/blbf"


@pytest.fixture(scope="module")
def tasks():
    return load_tasks("starter")[:2]


@pytest.fixture(scope="module")
def searched(tasks) -> list[Rollout]:
    return evaluate([f"{RULE}+lns=12"], tasks, seed=1)


def with_steps(rollout: Rollout, *steps: tuple[float, float], **changes) -> Rollout:
    steps = tuple(Improvement(*step) for step in steps)
    played = structs.replace(rollout.played, improvements=steps, **changes)
    return Rollout(replace(rollout.pack, provenance=played))


@pytest.mark.parametrize("search", ["lns=12", "mcts=8", "beam=3", "beam=0.3s", "backtrack=4"])
def test_each_improvement_is_later_and_better_up_to_the_return(search, tasks, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    for rollout in evaluate([f"{RULE}+{search}"], tasks, seed=1, file=file):
        steps = rollout.played.improvements
        assert steps[-1].total == rollout.total
        assert all(a.seconds <= b.seconds and a.total < b.total for a, b in pairwise(steps))
        assert 0 <= steps[0].seconds <= steps[-1].seconds <= rollout.seconds + 1e-3
        assert not list(result_problems(rollout.pack, rollout.played))
    read = read_results(file)
    assert [each.played.improvements[-1].total for each in read] == [each.total for each in read]


def test_an_agent_without_a_search_reaches_its_return_when_it_is_over(tasks) -> None:
    (rollout,) = evaluate([RULE], tasks[:1], seed=0)
    assert rollout.played.improvements == ()
    assert rollout.return_after(rollout.seconds) == rollout.total
    assert rollout.return_after(rollout.seconds * 0.99) == 0


def test_the_return_after_a_time_is_the_best_until_then(searched) -> None:
    rollout = with_steps(searched[0], (0.5, 0.3), (2.0, 0.6), (2.5, 0.7), total=0.7)
    found = [rollout.return_after(seconds) for seconds in (0.4, 0.5, 1.9, 2.4, 60)]
    assert found == [0, 0.3, 0.3, 0.6, 0.7]


def test_agents_that_divide_the_time_have_their_share_of_it(searched) -> None:
    quick = [with_steps(each, (1.0, 0.5)) for each in searched]
    slow = [with_steps(searched[0], (2.0, 0.4), (3.0, 0.9))]
    assert divided([quick, slow], 1.9) == [0.0]
    assert divided([quick, slow], 5.9) == [0.5]
    assert divided([quick, slow], 6.0) == [0.9]
    assert divided([quick], 1.0) == [0.5, 0.5]
    with pytest.raises(ArgumentError, match="no task that all"):
        divided([quick[1:], slow], 1.0)


def test_agents_are_compared_after_so_many_seconds(searched) -> None:
    steady = [with_steps(searched[0], (1.0, 0.5), (9.0, 0.6), total=0.6)]
    late = [with_steps(searched[0], (2.0, 0.4), (3.0, 0.9), total=0.9)]
    after = {seconds: compare(steady, late, seconds).difference.mean for seconds in (0.5, 2, 3, 9)}
    assert after == pytest.approx({0.5: 0, 2: 0.1, 3: -0.4, 9: -0.3})
    assert compare(steady, late).difference.mean == pytest.approx(-0.3)


def test_the_command_compares_after_so_many_seconds(tasks, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    evaluate([RULE, f"{RULE}+lns=12"], tasks, seed=1, file=file)
    assert "0.000" not in packit("compare", file)
    assert "0.000" in packit("compare", file, "--seconds", 0)


def test_results_are_equal_if_they_differ_only_in_time(searched) -> None:
    first = searched[0]
    steps = first.played.improvements
    later = with_steps(first, *((each.seconds + 1, each.total) for each in steps))
    assert first == later
    assert first != with_steps(first, *steps[:-1], (steps[-1].seconds, steps[-1].total / 2))


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (((1.0, 0.5), (0.5, None)), "not each later and better"),
        (((1.0, None), (2.0, None)), "not each later and better"),
        (((1.0, 0.01),), "its last improvement has 0.01"),
    ],
)
def test_improvements_that_contradict_the_result_are_found(steps, message, searched) -> None:
    total = searched[0].total
    forged = with_steps(
        searched[0], *((s, total if value is None else value) for s, value in steps)
    )
    (problem,) = result_problems(forged.pack, forged.played)
    assert message in problem


def test_beams_with_a_time_go_on_with_twice_as_many(tasks, monkeypatch) -> None:
    (two,) = evaluate([f"{RULE}+beam=2"], tasks[:1], seed=0)
    looks = count()
    monkeypatch.setattr("packit_agents.planning.budgets.time.thread_time", lambda: next(looks))
    totals = [
        evaluate([f"{RULE}+beam={seconds}s"], tasks[:1], seed=0)[0].total for seconds in (1, 200)
    ]
    assert totals[0] <= two.total <= totals[1]
    assert next(looks) < 250  # looks at the clock, one for each choice of a beam
