"""The environment off the grid: what is free is decided exactly, whatever the pose."""

import copy
import json
import math
import pickle

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.utils.env_checker import check_env

from packit_agents.heuristics.continuous import GridPose, RandomPose
from packit_sim.box import Box
from packit_sim.core.errors import ArgumentError, InfeasibleError, StateError
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.game.envs.continuous import PackItContinuousEnv
from packit_sim.game.episodes.continuous import LooseBox
from packit_sim.geometry.items import PlacedItem, PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import is_valid
from tests.zoo import BALL, BOWL, CUBE, ZOO, cube_of

NAME = "PackItContinuous-v0"
SMALL = Task.of([cube_of(20), cube_of(12), cube_of(8)], (40, 40, 40))
UNTURNED = (1, 0, 0, 0)


def at(item: Item, x: float, y: float, z: float, degrees: float = 0.0) -> PosedItem:
    """An item with its centre there, turned about the vertical axis."""
    half = math.radians(degrees) / 2
    turn = Motion.from_wxyz((math.cos(half), 0.0, 0.0, math.sin(half)), np.array([x, y, z]))
    return PosedItem.at(item, turn)


@pytest.mark.parametrize("observation", ["features", "heightmap", "none"])
def test_gymnasiums_checker_finds_nothing_wrong(observation) -> None:
    env = gym.make(NAME, tasks=[SMALL], observation=observation, max_shapes=4)
    check_env(env.unwrapped, skip_render_check=True)


def test_on_the_grid_it_is_the_mask() -> None:
    """Items at grid nodes, as items off the grid, are free where the mask says so."""
    rng = np.random.default_rng(0)
    items = [Item(shape, 0.02 + 0.03 * rng.random(), int(rng.integers(24))) for shape in ZOO[:6]]
    grid, loose = Box((48, 48, 48)), LooseBox((48, 48, 48))
    compared = free = 0
    for item in items:
        mask = grid.feasible(item)
        nodes = rng.choice(mask.size, 12, replace=False).tolist()
        for location in (np.unravel_index(node, mask.shape) for node in nodes):
            placed = PlacedItem(item, tuple(map(int, location)))
            assert loose.is_free(PosedItem.of(placed)) == mask[location]
            compared, free = compared + 1, free + int(mask[location])
        location = grid.blbf(item)
        if location is not None:
            loose.put(item, location)
            grid.place(item, location)
    assert compared == 72 and 5 < free < 67


@pytest.mark.parametrize("degrees", [0, 20, 45, 73])
def test_turned_cubes_touch_where_geometry_says(degrees) -> None:
    """A cube turned by an angle beside a wall, and a second one turned alike beside it."""
    cube = cube_of(20)  # its side is 0.2
    angle = math.radians(degrees)
    reach = 0.1 * (abs(math.cos(angle)) + abs(math.sin(angle)))
    box = LooseBox((100, 100, 40))
    for slack, expected in ((-0.001, False), (0.001, True)):
        assert box.is_free(at(cube, reach + slack, 0.5, 0.1, degrees)) == expected
    first = at(cube, 0.5, 0.5, 0.1, degrees)
    box.place(first)
    along = np.array([math.cos(angle), math.sin(angle)])
    for slack, expected in ((-0.001, False), (0.001, True)):
        x, y = np.array([0.5, 0.5]) + (0.2 + slack) * along
        assert box.is_free(at(cube, x, y, 0.1, degrees)) == expected
    with pytest.raises(InfeasibleError, match="in conflict with items there"):
        box.place(at(cube, 0.5, 0.5, 0.12, 10))


def test_what_is_inside_another_item_is_not_free_unless_that_is_open() -> None:
    small = Item(BALL, 1e-4)
    for turn in (0, 33):
        box = LooseBox()
        box.place(at(Item(CUBE, 0.5), 0.5, 0.5, 0.4, turn))
        assert not box.is_free(at(small, 0.5, 0.5, 0.4, 10))
        assert not box.is_free(at(Item(CUBE, 4.0), 0.5, 0.5, 0.5, turn)), "nor what holds it"
    bowl = at(Item(BOWL, 0.05), 0.5, 0.5, 0.3, 12)
    box = LooseBox()
    box.place(bowl)
    assert box.is_free(at(Item(BALL, 1e-5), 0.5, 0.5, bowl.vertices[:, 2].max() - 0.02, 45))


def test_the_answer_does_not_depend_on_who_was_first() -> None:
    rng, crossing = np.random.default_rng(1), 0
    for _ in range(40):
        first, second = (
            at(
                Item(ZOO[rng.integers(len(ZOO))], 0.03),
                *rng.uniform(0.4, 0.6, 3),
                rng.uniform(0, 360),
            )
            for _ in range(2)
        )
        answers = {is_valid((100,) * 3, [a], b) for a, b in ((first, second), (second, first))}
        assert len(answers) == 1
        crossing += not answers.pop()
    assert 5 < crossing < 35


def play(env, agent, seed=0) -> tuple[float, list]:
    _, info = env.reset(seed=seed)
    rng, rewards, infos, over = np.random.default_rng(seed), [], [info], False
    while not over:
        _, reward, over, _, info = env.step(agent(env.unwrapped.episode, rng))
        rewards.append(reward)
        infos.append(info)
    assert len({tuple(info) for info in infos}) == 1
    return sum(rewards), infos


