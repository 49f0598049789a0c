"""The features extractor for stable-baselines3, and PackNN as its policy."""

import gymnasium
import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")

import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks
from stable_baselines3.common.preprocessing import preprocess_obs
from stable_baselines3.common.utils import obs_as_tensor

from packit_agents.learning.actor_critic import ActorCritic
from packit_agents.learning.features_extractor import ShapeSetExtractor
from packit_agents.learning.networks import NetworkSettings
from packit_sim.core.errors import ArgumentError
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.wrappers import flattened
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.episodes.policy_registry import load_policy

SHAPE_ONLY = {"rotation": "aligned", "location": "blbf", "max_shapes": 40}
SMALL = NetworkSettings(width=16, encoder_blocks=1, trunk_blocks=1)
TINY = {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "seed": 0, "device": "cpu"}


def observed(env: PackItEnv, steps: int) -> dict[str, np.ndarray]:
    """Observations of some steps, stacked."""
    seen = [env.reset(seed=2)[0]]
    seen += [env.step(int(np.flatnonzero(env.action_masks())[-1]))[0] for _ in range(steps - 1)]
    return {key: np.stack([each[key] for each in seen]) for key in seen[0]}


def features(
    extractor: ShapeSetExtractor, env: PackItEnv, batch: dict[str, np.ndarray]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Features of the shapes (b, n, k), and of the state (b, w)."""
    tensors = preprocess_obs(obs_as_tensor(batch, "cpu"), env.observation_space)
    with torch.inference_mode():
        output = extractor(tensors)
    slots = batch["outside"].shape[1]
    per_shape = (extractor.features_dim - extractor.state[0][0].out_features) // slots
    assert output.shape == (len(batch["outside"]), extractor.features_dim)
    assert output.dtype == torch.float32
    return output[:, : slots * per_shape].unflatten(1, (slots, per_shape)), output[
        :, slots * per_shape :
    ]


def permuted(batch: dict[str, np.ndarray], order: np.ndarray) -> dict[str, np.ndarray]:
    """The same observations with the shapes in another order."""
    rows = ("outside", "volumes", "shapes", "extents", "placement_features")
    turned = {key: field[:, order] if key in rows else field for key, field in batch.items()}
    places = np.append(np.argsort(order), len(order))  # the last: no shape is chosen
    return {**turned, "chosen": places[batch["chosen"]]}


@pytest.mark.parametrize(
    "settings",
    [
        {"observation": "features", **SHAPE_ONLY},
        {"observation": "placement-features", **SHAPE_ONLY},
        {"observation": "features", "max_shapes": 40},
    ],
    ids=["features", "placement features", "all sub-tasks"],
)
def test_features_change_places_with_the_shapes(settings) -> None:
    env = PackItEnv(**settings)
    batch = observed(env, 5)
    torch.manual_seed(0)
    extractor = ShapeSetExtractor(env.observation_space, width=16, shape_features=3)
    shapes, state = features(extractor, env, batch)
    assert shapes[batch["outside"]].any(1).all() and not shapes[~batch["outside"]].any()
    order = np.random.default_rng(1).permutation(40)
    shapes_turned, state_turned = features(extractor, env, permuted(batch, order))
    torch.testing.assert_close(shapes_turned, shapes[:, order])
    torch.testing.assert_close(state_turned, state)


def test_shapes_in_the_box_and_the_chosen_one_matter_as_they_should() -> None:
    env = PackItEnv(max_shapes=40)
    batch = observed(env, 4)  # a shape, a rotation, a location, and the next shape
    assert batch["chosen"].tolist()[0] == 40 > batch["chosen"][1]
    torch.manual_seed(0)
    extractor = ShapeSetExtractor(env.observation_space, width=16)
    before = features(extractor, env, batch)
    inside = ~batch["outside"]
    assert inside.any()
    other = {**batch, "shapes": np.where(inside[..., None, None, None], 0.5, batch["shapes"])}
    other["shapes"] = other["shapes"].astype(np.float32)
    for expected, found in zip(before, features(extractor, env, other), strict=True):
        torch.testing.assert_close(found, expected)
    other = {**batch, "chosen": np.full_like(batch["chosen"], 40)}
    shapes, _ = features(extractor, env, other)
    chosen = int(batch["chosen"][1])
    assert not torch.allclose(shapes[1, chosen], before[0][1, chosen])
    torch.testing.assert_close(shapes[0], before[0][0])


@pytest.mark.parametrize("shape_features", [1, 4])
def test_gradients_reach_every_weight_of_the_extractor(shape_features) -> None:
    env = gymnasium.make("packit_sim:PackIt-v0", observation="features", **SHAPE_ONLY)
    keywords = {
        "features_extractor_class": ShapeSetExtractor,
        "features_extractor_kwargs": {"width": 16, "shape_features": shape_features},
    }
    model = MaskablePPO("MultiInputPolicy", env, policy_kwargs=keywords, **TINY)
    extractor = model.policy.features_extractor
    assert isinstance(extractor, ShapeSetExtractor)
    assert extractor.features_dim == 40 * shape_features + 16
    before = {name: value.clone() for name, value in extractor.named_parameters()}
    model.learn(64)
    for name, value in extractor.named_parameters():
        assert (value != before[name]).any(), name


@pytest.mark.parametrize("reader", ["MultiInputPolicy", ActorCritic])
def test_what_it_cannot_read_is_refused(reader) -> None:
    keywords = {}
    if reader != ActorCritic:
        keywords = {"features_extractor_class": ShapeSetExtractor}

    def model(env: gymnasium.Env, policy: object = reader) -> MaskablePPO:
        return MaskablePPO(policy, env, policy_kwargs=keywords, **TINY)

    with pytest.raises(ArgumentError, match=r"observes voxels: make it with observation='features"):
        model(PackItEnv(observation="voxels", **SHAPE_ONLY))
    with pytest.raises(ArgumentError, match="observes no shapes: make it with"):
        model(PackItEnv(observation="none", **SHAPE_ONLY))
    with pytest.raises(ArgumentError, match="observes one vector: make it with"):
        model(flattened(PackItEnv(**SHAPE_ONLY)), "MlpPolicy" if reader != ActorCritic else reader)


def test_settings_of_networks_that_can_not_be_are_refused() -> None:
    env = PackItEnv(**SHAPE_ONLY)
    with pytest.raises(ArgumentError, match="setting width = 0 is not possible"):
        ShapeSetExtractor(env.observation_space, width=0)
    with pytest.raises(ArgumentError, match="setting shape_features = -1 is not possible"):
        ShapeSetExtractor(env.observation_space, shape_features=-1)
    with pytest.raises(ArgumentError, match=r"one of 40 shapes can't play .* with 15625 actions"):
        MaskablePPO(ActorCritic, PackItEnv(max_shapes=40), **TINY)


def test_packnn_learns_as_a_policy_and_its_weights_play_the_same(tmp_path) -> None:
    env = gymnasium.make("packit_sim:PackIt-v0", **SHAPE_ONLY)
    model = MaskablePPO(ActorCritic, env, policy_kwargs={"settings": SMALL}, **TINY)
    before = {name: value.clone() for name, value in model.policy.named_parameters()}
    model.learn(64)
    changed = [(value != before[name]).any() for name, value in model.policy.named_parameters()]
    assert all(changed)
    model.policy.write_weights(tmp_path / "own.safetensors", {"steps": 64})
    policy = load_policy(Stage.SHAPE, f"learned@{tmp_path / 'own.safetensors'}")
    assert policy.provenance == {"steps": 64}
    bare = env.unwrapped
    model.policy.save(tmp_path / "policy.zip")
    loaded = ActorCritic.load(tmp_path / "policy.zip").state_dict()
    assert all((value == loaded[name]).all() for name, value in model.policy.state_dict().items())
    rng = np.random.default_rng(0)
    seen, _ = env.reset(seed=5)
    for _ in range(4):
        action, _ = model.predict(seen, deterministic=True, action_masks=get_action_masks(env))
        assert isinstance(bare.episode, Episode) and policy(bare.episode, rng) == action
        seen, *_ = env.step(action)
