import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from packit_sim.core.errors import ArgumentError
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.wrappers import features_only, flattened

SHAPE_ONLY = {"rotation": "aligned", "location": "blbf", "max_shapes": 40}


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")  # it is, on purpose
@pytest.mark.parametrize("wrap", [features_only, flattened])
@pytest.mark.parametrize("name", ["PackIt-v0", "PackItEasy-v0"])
@pytest.mark.parametrize("observation", ["features", "none"])
def test_gymnasiums_checker_is_content(wrap, name, observation) -> None:
    check_env(wrap(gym.make(name, observation=observation, max_shapes=40)), skip_render_check=True)


@pytest.mark.parametrize("observation", ["features", "none"])
def test_features_only_leaves_all_but_the_mask_as_it_was(observation) -> None:
    bare = PackItEnv(observation=observation, **SHAPE_ONLY)
    env = features_only(PackItEnv(observation=observation, **SHAPE_ONLY))
    seen, whole = env.reset(seed=4)[0], bare.reset(seed=4)[0]
    for _ in range(3):
        assert seen in env.observation_space
        assert seen.keys() == whole.keys() - {"action_mask"}
        assert all(np.array_equal(seen[key], whole[key]) for key in seen)
        masks = env.get_wrapper_attr("action_masks")()
        assert (masks == whole["action_mask"]).all()
        action = int(np.flatnonzero(masks)[0])
        seen, whole = env.step(action)[0], bare.step(action)[0]


def test_a_flattened_observation_is_the_features_in_float32_one_after_the_other() -> None:
    bare = PackItEnv(observation="features", max_shapes=40)
    env = flattened(PackItEnv(observation="features", max_shapes=40))
    seen, whole = env.reset(seed=4)[0], bare.reset(seed=4)[0]
    for action in (0, 5, None):
        assert seen.dtype == np.float32 and seen in env.observation_space
        parts = {
            **{key: np.ravel(value) for key, value in whole.items()},
            "stage": np.eye(3)[whole["stage"]],
            "chosen": np.eye(41)[whole["chosen"]],
        }
        del parts["action_mask"]
        assert np.array_equal(
            seen, np.concatenate([np.float32(parts[key]) for key in sorted(parts)])
        )
        assert (env.get_wrapper_attr("action_masks")() == whole["action_mask"]).all()
        if action is not None:
            seen, whole = env.step(action)[0], bare.step(action)[0]


@pytest.mark.parametrize("wrap", [features_only, flattened])
def test_a_wrapped_environment_can_be_created_from_its_spec(wrap) -> None:
    env = wrap(gym.make("PackIt-v0", observation="features", **SHAPE_ONLY))
    spec = gym.envs.registration.EnvSpec.from_json(env.spec.to_json())
    again = gym.make(spec)
    assert again.observation_space == env.observation_space
    assert type(again) is type(env)


@pytest.mark.parametrize("wrap", [features_only, flattened])
@pytest.mark.parametrize("vectorization", ["sync", pytest.param("async", marks=pytest.mark.slow)])
def test_wrapped_vector_environments_play_like_a_single_one(wrap, vectorization) -> None:
    settings = {"observation": "features", **SHAPE_ONLY}
    single = wrap(PackItEnv(**settings))
    envs = gym.make_vec("PackIt-v0", 2, vectorization, wrappers=[wrap], **settings)
    try:
        seen, _ = envs.reset(seed=[4, 5])
        alone, _ = single.reset(seed=4)
        for _ in range(3):
            first = {k: v[0] for k, v in seen.items()} if isinstance(seen, dict) else seen[0]
            for key in alone if isinstance(alone, dict) else [...]:
                assert np.array_equal(first[key], alone[key])
            masks = np.stack(envs.call("action_masks"))
            assert (masks[0] == single.get_wrapper_attr("action_masks")()).all()
            actions = masks.argmax(axis=1)
            seen, rewards, over, _, _ = envs.step(actions)
            alone, reward, done, _, _ = single.step(actions[0])
            assert (rewards[0], over[0]) == (reward, done)
    finally:
        envs.close()


def test_only_dict_observations_can_lose_their_mask() -> None:
    env = flattened(PackItEnv(observation="none", **SHAPE_ONLY))
    with pytest.raises(ArgumentError, match="must be dicts, not of space Box"):
        features_only(env)


def test_voxels_are_too_large_for_a_vector() -> None:
    env = PackItEnv(observation="voxels", **SHAPE_ONLY)
    with pytest.raises(ArgumentError, match=r"vector of 42,\d+,\d+ numbers, 168 MB.*'features'"):
        flattened(env)
