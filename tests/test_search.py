"""Searches: tasks with a known tree, and properties on any task."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_agents.planning.budgets import Budget
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.episodes.policy_registry import UnknownPolicyError, load_search
from packit_sim.game.evaluation.evaluation import evaluate, play
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import End, Rules
from tests.test_episode import task_of
from tests.zoo import cube_of

HEURISTIC = "largest-first/aligned/blbf"

TRAP = task_of(cube_of(60), cube_of(52), cube_of(48), cells=(100, 60, 60))
"""The largest goes in alone; the other two fill the box: 52 + 48 = 100."""

LARGEST_ALONE, MIDDLE_ALONE, BOTH_OTHERS = (
    sum(side**3 for side in sides) / (60**3 + 52**3 + 48**3) for sides in ((60,), (52,), (52, 48))
)


def played(task: Task, name: str, seed: int = 0, **rules: bool) -> Episode:
    return play(task, Agent.from_name(name), np.random.default_rng(seed), rules=Rules(**rules))


@pytest.mark.parametrize(
    ("search", "expected"),
    [
        # after 60 neither 52 nor 48 fits; after 52, 60 does not fit, 48 does, and then 60 does not
        ("backtrack=0", LARGEST_ALONE),
        ("backtrack=1", LARGEST_ALONE),
        ("backtrack=2", LARGEST_ALONE),
        ("backtrack=3", BOTH_OTHERS),
        ("backtrack=50", BOTH_OTHERS),
        # by likelihood: 60-52, 60-48, 52-60, 48-60, and only then 52-48
        ("beam=1", LARGEST_ALONE),
        ("beam=2", LARGEST_ALONE),
        ("beam=3", LARGEST_ALONE),
        ("beam=4", LARGEST_ALONE),
        ("beam=5", BOTH_OTHERS),
        # the agent's own order is 60, 52, 48
        ("mcts=1", LARGEST_ALONE),
        ("mcts=20", BOTH_OTHERS),
        ("lns=1", LARGEST_ALONE),
        ("lns=60", BOTH_OTHERS),
    ],
)
def test_the_trap(search, expected) -> None:
    assert played(TRAP, f"{HEURISTIC}+{search}").total == pytest.approx(expected)


def rollouts_of(task: Task, name: str) -> list[tuple[int, float]]:
    seen: list[tuple[int, float]] = []
    episode = Episode(task)
    agent = Agent.from_name(name)
    agent.play(episode, np.random.default_rng(0), lambda *progress: seen.append(progress))
    assert [count for count, _ in seen] == list(range(1, len(seen) + 1))
    assert [best for _, best in seen] == sorted(best for _, best in seen)
    assert seen[-1][1] == episode.total
    return seen


def test_b_backtracks_are_one_rollout_more_and_end_where_every_order_was_tried() -> None:
    for backtracks in range(4):
        assert len(rollouts_of(TRAP, f"{HEURISTIC}+backtrack={backtracks}")) == backtracks + 1
    # 60-52, 60-48; 52-60, 52-48-60; 48-60, 48-52-60
    assert [best for _, best in rollouts_of(TRAP, f"{HEURISTIC}+backtrack=50")] == pytest.approx(
        [LARGEST_ALONE] * 3 + [BOTH_OTHERS] * 3
    )


def test_backtracking_stops_where_everything_is_placed() -> None:
    pair = task_of(cube_of(40), cube_of(20))
    assert rollouts_of(pair, f"{HEURISTIC}+backtrack=8") == [(1, pytest.approx(1))]


def test_tree_search_stops_where_the_tree_is_known() -> None:
    """Of the six orders three leaves are reached a second time, by a rollout that passes over."""
    seen = rollouts_of(TRAP, f"{HEURISTIC}+mcts=1000")
    assert len(seen) < 20 and seen[-1][1] == pytest.approx(BOTH_OTHERS)


def test_tree_search_finds_the_rotation_too() -> None:
    """A pillar that only stands upright in this box; `aligned` lays it down."""
    pillar = Item(Shape.from_mesh(creation.box((0.2, 0.2, 0.9)), "pillar"), 0.9)
    well = task_of(pillar, cells=(24, 24, 100))
    assert played(well, f"{HEURISTIC}+mcts=50").end is End.NO_LOCATION
    assert played(well, f"{HEURISTIC}+mcts=50:shape,rotation").end is End.COMPLETE


def test_rollouts_within_a_time_are_at_least_one() -> None:
    assert len(rollouts_of(TRAP, f"{HEURISTIC}+mcts=0.000001s")) == 1
    assert len(rollouts_of(TRAP, f"{HEURISTIC}+lns=0.000001s")) == 1
    assert played(TRAP, f"{HEURISTIC}+lns=0.5s").total == pytest.approx(BOTH_OTHERS)


@pytest.fixture(scope="module")
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter", ShapeLibrary.open("everyday"))[:4]


SEARCHES = ("beam=3", "backtrack=5", "mcts=12", "mcts=8:shape,rotation", "lns=12")


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("rules", [{}, {"easy": True}, {"kinematic": True}], ids=str)
def test_what_a_search_leaves_is_an_end_that_can_be_replayed(tasks, search, rules) -> None:
    task = tasks[2] if not rules else tasks[0]
    small = Task(task.items[: 6 if rules else 14], task.pack, ())
    episode = played(small, f"{HEURISTIC}+{search}", **rules)
    assert episode.end in (End.COMPLETE, End.NO_LOCATION)
    again = Episode(small, Rules(**rules))
    for placed in episode.box.placed:
        again.box.place(placed.item, placed.location)
    volume = sum(p.item.volume for p in again.box.placed)
    assert episode.total == pytest.approx(volume / small.volume)
    assert sum(~episode.outside) == len(episode.box.placed)


@pytest.mark.parametrize("search", SEARCHES)
def test_a_search_is_never_worse_than_the_agent_and_follows_from_the_seed(tasks, search) -> None:
    name = f"{HEURISTIC}+{search}"
    tasks = [Task(task.items[:14], task.pack, ()) for task in tasks]
    alone = [played(task, HEURISTIC).total for task in tasks]
    found = [played(task, name, seed=5).total for task in tasks]
    if not search.startswith("beam"):  # beams can leave the agent's own choices behind
        assert all(f >= a - 1e-12 for f, a in zip(found, alone, strict=True))
    assert found == [played(task, name, seed=5).total for task in tasks]


@pytest.mark.parametrize("shape", ["largest-first", "smallest-first", "longest-first"])
def test_one_beam_and_no_backtrack_are_the_agent(tasks, shape) -> None:
    name = f"{shape}/aligned/blbf"
    for task in tasks:
        expected = played(task, name).box.placed
        for search in ("beam=1", "backtrack=0"):
            assert played(task, f"{name}+{search}").box.placed == expected


def test_a_search_with_policies_of_chance_is_repeatable(tasks) -> None:
    agents = [Agent.from_name(f"random/random/random+{search}") for search in SEARCHES]
    few = [Task(task.items[:7], task.pack, ()) for task in tasks[:2]]
    once, again = (evaluate(agents, few, seed=3) for _ in range(2))
    assert [r.total for r in once] == [r.total for r in again]


@given(st.sampled_from(["", "0", "-1", "1.5", "x", "s", "0s", "-1s", "infs", "nans", "2:x"]))
def test_values_that_are_wrong_are_named(value) -> None:
    for kind in ("mcts", "lns"):
        with pytest.raises(UnknownPolicyError, match=f"search '{kind}={value}'"):
            load_search(f"{kind}={value}")


@pytest.mark.parametrize("value", ["", "x", "-1", "1.5", "0"])
def test_a_number_of_beams_that_is_wrong_is_named(value) -> None:
    with pytest.raises(UnknownPolicyError, match=f"search 'beam={value}'"):
        load_search(f"beam={value}")
    if value != "0":
        with pytest.raises(UnknownPolicyError, match=f"search 'backtrack={value}'"):
            load_search(f"backtrack={value}")


def test_unknown_searches_and_policies_without_scores_are_named() -> None:
    names = "backtrack, beam, exact, imagined, lns, mcts, ruin-recreate"
    with pytest.raises(
        UnknownPolicyError, match=f"no search 'bean': did you mean beam[?] choose from {names}$"
    ):
        Agent.from_name(f"{HEURISTIC}+bean=3")
    with pytest.raises(UnknownPolicyError, match="of the form"):
        Agent.from_name(f"{HEURISTIC}+beam=3+lns=2")
    with pytest.raises(UnknownPolicyError, match="rotation policy gives no scores"):
        played(TRAP, "largest-first/lowest/blbf+mcts=3:rotation")


def test_budgets() -> None:
    assert Budget.parse("20") == Budget(rollouts=20)
    assert Budget.parse("1.5s") == Budget(seconds=1.5)


def test_a_time_passes_only_while_the_search_computes() -> None:
    clock = Budget(seconds=0.05).start()
    time.sleep(0.2)
    assert not clock.is_over()
    while not clock.is_over():
        clock.rollouts += 1
    assert clock.rollouts > 0
