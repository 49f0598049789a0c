import dataclasses
import itertools
import pickle
import re
import subprocess
import sys
import threading
import urllib.request
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from packit_sim.box import BaseBox
from packit_sim.core import caches
from packit_sim.core.counters import ComparisonCounter, counted_by
from packit_sim.core.errors import ArgumentError, StateError
from packit_sim.engine import insertion
from packit_sim.game.datasets.pack_files import load_tasks, write_packs
from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.features import CubeMeans
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Stage
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import unpack
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import Rules
from tests.zoo import cube_of


@pytest.fixture(scope="module")
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter", ShapeLibrary.open("everyday"))


@pytest.mark.parametrize(
    ("env_id", "settings"),
    [
        ("PackIt-v0", {"render_mode": "rgb_array", "observation": "voxels"}),
        ("PackIt-v0", {"observation": "features", "rotation": "aligned", "location": "blbf"}),
        ("PackIt-v0", {"observation": "none", "kinematic": True}),
        ("PackItEasy-v0", {"observation": "features"}),
        ("PackItEasy-v0", {"observation": "none", "location": "blbf"}),
    ],
)
def test_gymnasiums_checker_finds_nothing_wrong(tasks, env_id, settings) -> None:
    """Warnings are errors. The task is of six items: the checker compares all voxels many times."""
    task = dataclasses.replace(tasks[0], items=tasks[0].items[:6], solution=())
    env = gym.make(env_id, tasks=[task], max_shapes=8, **settings)
    check_env(env.unwrapped, skip_render_check="render_mode" not in settings)
    env.close()


@pytest.mark.parametrize("number", [pytest.param(0, marks=pytest.mark.slow), 1])
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
    env = PackItEnv(tasks, max_shapes=40, observation="voxels")
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
    item = env.episode.chosen_item.item
    assert turned["item"].sum() == item.outer.sum() and turned["stage"] == 2
    assert (turned["action_mask"][:15625] == env.episode.chosen_item.feasible.ravel()).all()
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
            info = rest.pop()
            del info["mesh_comparisons"]  # fewer where the process knows the answers
            steps.append(({k: v for k, v in (seen | info).items() if k != "shapes"}, rest))
        return steps

    for (first, rest), (again, rest_again) in zip(rollout(), rollout(), strict=True):
        assert rest == rest_again
        assert all(np.array_equal(first[key], again[key]) for key in first)


def test_settings_that_cannot_be_are_refused(tasks) -> None:
    with pytest.raises(ValueError, match="render mode 'ascii' is not known: choose from None, 'hu"):
        PackItEnv(tasks, render_mode="ascii")
    most = max(len(task.items) for task in tasks)
    with pytest.raises(ValueError, match=f"a task has {most} items: max_shapes is only {most - 1}"):
        PackItEnv(tasks, max_shapes=most - 1)
    with pytest.raises(ValueError, match="needs a task"):
        PackItEnv([])
    env = PackItEnv(tasks, max_shapes=40)
    with pytest.raises(ValueError, match="there is no task 99"):
        env.reset(options={"task": 99})
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        PackItEnv(tasks, max_shapes=40).step(0)


def heuristic_return(env: PackItEnv, agent: Agent, task: int) -> float:
    """Plays a task by an agent's policies wherever the environment asks."""
    env.reset(options={"task": task}, seed=0)
    total, over = 0.0, env.episode.end is not None
    while not over:
        action = agent.act(env.episode, np.random.default_rng(0))
        assert env.action_masks()[action]
        _, reward, over, _, _ = env.step(action)
        total += reward
    return total


@pytest.mark.parametrize("number", [0, 2])
def test_easy_replays_the_ground_truth_in_its_own_order(tasks, number) -> None:
    with gym.make("PackItEasy-v0", tasks=tasks, observation="none", max_shapes=40) as env:
        env.reset(options={"task": number})
        total, over = 0.0, False
        for shape, rotation, location in tasks[number].solution:
            flat = int(np.ravel_multi_index(location, (25, 25, 25)))
            for stage, action in ((0, shape), (2, flat), (1, rotation)):
                assert env.unwrapped.episode.stage == stage
                assert env.unwrapped.action_masks()[action] and not over
                _, reward, over, _, info = env.step(action)
                total += reward
        assert over and info["end"] == "all placed" and total == pytest.approx(1)


