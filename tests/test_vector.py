"""Vectorised environments: synchronous, in processes, and sharing caches."""

import contextlib
import multiprocessing

import gymnasium as gym
import numpy as np
import pytest

from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.vector import PackItVectorEnv, make_vec
from packit_sim.game.envs.wrappers import flattened
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import evaluate, evaluate_batched

SHAPES_ONLY = {"observation": "features", "rotation": "aligned", "location": "blbf"}


@pytest.mark.parametrize("vectorization", ["sync", "async", "vector_entry_point"])
def test_vector_environments_play_alike(vectorization) -> None:
    envs = gym.make_vec("PackIt-v0", 2, vectorization, max_shapes=40, **SHAPES_ONLY)
    single = PackItEnv(max_shapes=40, **SHAPES_ONLY)
    try:
        seen, _ = envs.reset(seed=[4, 5], options={"task": 3})
        alone, _ = single.reset(seed=4, options={"task": 3})
        for _ in range(4):
            assert all(np.array_equal(seen[key][0], alone[key]) for key in alone)
            action = int(np.flatnonzero(alone["action_mask"])[0])
            seen, rewards, over, _, _ = envs.step(np.array([action, action]))
            alone, reward, done, _, _ = single.step(action)
            assert rewards[0] == reward and over[0] == done
            if done:
                break
    finally:
        envs.close()


def test_environments_of_a_process_share_their_tasks() -> None:
    envs = gym.make_vec("PackItEasy-v0", 3, observation="none", max_shapes=40)
    assert isinstance(envs, PackItVectorEnv)
    first, *others = (env.unwrapped for env in envs.envs)
    assert first.rules.easy and all(other.tasks is first.tasks for other in others)
    envs.close()


@pytest.mark.parametrize("count", [1, 3])
def test_a_batch_plays_each_task_once_as_one_by_one(count) -> None:
    settings = {"observation": "none", "rotation": "aligned", "location": "blbf", "max_shapes": 40}
    batches = []

    def largest(seen: dict[str, np.ndarray]) -> np.ndarray:
        batches.append(len(seen["stage"]))
        return np.where(seen["action_mask"] > 0, seen["volumes"], -1).argmax(axis=1)

    with contextlib.closing(PackItVectorEnv(count, **settings)) as envs:
        rollouts = evaluate_batched("mine", largest, envs, seed=5)
        expected = evaluate([Agent.from_name("largest-first/aligned/blbf")], envs.tasks, seed=5)
    assert [(r.task, r.total, r.end, r.pack.items) for r in rollouts] == [
        (r.task, r.total, r.end, r.pack.items) for r in expected
    ]
    assert max(batches) == count


@pytest.mark.slow
def test_a_batch_gives_the_same_rollouts_whatever_its_size() -> None:
    settings = {"observation": "none", "rotation": "random", "location": "blbf", "max_shapes": 40}

    def first(seen: dict[str, np.ndarray]) -> np.ndarray:
        return seen["action_mask"].argmax(axis=1)

    played = []
    for count in (1, 4):
        with contextlib.closing(PackItVectorEnv(count, **settings)) as envs:
            played.append(evaluate_batched("mine", first, envs, seed=1))
    assert played[0] == played[1]


each_class = pytest.mark.parametrize(
    "vectorization",
    [
        "vector_entry_point",
        "sync",
        pytest.param("async", marks=pytest.mark.slow),
        pytest.param("parallel", marks=pytest.mark.slow),
    ],
)
NONE = {"observation": "none", "rotation": "aligned", "location": "blbf", "max_shapes": 40}


@each_class
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_all_vector_classes_reset_as_they_are_asked_to(vectorization, mode) -> None:
    """The invalid action 39 ends each episode at once; the next step shows whether it was reset."""
    with contextlib.closing(
        make_vec("PackIt-v0", 2, vectorization, autoreset_mode=mode, **NONE)
    ) as envs:
        assert envs.metadata["autoreset_mode"].value == mode
        envs.reset(seed=0)
        seen, _, over, _, infos = envs.step(np.array([39, 39]))
        assert over.all() and ("final_info" in infos) == (mode == "SameStep")
        assert seen["action_mask"].any() == (mode == "SameStep")
        seen, _, over, _, _ = envs.step(np.array([0, 0]))
        assert not over.any() and seen["action_mask"].any()


