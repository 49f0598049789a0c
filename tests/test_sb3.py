"""Stable-Baselines3 and sb3-contrib play the environments as they are."""

import functools
import multiprocessing

import gymnasium as gym
import numpy as np
import pytest

from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.wrappers import features_only, flattened

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")

from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

SHAPE_ONLY = {"rotation": "aligned", "location": "blbf", "max_shapes": 40}
FREE = {"max_shapes": 40}

advice_on_pictures = pytest.mark.filterwarnings(
    "ignore:It seems that your observation.* is an image but",
    "ignore:The minimal resolution for an image",
    "ignore:Your observation .* has an unconventional shape",
)
"""What the checker says of any Box of two or more axes that is no uint8 picture."""


each_setting = pytest.mark.parametrize(
    "settings", [FREE, SHAPE_ONLY], ids=["all sub-tasks", "shapes only"]
)
each_name = pytest.mark.parametrize("name", ["PackIt-v0", "PackItEasy-v0"])


@advice_on_pictures
@each_setting
@each_name
@pytest.mark.parametrize(
    "observation", ["none", "features", pytest.param("voxels", marks=pytest.mark.slow)]
)
def test_the_checker_has_only_advice_on_pictures(name, observation, settings) -> None:
    check_env(gym.make(name, observation=observation, **settings))


@each_name
def test_the_checker_is_content_where_there_are_no_grids(name) -> None:
    check_env(gym.make(name, observation="none", **SHAPE_ONLY))
    check_env(flattened(gym.make(name, observation="features", **SHAPE_ONLY)))
    check_env(flattened(gym.make(name, observation="none", **FREE)))


@pytest.mark.parametrize(
    "vectorized", [DummyVecEnv, pytest.param(SubprocVecEnv, marks=pytest.mark.slow)]
)
def test_vector_environments_play_like_single_ones(vectorized) -> None:
    settings = {"observation": "features", **SHAPE_ONLY}
    multiprocessing.set_forkserver_preload(
        ["packit_sim.game.envs.env"]
    )  # once, not in each process
    envs = vectorized([functools.partial(gym.make, "packit_sim:PackIt-v0", **settings)] * 2)
    singles = [PackItEnv(**settings) for _ in range(2)]
    finished = 0
    try:
        envs.seed(7)  # the second's is 8
        seen = envs.reset()
        alone = [env.reset(seed=7 + n)[0] for n, env in enumerate(singles)]
        for _ in range(45):
            masks = get_action_masks(envs)
            actions = masks.argmax(axis=1)
            for n, env in enumerate(singles):
                assert all(np.array_equal(seen[key][n], alone[n][key]) for key in alone[n])
                assert (masks[n] == env.action_masks()).all()
            seen, rewards, dones, infos = envs.step(actions)
            for n, env in enumerate(singles):
                alone[n], reward, over, _, info = env.step(actions[n])
                assert rewards[n] == rewards.dtype.type(reward) and dones[n] == over
                assert infos[n]["density"] == info["density"]
                if over:
                    last = infos[n]["terminal_observation"]
                    assert all(np.array_equal(last[key], alone[n][key]) for key in last)
                    assert infos[n]["end"] == info["end"]
                    alone[n] = env.reset()[0]
                    finished += 1
        assert finished >= 2
    finally:
        envs.close()


class Watched(gym.Wrapper):
    """Counts the actions played, and those of them that were valid."""

    played = valid = 0

    def step(self, action):
        self.played += 1
        self.valid += bool(self.get_wrapper_attr("action_masks")()[action])
        return super().step(action)


@pytest.mark.parametrize(
    ("wrap", "policy"), [(features_only, "MultiInputPolicy"), (flattened, "MlpPolicy")]
)
def test_maskable_ppo_trains_on_valid_actions_alone_and_needs_no_action_masker(
    wrap, policy
) -> None:
    settings = {"observation": "features", **SHAPE_ONLY}
    watched = [Watched(gym.make("PackIt-v0", **settings)) for _ in range(2)]
    envs = DummyVecEnv([lambda env=env: wrap(env) for env in watched])
    envs.reset()
    assert is_masking_supported(envs)
    assert (get_action_masks(envs) == [env.unwrapped.action_masks() for env in watched]).all()

    model = MaskablePPO(
        policy,
        envs,
        n_steps=32,
        batch_size=32,
        n_epochs=1,
        policy_kwargs={"net_arch": [16]},
        seed=0,
        device="cpu",
    )
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    model.learn(128)
    assert [env.played for env in watched] == [env.valid for env in watched] == [64, 64]
    assert any((before[name] != value).any() for name, value in model.policy.state_dict().items())

    seen = envs.reset()
    actions, _ = model.predict(seen, action_masks=get_action_masks(envs))
    assert get_action_masks(envs)[[0, 1], actions].all()


def test_maskable_ppo_chooses_among_all_three_sub_tasks() -> None:
    env = Watched(gym.make("PackIt-v0", observation="none", **FREE))
    model = MaskablePPO(
        "MultiInputPolicy", features_only(env), n_steps=32, batch_size=32, n_epochs=1, device="cpu"
    )
    model.learn(64)
    assert env.played == env.valid == 64
