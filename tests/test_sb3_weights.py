"""Models of stable-baselines3 become agents: their weights, written without code."""

import json
import pickle

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")

from safetensors import safe_open
from safetensors.torch import save_file
from sb3_contrib import MaskablePPO
from stable_baselines3 import A2C, DQN, PPO
from torch import nn

from packit_agents.learning.features_extractor import ShapeSetExtractor
from packit_agents.learning.sb3_weights import write_policy
from packit_agents.learning.weights import WeightsError
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.envs.wrappers import features_only, flattened
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import evaluate

SHAPES = {"rotation": "aligned", "location": "blbf", "max_shapes": 40}
EXTRACTOR = {"features_extractor_class": ShapeSetExtractor, "net_arch": []}


def made(kind, name, env, **policy):
    more = {"buffer_size": 10} if kind is DQN else {"n_steps": 64}
    return kind(name, env, policy_kwargs=policy, seed=0, device="cpu", **more)


@pytest.mark.parametrize(
    ("kind", "name", "wrap", "settings", "policy"),
    [
        (MaskablePPO, "MultiInputPolicy", None, {}, EXTRACTOR),
        (PPO, "MultiInputPolicy", features_only, {"easy": True}, {"net_arch": [8]}),
        (A2C, "MlpPolicy", flattened, {"observation": "none"}, {"activation_fn": nn.ReLU}),
        (DQN, "MlpPolicy", flattened, {"observation": "none"}, {"net_arch": [8, 8]}),
        (MaskablePPO, "MultiInputPolicy", None, {"rotation": None, "location": None}, EXTRACTOR),
        (DQN, "MlpPolicy", flattened, {"observation": "none", "values": True}, {"net_arch": [8]}),
    ],
    ids=["MaskablePPO", "PPO", "A2C", "DQN", "all sub-tasks", "values"],
)
def test_an_agent_plays_as_the_model_does(kind, name, wrap, settings, policy, tmp_path) -> None:
    tasks = [task.valued(lambda item: 1 + item.volume) for task in load_tasks("starter")[:2]]
    env = gym.make("PackIt-v0", **{**SHAPES, "tasks": tasks, **settings})
    env = wrap(env) if wrap else env
    model = made(kind, name, env, **policy)
    write_policy(tmp_path / "mine.safetensors", model.policy, env, {"steps": 0})
    learned = f"learned@{tmp_path / 'mine.safetensors'}"
    every = settings.get("rotation", "") is None
    agent = Agent.from_name(learned if every else f"{learned}/aligned/blbf")
    agent = pickle.loads(pickle.dumps(agent))
    assert agent.shape.provenance == {"steps": 0} and len(agent.weights) == 16
    seen, info = env.reset(seed=0)
    for _ in range(4):
        episode = env.unwrapped.episode
        mask = info["action_mask"].astype(bool)
        action = agent.act(episode, np.random.default_rng(0))
        assert mask[action]
        if kind is MaskablePPO:
            assert action == model.predict(seen, action_masks=mask, deterministic=True)[0]
        elif mask[free := int(model.predict(seen, deterministic=True)[0])]:
            assert action == free
        seen, _, over, _, info = env.step(action)
        if over:
            break


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    env = gym.make("PackIt-v0", observation="none", **SHAPES)
    model = made(MaskablePPO, "MultiInputPolicy", env, net_arch=[4])
    file = tmp_path_factory.mktemp("weights") / "mine.safetensors"
    write_policy(file, model.policy, env)
    return file, env, model


def test_it_is_evaluated_and_searched_with_like_any_agent(written) -> None:
    tasks = load_tasks("starter")[1:2]
    alone, beam = (f"learned@{written[0]}/aligned/blbf{more}" for more in ("", "+beam=2"))
    first, searched = evaluate([alone, beam], tasks, seed=0)
    assert 0 < first.total <= searched.total and first.weights == searched.weights


def test_other_sub_tasks_and_larger_tasks_are_refused(written) -> None:
    with pytest.raises(WeightsError, match="chooses shape, not rotations"):
        Agent.from_name(f"largest-first/learned@{written[0]}/blbf")
    env = gym.make("PackIt-v0", cells=(120, 100, 100), observation="none", **SHAPES).unwrapped
    env.reset(seed=0)
    agent = Agent.from_name(f"learned@{written[0]}/aligned/blbf")
    with pytest.raises(WeightsError, match=r"boxes of \(100, 100, 100\) cells with at most 40 it"):
        agent.act(env.episode, np.random.default_rng(0))


def test_policies_of_unknown_parts_are_refused(written, tmp_path) -> None:
    _, env, model = written
    with pytest.raises(ArgumentError, match="the policy has the observation space"):
        write_policy(tmp_path / "a", model.policy, features_only(env))
    with pytest.raises(ArgumentError, match="is not an environment of PackIt-Sim"):
        write_policy(tmp_path / "a", model.policy, gym.make("CartPole-v1"))
    odd = made(MaskablePPO, "MultiInputPolicy", env, net_arch=[4], activation_fn=nn.Hardswish)
    with pytest.raises(ArgumentError, match=r"Hardswish can't be written .* known activations are"):
        write_policy(tmp_path / "a", odd.policy, env)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"layers": [10**9]}, "'layers"),
        ({"layers": [4096, 4096]}, "metadata: its layers have more numbers than its tensors"),
        ({"layers": [3]}, "contradicts its own metadata: tensor .* has the shape"),
        ({"policy": "os.system"}, "contradicts its own metadata: .*'os.system' is not known"),
        ({"extractor_settings": {"widht": 4}}, "contradicts its own metadata"),
        ({"observation": "voxels"}, "'observation' is 'voxels': choose from"),
        ({"cells": [1, 2, 3]}, "contradicts its own metadata"),
        ({"observation": "heightmap", "max_shapes": 999}, "heightmaps of 19,980,000 numbers"),
        ({"max_shapes": 10**9}, "'max_shapes' is 1000000000"),
        ({"code": "x"}, "field 'code' is unknown"),
    ],
)
def test_forged_weights_are_refused_before_anything_is_built(
    written, tmp_path, change, message
) -> None:
    with safe_open(written[0], framework="pt") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    metadata["record"] = json.dumps({**json.loads(metadata["record"]), **change})
    save_file(tensors, tmp_path / "forged.safetensors", metadata)
    with pytest.raises(WeightsError, match=message):
        Agent.from_name(f"learned@{tmp_path / 'forged.safetensors'}/aligned/blbf")