@each_class
def test_members_may_have_different_tasks(vectorization) -> None:
    tasks = load_tasks("starter")
    own = [{"tasks": tasks[:2], "order": "cycle"}, {"tasks": tasks[2:5], "order": [0, 0, 1]}]
    with contextlib.closing(
        make_vec("PackIt-v0", 2, vectorization, member_settings=own, **NONE)
    ) as envs:
        seen, _ = envs.reset(seed=0)
        assert seen["action_mask"].sum(axis=1).tolist() == [len(tasks[n].items) for n in (0, 4)]
        if vectorization == "vector_entry_point":
            with pytest.raises(ArgumentError, match="have different tasks: use those of `members`"):
                evaluate_batched("mine", lambda seen: seen["stage"], envs, seed=0)


def test_the_environment_off_the_grid_is_a_vector_by_default_too() -> None:
    with contextlib.closing(
        make_vec("packit_sim:PackItContinuous-v0", 2, autoreset_mode="SameStep", observation="none")
    ) as envs:
        assert envs.metadata["autoreset_mode"].value == "SameStep"
        assert envs.reset(seed=0)[0]["outside"].shape[0] == 2
    with pytest.raises(ArgumentError, match="choose from 'sync', 'async'"):
        make_vec("PackItContinuous-v0", 2, "vector_entry_point")


@pytest.mark.slow
def test_processes_with_several_environments_play_as_one_process_does() -> None:
    """Five environments in two processes, through ends of episodes and with final infos."""
    settings = {**NONE, "observation": "features", "autoreset_mode": "SameStep"}
    own = [{"order": weights} for weights in np.eye(10)[:5].tolist()]
    rng = np.random.default_rng(0)
    with (
        contextlib.closing(make_vec("PackIt-v0", 5, member_settings=own, **settings)) as alone,
        contextlib.closing(
            make_vec("PackIt-v0", 5, "parallel", workers=2, member_settings=own, **settings)
        ) as envs,
    ):
        assert envs.observation_space == alone.observation_space
        assert envs.action_space == alone.action_space
        found, expected = envs.reset(seed=3), alone.reset(seed=3)
        finals = 0
        for _ in range(40):
            for one, other in zip(found, expected, strict=True):
                assert equal(one, other)
            finals += "final_obs" in found[-1]
            mask = found[0]["action_mask"] > 0
            actions = np.array([rng.choice(np.flatnonzero(row)) for row in mask])
            found, expected = envs.step(actions), alone.step(actions)
        assert finals
        assert all(map(np.array_equal, envs.call("action_masks"), alone.call("action_masks")))
        with pytest.raises(ArgumentError, match="2 seeds are given for 5 environments"):
            envs.reset(seed=[1, 2])
        for process in multiprocessing.active_children():
            process.kill()
            process.join()
        with pytest.raises(PackItError, match="ended with exit code -9"):
            envs.step(actions)


def equal(one: object, other: object) -> bool:
    """Compare arrays, also those in mappings and in arrays of objects.

    Comparisons of meshes are not counted where one vector shares its process, and so the engine's
    caches, with the other.
    """
    if isinstance(one, dict):
        compared = one.keys() - {"mesh_comparisons"}
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in compared)
    if isinstance(one, np.ndarray) and one.dtype == object:
        return len(one) == len(other) and all(map(equal, one, other))
    return np.array_equal(one, other)


def test_wrappers_and_settings_that_cannot_be_are_refused() -> None:
    for settings, message in (
        ({"member_settings": [{}]}, "member_settings are 1: give those of 2 environments"),
        ({"wrappers": [flattened]}, "choose the vectorization_mode sync, async"),
        ({"autoreset_mode": "Never"}, "choose from 'NextStep', 'SameStep', 'Disabled'"),
        ({"vectorization_mode": "parallel", "workers": -1}, "workers -1 is not possible"),
        ({"workers": 2}, "workers are of the vectorization_mode parallel"),
        ({"vectorization_mode": "threads"}, "choose from 'vector_entry_point', 'sync', 'async'"),
    ):
        with pytest.raises(ArgumentError, match=message):
            make_vec("PackIt-v0", 2, **settings)
    with contextlib.closing(make_vec("PackIt-v0", 2, "sync", wrappers=[flattened], **NONE)) as envs:
        assert envs.reset(seed=0)[0].ndim == 2