def test_easy_checks_the_rotations_of_a_location_once(tasks, monkeypatch) -> None:
    asked = []
    rotations_at = BaseBox.rotations_at
    monkeypatch.setattr(
        BaseBox, "rotations_at", lambda *args: asked.append(args) or rotations_at(*args)
    )
    env = PackItEnv(tasks, easy=True, observation="features", max_shapes=40)
    env.reset(options={"task": 1})
    rotation_steps = 0
    while env.episode.end is None and rotation_steps < 5:
        rotation_steps += env.episode.stage is Stage.ROTATION
        env.step(int(np.flatnonzero(env.action_masks())[0]))
        env.action_masks()
    assert len(asked) == rotation_steps == 5


def test_mesh_comparisons_are_those_of_the_environment_itself(tasks) -> None:
    """Two environments that play in turn count as much as each of them alone would."""

    def play(envs: list[PackItEnv], steps: int) -> list[int]:
        """Each environment with its own caches, so that both have to call FCL."""
        for env in envs:
            caches.clear()
            env.reset(options={"task": 1})
        for _ in range(steps):
            for env in envs:
                caches.clear()
                *_, info = env.step(int(np.flatnonzero(env.action_masks())[-1]))
                env.last = info["mesh_comparisons"]
        return [env.last for env in envs]

    envs = [PackItEnv(tasks, observation="none", max_shapes=40) for _ in range(2)]
    idle = PackItEnv(tasks, observation="none", max_shapes=40)
    idle.reset(options={"task": 1})
    (alone,) = play(envs[:1], 9)
    assert alone > 0
    assert play(envs, 9) == [alone, alone]
    _, info = idle.set_state(idle.get_state())
    assert info["mesh_comparisons"] == 0


def test_mesh_comparisons_are_counted_for_each_thread(tasks) -> None:
    envs = [PackItEnv(tasks, observation="none", max_shapes=40) for _ in range(2)]
    idle, busy = envs
    idle.reset(options={"task": 0})

    def play() -> None:
        busy.reset(options={"task": 1})
        for _ in range(9):
            *_, busy.info = busy.step(int(np.flatnonzero(busy.action_masks())[-1]))

    caches.clear()
    here = ComparisonCounter()
    with counted_by(here):
        thread = threading.Thread(target=play)
        thread.start()
        thread.join()
    assert busy.info["mesh_comparisons"] > 0 and here.mesh_comparisons == 0


def test_a_state_remembers_that_the_episode_is_over(tasks) -> None:
    env = PackItEnv(tasks, observation="none", max_shapes=40)
    env.reset(seed=0)
    begun = env.get_state()
    env.step(env.action_space.n - 1)  # not a shape
    over = pickle.loads(pickle.dumps(env.get_state()))
    for state in (begun, over):
        env.set_state(state)
    with pytest.raises(RuntimeError, match=r"over: invalid action: call reset"):
        env.step(0)
    env.set_state(begun)
    env.step(0)
    env.set_state(over)
    with pytest.raises(RuntimeError, match=r"over: invalid action: call reset"):
        env.step(0)
    env.reset()
    env.step(0)


def test_rules_are_one_value_that_keywords_change() -> None:
    common = {"observation": "none", "max_shapes": 40}
    env = gym.make("PackItEasy-v0", kinematic=True, cells=(100, 100, 120), **common).unwrapped
    assert env.rules == Rules(easy=True, kinematic=True, cells=(100, 100, 120))
    assert PackItEnv(rules=env.rules, easy=False, **common).rules == replace(env.rules, easy=False)
    env.reset(seed=0)
    assert env.episode.rules is env.rules
    with pytest.raises(
        TypeError, match=r"got an unexpected keyword argument .eazy.: choose from tasks, lib"
    ):
        PackItEnv(eazy=True)


