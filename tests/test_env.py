import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from packit_sim.env import PackItEnv
from packit_sim.library import ShapeLibrary
from packit_sim.packs import Task, load_tasks


@pytest.fixture(scope="module")
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter", ShapeLibrary.open("everyday"))


@pytest.mark.filterwarnings("error")
def test_gymnasiums_checker_is_content() -> None:
    env = gym.make("PackIt-v0", max_shapes=40, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("number", [0, 1])
def test_replay_of_the_ground_truth_returns_1(tasks, number) -> None:
    with gym.make("PackIt-v0", tasks=tasks, max_shapes=40) as env:
        env.reset(options={"task": number})
        total, info = 0.0, {}
        for shape, rotation, location in tasks[number].solution:
            for action in (shape, rotation, int(np.ravel_multi_index(location, (25, 25, 25)))):
                assert env.unwrapped.action_masks()[action]
                _, reward, terminated, truncated, info = env.step(action)
                total += reward
        assert terminated and not truncated
        assert total == pytest.approx(1)
        assert info["end"] == "all placed"
        assert info["density"] == pytest.approx(tasks[number].pack.density)


def test_what_is_observed(tasks) -> None:
    env = PackItEnv(tasks, max_shapes=40)
    seen, info = env.reset(seed=1)
    task = tasks[info["task"]]
    count = len(task.items)
    assert seen in env.observation_space
    assert seen["shapes"].shape == (40, 100, 100, 100)
    assert [int(s.sum()) for s in seen["shapes"][:count]] == [
        int(i.outer.sum()) for i in task.items
    ]
    assert not seen["shapes"][count:].any() and not seen["item"].any() and not seen["box"].any()
    assert seen["outside"].sum() == seen["action_mask"].sum() == count
    assert seen["chosen"] == 40
    assert seen["volumes"].sum() == pytest.approx(task.volume)

    shape, rotation, location = task.solution[0]
    chosen = env.step(shape)[0]
    assert chosen["chosen"] == shape and chosen["stage"] == 1 and chosen["action_mask"].sum() == 24
    turned = env.step(rotation)[0]
    item = env.episode.choice.item
    assert turned["item"].sum() == item.outer.sum() and turned["stage"] == 2
    assert (turned["action_mask"][:15625] == env.episode.choice.feasible.ravel()).all()
    placed = env.step(int(np.ravel_multi_index(location, (25, 25, 25))))[0]
    corner = tuple(slice(4 * n, 4 * n + c) for n, c in zip(location, item.cells, strict=True))
    assert (placed["box"][corner] == item.outer).all()
    assert placed["box"].sum() == item.outer.sum()
    assert not placed["outside"][shape]
    assert not seen["box"].any(), "an observation does not change after it was given"


def test_an_invalid_action_ends_the_episode_and_says_so(tasks) -> None:
    env = PackItEnv(tasks, max_shapes=40)
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(39)
    assert reward == 0 and terminated and info["end"] == "invalid action"
    assert not env.action_masks().any()
    with pytest.raises(RuntimeError, match="over"):
        env.step(0)


def test_two_seeded_rollouts_are_equal_step_by_step(tasks) -> None:
    def rollout() -> list:
        env = PackItEnv(tasks, max_shapes=40)
        env.reset(seed=11)
        env.action_space.seed(11)
        steps = []
        for _ in range(12):
            if env.episode.end is not None:
                env.reset()
            seen, *rest = env.step(env.action_space.sample(mask=env.action_masks().astype(np.int8)))
            steps.append(({k: v for k, v in seen.items() if k != "shapes"}, rest))
        return steps

    for (first, rest), (again, rest_again) in zip(rollout(), rollout(), strict=True):
        assert rest == rest_again
        assert all(np.array_equal(first[key], again[key]) for key in first)


def test_settings_that_cannot_be_are_refused(tasks) -> None:
    with pytest.raises(ValueError, match="render mode 'human'"):
        PackItEnv(tasks, render_mode="human")
    most = max(len(task.items) for task in tasks)
    with pytest.raises(ValueError, match=f"a task has {most} items: max_shapes is only {most - 1}"):
        PackItEnv(tasks, max_shapes=most - 1)
    with pytest.raises(ValueError, match="share one box"):
        PackItEnv([])
    env = PackItEnv(tasks, max_shapes=40)
    with pytest.raises(ValueError, match="there is no task 99"):
        env.reset(options={"task": 99})
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        PackItEnv(tasks, max_shapes=40).step(0)
