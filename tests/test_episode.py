"""The rules of the game, every branch, and the heuristics on tasks with a known answer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_agents import BLBF, Aligned, LargestFirst, RandomLocation, RandomRotation, RandomShape
from packit_sim.core.confidence import Estimate
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.episodes.policies import Policy
from packit_sim.game.episodes.policy_registry import UnknownPolicyError, policy_names
from packit_sim.game.evaluation.evaluation import SUCCESS_LEVELS, Score, evaluate, play
from packit_sim.geometry import rotations
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.rules import End
from tests.zoo import BALL, RING, ZOO, cube_of

SLAB = Shape.from_mesh(creation.box((1, 0.7, 0.05)), "slab")
HEURISTIC = Agent.from_name("largest-first/aligned/blbf")


def task_of(*items: Item, cells: tuple[int, int, int] = (100, 100, 100)) -> Task:
    return Task(items, Pack(LibraryRef("zoo", "1", ""), cells, (), 0.0), ())


def test_an_episode_by_hand() -> None:
    episode = Episode(task_of(cube_of(40), cube_of(20)))
    assert episode.stage is Stage.SHAPE and episode.action_mask().tolist() == [True, True]
    assert episode.step(1) == 0
    assert episode.stage is Stage.ROTATION and episode.action_mask().all()
    assert len(episode.action_mask()) == 24
    assert episode.step(5) == 0
    assert episode.stage is Stage.LOCATION
    assert episode.chosen_item is not None and episode.chosen_item.item.rotation == 5
    assert episode.action_mask().sum() == 21**3
    assert episode.step(0) == pytest.approx(1 / 9)
    assert episode.stage is Stage.SHAPE and episode.action_mask().tolist() == [True, False]
    assert episode.end is None
    episode.step(0)
    episode.step(0)
    assert not episode.action_mask()[0]
    assert episode.step(int(np.ravel_multi_index((5, 0, 0), (25, 25, 25)))) == pytest.approx(8 / 9)
    assert episode.end is End.COMPLETE
    assert episode.total == pytest.approx(1)
    assert [p.location for p in episode.box.placed] == [(0, 0, 0), (5, 0, 0)]
    with pytest.raises(RuntimeError, match="all placed"):
        episode.step(0)


@pytest.mark.parametrize("actions", [[2], [-1], [0, 24], [0, -1], [0, 0, 15625], [0, 0, -1]])
def test_an_action_out_of_range_ends_the_episode_without_reward(actions) -> None:
    episode = Episode(task_of(cube_of(40), cube_of(20)))
    rewards = [episode.step(action) for action in actions]
    assert rewards == [0.0] * len(actions)
    assert episode.end is End.INVALID_ACTION and not episode.box.placed


def test_a_shape_inside_or_an_occupied_location_is_not_valid() -> None:
    for actions in ([0], [1, 0, 0]):
        episode = Episode(task_of(cube_of(40), cube_of(20)))
        for action in (0, 0, 0):
            episode.step(action)
        rewards = [episode.step(action) for action in actions]
        assert not any(rewards)
        assert episode.end is End.INVALID_ACTION and len(episode.box.placed) == 1


def test_an_episode_ends_where_the_chosen_item_fits_nowhere() -> None:
    episode = Episode(task_of(cube_of(60), cube_of(60)))
    for action in (0, 0, 0, 1):
        episode.step(action)
    assert episode.step(7) == 0
    assert episode.end is End.NO_LOCATION
    assert episode.total == pytest.approx(0.5)


def test_a_task_without_items_is_over_at_once() -> None:
    assert Episode(task_of()).end is End.COMPLETE


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(-5, 16000), max_size=12))
def test_no_sequence_of_actions_corrupts_the_box(seed, wild) -> None:
    """Valid actions by chance, with wild ones between them."""
    rng = np.random.default_rng(seed)
    items = [Item(ZOO[rng.integers(len(ZOO))], rng.uniform(0.2, 0.4) ** 3) for _ in range(4)]
    episode = Episode(task_of(*items, cells=(40, 40, 40)))
    total = 0.0
    while episode.end is None:
        valid = np.flatnonzero(episode.action_mask())
        action = wild.pop() if wild and rng.random() < 0.2 else int(rng.choice(valid))
        total += episode.step(action)
    placed = sum(p.item.volume for p in episode.box.placed)
    assert total == episode.total == pytest.approx(placed / episode.task.volume)
    assert episode.box.density <= 1
    assert len(episode.box.placed) == (~episode.outside).sum()


@pytest.mark.parametrize("policy", [RandomShape(), LargestFirst()])
def test_shape_policies_choose_what_is_outside(policy: Policy) -> None:
    episode = Episode(task_of(cube_of(40), cube_of(20), cube_of(30), cube_of(30)))
    rng = np.random.default_rng(0)
    episode.outside[0] = False
    chosen = {policy(episode, rng) for _ in range(60)}
    assert chosen == ({2} if isinstance(policy, LargestFirst) else {1, 2, 3})


def test_rotation_policies() -> None:
    episode = Episode(task_of(Item(RING, 0.1)))
    episode.step(0)
    rng = np.random.default_rng(0)
    assert {RandomRotation()(episode, rng) for _ in range(600)} == set(range(24))
    extents = Item(RING, 0.1, Aligned()(episode, rng)).extents
    assert extents[2] < extents[0] <= extents[1] + rotations.TIE


def test_location_policies() -> None:
    episode = Episode(task_of(cube_of(40), cube_of(92)))
    episode.step(1)
    episode.step(0)
    rng = np.random.default_rng(0)
    assert BLBF()(episode, rng) == 0
    drawn = {RandomLocation()(episode, rng) for _ in range(600)}
    assert drawn == set(np.flatnonzero(episode.action_mask()).tolist()) and len(drawn) == 27


def test_the_heuristic_on_a_task_solved_by_hand() -> None:
    """Three slabs, largest first: one on the floor, one next to it, one on the first."""
    slabs = [Item(SLAB, scale) for scale in (0.3, 0.5, 0.4)]
    episode = play(task_of(*slabs), HEURISTIC, np.random.default_rng(0))
    assert episode.end is End.COMPLETE and episode.total == pytest.approx(1)
    assert [p.item.cells for p in episode.box.placed] == [(46, 65, 4), (43, 61, 4), (39, 55, 3)]
    assert [p.item.scale for p in episode.box.placed] == [0.5, 0.4, 0.3]
    assert [p.location for p in episode.box.placed] == [(0, 0, 0), (12, 0, 0), (0, 0, 1)]
    assert all(p.item.extents.argmin() == 2 for p in episode.box.placed)


def test_agents_are_found_by_name() -> None:
    assert {"largest-first", "random"} <= set(policy_names(Stage.SHAPE))
    assert Agent("largest-first/aligned/blbf", LargestFirst(), Aligned(), BLBF()) == HEURISTIC
    with pytest.raises(
        UnknownPolicyError, match=r"no shape policy 'larger': choose from .*, random"
    ):
        Agent.from_name("larger/aligned/blbf")
    with pytest.raises(UnknownPolicyError, match="not of the form"):
        Agent.from_name("blbf")


def test_a_rollout_does_not_depend_on_other_episodes() -> None:
    rng = np.random.default_rng(0)
    tasks = [task_of(*(Item(BALL, rng.uniform(0.3, 0.7) ** 3) for _ in range(6))) for _ in range(3)]
    chance = Agent.from_name("random/random/random")
    together = evaluate([HEURISTIC, chance], tasks, seed=5)
    alone = evaluate([chance], tasks, seed=5)
    assert together[3:] == alone
    assert evaluate([chance], tasks, seed=6) != alone
    assert len({r.pack.items for r in alone}) == 3


def test_scores_by_hand() -> None:
    task = task_of(cube_of(60), cube_of(60))
    rollouts = evaluate([HEURISTIC], [task, task], seed=0)
    score = Score.of(HEURISTIC.name, rollouts)
    assert score.tasks == 2
    assert score.reward == Estimate(0.5, 0.5, 0.5)
    assert {x: e.mean for x, e in score.success.items()} == {
        x: 100.0 * (x == 0.5) for x in SUCCESS_LEVELS
    }
    assert Score.of(HEURISTIC.name, rollouts[:1]).reward == Estimate(0.5, None, None)


def test_bootstrap_intervals_cover_the_mean_and_narrow_with_the_sample() -> None:
    sample = np.random.default_rng(1).normal(0.6, 0.2, 400)
    wide, narrow = Estimate.of(sample[:25]), Estimate.of(sample)
    for estimate in (wide, narrow):
        assert estimate.low is not None and estimate.high is not None
        assert estimate.low < estimate.mean < estimate.high
    expected = 2 * 1.96 * sample.std() / 20
    assert narrow.high - narrow.low == pytest.approx(expected, rel=0.15)  # type: ignore[operator]
    assert wide.high - wide.low > 2 * (narrow.high - narrow.low)  # type: ignore[operator]