@pytest.mark.parametrize("agent", [GridPose(), RandomPose(20)], ids=["rule", "random"])
def test_agents_pack_validly(agent) -> None:
    env = gym.make(NAME, tasks=[SMALL], observation="none")
    total, infos = play(env, agent)
    box = env.unwrapped.episode.box
    assert 0 < total <= 1 + 1e-9 and len(infos) == 4
    assert infos[-1]["density"] == pytest.approx(total * SMALL.volume / box.volume)
    for n, posed in enumerate(box.placed):
        assert is_valid(box.cells, box.placed[:n], posed)
    assert (infos[-1]["end"] == "all placed") == (len(box.placed) == 3)
    assert [info["end"] for info in infos[:-1]] == ["", "", ""]


def test_the_rule_places_what_the_heuristic_places() -> None:
    """And goes on where the Heuristic's episode ends."""
    task = load_tasks("starter")[1]
    few = Task(task.items[:8], task.pack, ())
    env = PackItContinuousEnv([few], observation="none")
    play(env, GridPose())
    box = Box()
    for n in np.argsort([-item.volume for item in few.items], kind="stable"):
        turned = few.items[n].by_alignment[0]
        if (location := box.blbf(turned)) is not None:
            box.place(turned, location)
    assert [p.center.tolist() for p in box.placed] == [
        pytest.approx(p.center.tolist()) for p in env.episode.box.placed
    ]


@pytest.mark.parametrize(
    "action", [[0.5] * 6, [math.nan] + [0.5] * 6, "there", None, np.ones((7, 1)), [math.inf] * 7]
)
def test_actions_that_are_no_pose_are_refused_and_change_nothing(action) -> None:
    env = PackItContinuousEnv([SMALL], observation="none")
    with pytest.raises(StateError, match=r"call reset\(\) first"):
        env.step([0] * 7)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="it must be x, y, z and a quaternion w, x, y, z"):
        env.step(action)
    assert env.episode.waiting.all()


def test_an_item_that_is_not_free_stays_outside_and_the_next_has_its_turn() -> None:
    env = PackItContinuousEnv([SMALL], observation="none")
    env.reset(seed=0)
    largest = env.episode.item
    for action in ([0.2, 0.2, 0.2, 0, 0, 0, 0], [9, 9, 9, *UNTURNED], [0.2, 0.2, 0.2, 3, 0, 0, 0]):
        _, reward, over, _, info = env.step(action)
    assert over and info["placed"] and info["end"] == "no room" and 0 < reward < 1
    assert [p.item.volume < largest.volume for p in env.episode.box.placed] == [True]
    with pytest.raises(StateError, match="the episode is over: no room"):
        env.step([0] * 7)


@pytest.mark.parametrize("way", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_alike(way) -> None:
    env = PackItContinuousEnv([SMALL], observation="none", shape="random")
    env.reset(seed=3)
    env.step([0.1, 0.1, 0.1, *UNTURNED])
    again = way(env)
    for one in (env, again):
        one.step([0.3, 0.3, 0.3, 1, 0.2, 0, 0])
        one.rest = one.step([0.1, 0.3, 0.1, *UNTURNED])
    assert env.rest[1:] == again.rest[1:] and env.episode.box.placed == again.episode.box.placed


def test_it_is_recreated_from_its_spec_and_its_boxes_are_packs() -> None:
    settings = {"tasks": "starter", "observation": "none", "cells": (120, 100, 100)}
    spec = gym.make(NAME, **settings).spec
    env = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert env.unwrapped.cells == (120, 100, 100)
    env.reset(seed=0)
    _, _, _, _, info = env.step([0.6, 0.5, 0.5, 0.9, 0.1, 0.2, 0.3])
    assert info["placed"]
    episode = env.unwrapped.episode
    pack = Pack.of(episode.box, episode.task.pack.library)
    assert Pack.from_json(pack.to_json()) == pack and json.loads(pack.to_json())["items"][0]["pose"]
    shown = gym.make(NAME, tasks=[SMALL], observation="none", render_mode="rgb_array")
    shown.reset()
    assert shown.render().shape == (512, 512, 3)
    shown.close()


def test_settings_that_cannot_be_are_refused() -> None:
    for settings, message in (
        ({"observation": "placement-features"}, "choose from 'features', 'heightmap', 'voxels'"),
        ({"cells": (10, 10, 10)}, "a box of 10 x 10 x 10 cells is not possible"),
        ({"max_shapes": 2}, "a task has 3 items: max_shapes is only 2"),
        ({"cells": (12, 12, 12)}, "it fits into no box of"),
        ({"render_mode": "ascii"}, "render mode 'ascii' is not known"),
    ):
        with pytest.raises(ArgumentError, match=message):
            PackItContinuousEnv([SMALL], **settings)
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        gym.make(NAME, frameskip=4)
    thin = Shape.from_mesh(trimesh.creation.box((1, 1, 0.01)), "thin")
    assert PackItContinuousEnv(lambda rng: Task.of([Item(thin, 0.01)])).reset(seed=0)