def test_easy_offers_every_location_and_then_the_rotations_that_fit_there(tasks) -> None:
    env = PackItEnv(tasks, easy=True, observation="none", max_shapes=40)
    env.reset(options={"task": 1})
    for _ in range(3):
        env.step(int(np.flatnonzero(env.action_masks())[0]))
        item = env.episode.task.items[env.episode.shape]
        masks = env.episode.box.feasible_rotations(item)
        assert (env.action_masks()[:15625] == masks.any(axis=0).ravel()).all()
        action = int(np.flatnonzero(env.action_masks())[7])
        env.step(action)
        i, j, k = np.unravel_index(action, (25, 25, 25))
        assert (env.action_masks()[:24] == masks[:, i, j, k]).all()
        env.step(int(np.flatnonzero(env.action_masks())[-1]))
    assert len(env.episode.box.placed) == 3


@pytest.mark.parametrize("easy", [False, True])
def test_a_wrong_location_or_rotation_ends_easy_and_plain_alike(tasks, easy) -> None:
    env = PackItEnv(tasks, easy=easy, observation="none", max_shapes=40)
    for wrong_at in range(3):
        env.reset(options={"task": 0})
        for _ in range(wrong_at):
            env.step(int(np.flatnonzero(env.action_masks())[0]))
        invalid = int(np.flatnonzero(~env.action_masks())[-1])
        _, reward, over, _, info = env.step(invalid)
        assert reward == 0 and over and info["end"] == "invalid action"
        assert not env.episode.box.placed and not env.action_masks().any()


def test_fixed_policies_leave_the_other_sub_tasks_as_steps(tasks) -> None:
    agent = Agent.from_name("largest-first/aligned/blbf")
    whole = PackItEnv(tasks, observation="none", max_shapes=40)
    for fixed, size in (
        ({"rotation": "aligned", "location": "blbf"}, 40),
        ({"rotation": agent.rotation}, 15625),
        ({"shape": "largest-first", "location": "blbf"}, 24),
    ):
        env = PackItEnv(tasks, observation="none", max_shapes=40, **fixed)
        env.reset(options={"task": 0})
        assert env.action_space.n == size == len(env.action_masks())
        for task in range(3):
            expected = heuristic_return(whole, agent, task)
            assert heuristic_return(env, agent, task) == pytest.approx(expected)
            assert env.episode.box.snapshot() == whole.episode.box.snapshot()
    with pytest.raises(ValueError, match="no step is left"):
        PackItEnv(tasks, shape="random", rotation="random", location="random", max_shapes=40)
    with pytest.raises(ValueError, match="no rotation policy 'best'"):
        PackItEnv(tasks, rotation="best", max_shapes=40)


def test_an_episode_that_is_over_at_once_ends_in_the_first_step(tasks) -> None:
    task = dataclasses.replace(tasks[0], items=(cube_of(60),), solution=())
    settings = {"observation": "none", "shape": "random", "rotation": "aligned", "max_shapes": 2}
    env = PackItEnv([task], cells=(100, 100, 40), **settings)
    seen, info = env.reset(seed=0)
    assert info["end"] == "no room" and not seen["action_mask"].any()
    _, reward, over, _, info = env.step(0)
    assert (reward, over, info["end"]) == (0.0, True, "no room")
    with pytest.raises(RuntimeError, match="over"):
        env.step(0)


@pytest.mark.parametrize("easy", [False, True])
@pytest.mark.parametrize("generated", [False, True])
def test_states_go_back_exactly_and_travel(tasks, easy, generated) -> None:
    source = (lambda rng: tasks[int(rng.integers(len(tasks)))]) if generated else tasks
    env = PackItEnv(source, easy=easy, observation="none", max_shapes=40)
    env.reset(seed=3)

    def play(steps: int) -> list:
        seen = []
        for _ in range(steps):
            if env.episode.end is not None:
                env.reset()
            valid = np.flatnonzero(env.action_masks())
            *_, info = env.step(int(env.np_random.choice(valid)))
            info.pop("mesh_comparisons")
            seen.append((info, env.episode.state()))
        return seen

    for steps in (0, 1, 2, 3, 7):
        play(steps)
        state = env.get_state()
        first = play(9)
        env.set_state(pickle.loads(pickle.dumps(state)))
        again = play(9)
        assert [s for _, s in first] == [s for _, s in again]
        assert all(
            np.array_equal(a[0]["action_mask"], b[0]["action_mask"])
            for a, b in zip(first, again, strict=True)
        )
    if not generated:
        assert len(pickle.dumps(env.get_state())) < 1_000_000


@pytest.mark.parametrize(
    ("cells", "cubes"), [((100, 100, 100), 10), ((100, 52, 24), 10), ((12, 40, 8), 8)]
)
def test_the_means_of_a_box_follow_its_changes(cells, cubes) -> None:
    means, bricks = CubeMeans(cells, cubes), [count // 4 for count in cells]
    edges = [np.arange(cubes) * count // cubes for count in cells]
    sizes = np.ones(cells)
    for axis, starts in enumerate(edges):
        sizes = np.add.reduceat(sizes, starts, axis=axis)
    before, counts = np.zeros(bricks, dtype=np.uint64), np.zeros([cubes] * 3, dtype=np.int32)
    rng = np.random.default_rng(0)
    changed = np.zeros(3, dtype=np.int64), np.array(bricks) - 1
    for _ in range(4):
        words = rng.integers(2**64, size=bricks, dtype=np.uint64)
        words *= rng.random(bricks) < 0.5
        filled = unpack(words).astype(float)
        for axis, starts in enumerate(edges):
            filled = np.add.reduceat(filled, starts, axis=axis)
        assert means.of_box(words, before, counts, changed) == pytest.approx(filled / sizes)


def test_features_follow_the_states_of_an_environment(tasks) -> None:
    settings = {"rotation": "aligned", "location": "blbf", "max_shapes": 40}
    env, fresh = PackItEnv(tasks, **settings), PackItEnv(tasks, **settings)
    env.reset(options={"task": 0})
    rng, states = np.random.default_rng(0), [env.get_state()]
    for _ in range(80):
        if env.episode.end is None and rng.random() < 0.6:
            seen, *_ = env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))
            states.append(env.get_state())
        else:
            seen, _ = env.set_state(states[rng.integers(len(states))])
        expected, _ = fresh.set_state(env.get_state())
        fresh = PackItEnv(tasks, **settings)
        assert np.array_equal(seen["box"], expected["box"])


def test_features_are_mean_occupancies(tasks) -> None:
    voxels = PackItEnv(tasks, max_shapes=40, observation="voxels")
    features = PackItEnv(tasks, max_shapes=40)
    rng = np.random.default_rng(0)
    for env in (voxels, features):
        env.reset(options={"task": 0})
    for _ in range(9):
        action = int(rng.choice(np.flatnonzero(voxels.action_masks())))
        cells, *_ = voxels.step(action)
        means, *_ = features.step(action)
        assert means in features.observation_space
        blocks = cells["box"].reshape(10, 10, 10, 10, 10, 10).mean(axis=(1, 3, 5))
        assert means["box"] == pytest.approx(blocks)
        edges = [0, 12, 25, 37, 50, 62, 75, 87, 100]
        corner = [slice(a, b) for a, b in itertools.pairwise(edges)]
        at = corner[3], corner[4], corner[2]
        assert means["item"][3, 4, 2] == pytest.approx(cells["item"][at].mean())
        assert means["shapes"][5, 3, 4, 2] == pytest.approx(cells["shapes"][5][at].mean())
        if voxels.episode.end is not None:
            break


def test_features_are_observed_by_default_and_small(tasks) -> None:
    """Voxels would take 52 MB each in a replay buffer."""
    seen, _ = PackItEnv(tasks).reset(seed=0)
    assert seen["shapes"].shape == (50, 8, 8, 8)
    assert sum(np.asarray(field).nbytes for field in seen.values()) < 150_000


def test_static_voxels_are_shared_but_not_by_neighbours(tasks) -> None:
    env = PackItEnv(tasks, max_shapes=40, observation="voxels")
    seen = [env.reset(seed=0)[0]]
    seen += [env.step(int(np.flatnonzero(env.action_masks())[0]))[0] for _ in range(3)]
    assert seen[0]["shapes"] is seen[2]["shapes"] and seen[1]["shapes"] is seen[3]["shapes"]
    assert not np.shares_memory(seen[0]["shapes"], seen[1]["shapes"])
    assert np.array_equal(seen[0]["shapes"], seen[1]["shapes"])
    with pytest.raises(ValueError, match="read-only"):
        seen[0]["shapes"][0] = True
    before = seen[0]["shapes"].copy()
    env.reset(seed=1)
    assert np.array_equal(seen[0]["shapes"], before)


def test_tasks_come_in_turn_at_random_or_from_a_function(tasks) -> None:
    env = PackItEnv(tasks, order="cycle", observation="none", max_shapes=40)
    assert [env.reset()[1]["task"] for _ in range(12)] == [*range(10), 0, 1]
    generated = PackItEnv(
        lambda rng: tasks[int(rng.integers(3))], observation="none", max_shapes=40
    )
    assert generated.reset(seed=5)[1]["task"] == -1
    first = generated.episode.task
    generated.reset(seed=5)
    assert generated.episode.task is first
    env.reset(options={"task": tasks[4]})
    assert env.episode.task is tasks[4]
    with pytest.raises(ValueError, match="observation 'pixels' is not known: choose from 'feat"):
        PackItEnv(tasks, observation="pixels")


def test_what_is_possible_and_what_was_chosen(tasks) -> None:
    rng = np.random.default_rng(0)
    for easy in (False, True):
        env = PackItEnv(tasks, easy=easy, observation="none", max_shapes=40)
        seen, _ = env.reset(options={"task": 0})
        assert not seen["rotations"].any() and not seen["locations"].any()
        for _ in range(12):
            mask = env.action_masks()
            if seen["stage"] == 1:
                assert np.array_equal(seen["rotations"], mask[:24])
                assert seen["locations"].sum() == easy
                assert not easy or seen["locations"][env.episode.location]
            if seen["stage"] == 2:
                assert np.array_equal(seen["locations"].ravel(), mask[:15625])
                assert seen["rotations"].sum() == (not easy)
                assert easy or seen["rotations"][env.episode.rotation]
            seen, *_ = env.step(int(rng.choice(np.flatnonzero(mask))))
            assert seen in env.observation_space


@pytest.mark.parametrize(
    ("settings", "fields"),
    [
        ({"rotation": "aligned", "location": "blbf"}, set()),
        ({"location": "blbf"}, {"rotations"}),
        ({"rotation": "aligned"}, {"rotations", "locations"}),
        ({"rotation": "aligned", "easy": True}, {"locations"}),
        ({"location": "blbf", "easy": True}, {"rotations", "locations"}),
    ],
)
def test_only_what_matters_to_the_agent_is_observed(tasks, settings, fields) -> None:
    env = PackItEnv(tasks, observation="none", max_shapes=40, **settings)
    assert {"rotations", "locations"} & set(env.observation_space.keys()) == fields


@pytest.mark.slow
def test_kinematic_episodes_never_put_anything_under_another(tasks) -> None:
    items = tuple(Item(one.shape, 0.2 * one.scale) for one in tasks[0].items)
    small = dataclasses.replace(tasks[0], items=items, solution=())
    for easy in (False, True):
        settings = {"easy": easy, "cells": (60, 60, 60), "observation": "none", "max_shapes": 40}
        free, bound = PackItEnv([small], **settings), PackItEnv([small], **settings, kinematic=True)
        rng = np.random.default_rng(7)
        for env in (free, bound):
            env.reset()
        narrowed = 0
        while bound.episode.end is None and len(bound.episode.box.placed) < (4 if easy else 6):
            mask, wider = bound.action_masks(), free.action_masks()
            assert not (mask & ~wider).any()
            narrowed += int((wider & ~mask).sum())
            action = int(rng.choice(np.flatnonzero(mask)))
            bound.step(action)
            free.step(action)
        assert narrowed > 0
        placed = bound.episode.box.placed
        assert len(placed) > 3
        for n, candidate in enumerate(placed[:3]):
            assert insertion.is_insertable_oracle(placed[:n], candidate)


def test_a_location_under_another_item_is_an_invalid_action_in_kinematic_boxes(tasks) -> None:
    task = dataclasses.replace(tasks[0], items=(cube_of(40), cube_of(8)), solution=())
    node = (25, 25, 25)
    for kinematic, end in ((False, "all placed"), (True, "invalid action")):
        env = PackItEnv([task], kinematic=kinematic, observation="none", max_shapes=2)
        env.reset()
        for action in (0, 0, np.ravel_multi_index((5, 5, 5), node), 1, 0):
            assert not env.step(int(action))[2]
        below = int(np.ravel_multi_index((7, 7, 0), node))
        assert env.action_masks()[below] == (not kinematic)
        *_, over, _, info = env.step(below)
        assert over and info["end"] == end


def test_fresh_tasks_are_of_the_split_and_can_be_packed_whole() -> None:
    env = PackItEnv("fresh", split="test", cells=(80, 80, 60), observation="none")
    assert env.reset(seed=3)[1]["task"] == -1
    task = env.episode.task
    ids = set(ShapeLibrary.open("everyday").split("test").ids)
    assert {item.shape.id for item in task.items} <= ids and task.cells == env.cells == (80, 80, 60)
    for action in itertools.chain.from_iterable(
        (shape, rotation, int(np.ravel_multi_index(location, (20, 20, 15))))
        for shape, rotation, location in task.solution
    ):
        _, _, over, _, info = env.step(action)
    assert over and info["end"] == "all placed" and env.episode.total == pytest.approx(1)
    env.reset(seed=3)
    assert env.episode.task.pack == task.pack
    env.reset()
    assert env.episode.task.pack != task.pack
    with pytest.raises(ValueError, match="there is no task 0: tasks are generated on the fly"):
        env.reset(options={"task": 0})


def test_another_box_for_the_same_items(tasks) -> None:
    env = PackItEnv(tasks, cells=(120, 100, 60), observation="features", max_shapes=40)
    seen, _ = env.reset(options={"task": 0})
    assert env.episode.box.cells == (120, 100, 60) and seen in env.observation_space
    assert seen["locations"].shape == (30, 25, 15)
    with pytest.raises(ValueError, match="fits into no box of"):
        PackItEnv(tasks, cells=(16, 16, 16), max_shapes=40)
    with pytest.raises(ValueError, match="give `cells` to say which"):
        PackItEnv([tasks[0], dataclasses.replace(tasks[1], pack=other_box(tasks[1]))])


def other_box(task: Task) -> Pack:
    return dataclasses.replace(task.pack, cells=(200, 200, 200))


def test_a_dataset_in_a_folder_is_opened_by_its_split(tasks, tmp_path) -> None:
    write_packs(tmp_path / "train.jsonl", [tasks[0].pack])
    write_packs(tmp_path / "test.jsonl", [tasks[1].pack, tasks[2].pack])
    env = PackItEnv(tmp_path, split="test", observation="none")
    assert [task.pack for task in env.tasks] == [tasks[1].pack, tasks[2].pack]
    with pytest.raises(ValueError, match="the splits test, train: choose one"):
        PackItEnv(tmp_path)
    with pytest.raises(ValueError, match="there is no 'validation'"):
        PackItEnv(tmp_path, split="validation")
    with pytest.raises(ValueError, match="there is no 'train'"):
        PackItEnv("starter", split="train")
    with pytest.raises(ValueError, match="has no splits"):
        PackItEnv(tmp_path / "train.jsonl", split="train")
    with pytest.raises(ValueError, match="tasks have none"):
        PackItEnv(tasks, split="train")


def test_a_page_shows_the_box_as_it_fills(tasks, caplog) -> None:
    with gym.make("PackIt-v0", tasks=tasks, observation="none", render_mode="human") as env:
        env.reset(options={"task": 0})
        (address,) = re.findall(r"http://127\.0\.0\.1:\d+", caplog.text)
        with urllib.request.urlopen(address, timeout=10) as answer:
            assert answer.status == 200
        for shape, rotation, location in tasks[0].solution[:2]:
            for action in (shape, rotation, int(np.ravel_multi_index(location, (25, 25, 25)))):
                env.step(action)
        assert env.render() is None
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=10)


@pytest.mark.parametrize(
    "name",
    [  # and PackIt-v0 in test_imports.py
        pytest.param("PackItEasy-v0", marks=pytest.mark.slow),
        pytest.param("PackItPhysics-v0", marks=pytest.mark.slow),
    ],
)
def test_gymnasium_imports_the_package_that_an_id_names(name) -> None:
    code = f"""
import sys, gymnasium
assert "packit_sim" not in sys.modules
env = gymnasium.make("packit_sim:{name}")
print(type(env.unwrapped).__name__, env.spec.id)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["PackItEnv", name], done.stderr


@pytest.mark.parametrize(
    "action", [0.5, 0.0, "0", b"0", True, np.bool_(True), None, [0], np.ones(2)]
)
def test_an_action_that_is_not_an_integer_is_refused(tasks, action) -> None:
    env = PackItEnv(tasks, observation="none", max_shapes=40)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ArgumentError, match=r"action .* is not possible: it must be an integer"):
        env.step(action)
    assert env.get_state() == before
    for integer in (0, np.int64(0), np.uint8(0)):
        env.set_state(before)
        assert env.step(integer)[4]["end"] == ""
    env.set_state(before)
    assert env.step(np.array(0))[4]["end"] == ""


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (5, "options 5 are not possible: give a dict, or None"),
        ("task", "options 'task' are not possible"),
        ({"tasks": 1}, "there is no option 'tasks': choose from task"),
        ({"task": 1, 2: 3}, "there is no option 2: choose from task"),
        ({"task": 1.0}, "task 1.0 is not possible: it must be an integer"),
        ({"task": True}, "task True is not possible: it must be an integer"),
        ({"task": "0"}, "task '0' is not possible: it must be an integer"),
        ({"task": -1}, "there is no task -1: choose 0 to "),
    ],
)
def test_options_that_cannot_be_are_refused(tasks, options, message) -> None:
    env = PackItEnv(tasks, observation="none", max_shapes=40)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ArgumentError, match=re.escape(message)):
        env.reset(seed=1, options=options)
    assert env.get_state() == before
    env.reset(options={"task": np.int64(1)})
    assert env.reset(options={})[1]["task"] in range(len(tasks))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tasks": "others"}, "can't be restored in the task .*: their items or boxes differ"),
        ({"tasks": "fewer"}, "there is no task 4: choose 0 to 1"),
        ({"easy": True}, "the rules 'PackIt' can't be restored under the rules 'PackIt-Easy'"),
        ({"kinematic": True}, "under the rules 'PackIt, kinematic'"),
        ({"physics": True}, "under the rules 'PackIt, physics'"),
        ({"cells": (100, 100, 120)}, "under the rules 'PackIt, box of 100 x 100 x 120 cells'"),
        ({"rotation": None}, "a state in which Aligned plays rotations .* where the agent does"),
        ({"rotation": "random"}, "a state in which Aligned plays rotations .* where Random"),
        ({"shape": "largest-first"}, "a state in which the agent plays shapes can't be restored"),
    ],
)
def test_a_state_of_another_environment_is_refused(tasks, settings, message) -> None:
    """The environment that refuses is unchanged, whether or not it has begun an episode."""
    common = {"observation": "none", "max_shapes": 40}
    ours = PackItEnv(tasks, rotation="aligned", **common)
    ours.reset(seed=0, options={"task": 4})
    ours.step(0)
    state = pickle.loads(pickle.dumps(ours.get_state()))
    given = {"others": tasks[::-1], "fewer": tasks[:2]}.get(settings.get("tasks"), tasks)
    other = PackItEnv(**{"rotation": "aligned", **common, **settings, "tasks": given})
    with pytest.raises(ArgumentError, match=message):
        other.set_state(state)
    with pytest.raises(StateError):
        other.episode  # noqa: B018
    other.reset(seed=1, options={"task": 1})
    before = other.get_state()
    with pytest.raises(ArgumentError, match=message):
        other.set_state(state)
    assert other.get_state() == before
    again = PackItEnv(tasks, rotation="aligned", **common)
    again.set_state(state)
    assert again.get_state() == state


def test_what_is_not_a_state_is_refused(tasks) -> None:
    env = PackItEnv(tasks, observation="none", max_shapes=40)
    env.reset(seed=0)
    for nothing in (None, 5, env.episode.state()):
        with pytest.raises(ArgumentError, match=r"not a state: give what get_state\(\) returned"):
            env.set_state(nothing)
