"""Other libraries drive the environments as they are; those that are not installed are skipped."""

import importlib
import json

import gymnasium as gym
import numpy as np
import pytest

from packit_sim.core.errors import LibraryError
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.recording import record
from packit_sim.game.envs.wrappers import features_only, flattened
from packit_sim.game.episodes.agents import Agent
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.rules import Rules

SHAPES_ONLY = {"rotation": "aligned", "location": "blbf", "observation": "none", "max_shapes": 40}
IDS = ("PackIt-v0", "PackItEasy-v0")


@pytest.mark.parametrize("call", [PackItEnv, Rules().changed, lambda **x: gym.make(IDS[0], **x)])
def test_an_unknown_setting_is_an_error_in_pythons_words(call) -> None:
    """Others try a setting, and leave it out if Python says that there is none of the name."""
    with pytest.raises(TypeError, match=r"\(\) got an unexpected keyword argument 'frameskip': "):
        call(frameskip=4)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_torchrl_plays_by_the_masks(name) -> None:
    pytest.importorskip("torchrl", reason="torchrl is not installed")
    envs = importlib.import_module("torchrl.envs")
    with envs.set_gym_backend("gymnasium"):
        env = envs.GymEnv(f"packit_sim:{name}", **SHAPES_ONLY, categorical_action_encoding=True)
    env = envs.TransformedEnv(env, envs.ActionMask())
    try:
        seen = env.rollout(3)
        assert bool((seen["action_mask"].gather(-1, seen["action"].unsqueeze(-1)) == 1).all())
    finally:
        env.close()


@pytest.mark.parametrize(
    ("name", "wrap"),
    [("PackIt-v0", flattened), ("PackItEasy-v0", features_only), ("PackIt-v0", lambda env: env)],
)
def test_masks_in_info_are_as_gymnasium_samples_by_them(name, wrap) -> None:
    env = wrap(gym.make(name, **SHAPES_ONLY))
    _, info = env.reset(seed=0)
    keys, over = list(info), False
    env.action_space.seed(0)
    while not over:
        assert info["action_mask"].dtype == np.int8 and info["end"] == ""
        _, _, over, _, info = env.step(env.action_space.sample(mask=info["action_mask"]))
        assert list(info) == keys
    assert info["end"] == "no room" and not info["action_mask"].any()


@pytest.mark.parametrize("vectorization", ["vector_entry_point", "sync"])
def test_masks_in_the_infos_of_vectors_are_as_gymnasium_samples_by_them(vectorization) -> None:
    envs = gym.make_vec("PackIt-v0", 2, vectorization, **SHAPES_ONLY)
    _, infos = envs.reset(seed=0)
    envs.action_space.seed(0)
    for _ in range(3):
        assert infos["action_mask"].dtype == np.int8 and infos["end"].tolist() == ["", ""]
        actions = envs.action_space.sample(mask=tuple(infos["action_mask"]))
        _, rewards, *_, infos = envs.step(actions)
        assert (rewards > 0).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`.*` is set to None")  # advice on metadata
@pytest.mark.filterwarnings("ignore:.*:pytest.PytestUnraisableExceptionWarning")  # its old folders
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
def test_minari_collects_infos_and_recreates_the_environment(tmp_path, monkeypatch) -> None:
    pytest.importorskip("jax", reason="minari collects by jax: pip install 'minari[create]'")
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    library = ShapeLibrary.open("everyday").split("test")
    env = minari.DataCollector(
        gym.make("PackIt-v0", library=library, tasks="fresh", **SHAPES_ONLY), record_infos=True
    )
    with env:
        for seed in range(2):
            _, info = env.reset(seed=seed)
            over = False
            while not over:
                _, _, over, _, info = env.step(int(info["action_mask"].argmax()))
        dataset = env.create_dataset("packit/test-v0")
    ends = [episode.infos["end"] for episode in dataset.iterate_episodes()]
    assert [(end[0], end[-1]) for end in ends] == [(b"", b"no room")] * 2
    again = dataset.recover_environment().unwrapped
    assert again.maker.library.ids == library.ids


class Masked(gym.ObservationWrapper):
    """Observations as RLlib's action-masking module takes them."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        mask = gym.spaces.Box(0, 1, (int(env.action_space.n),), np.float32)
        spaces = {"observations": env.observation_space, "action_mask": mask}
        self.observation_space = gym.spaces.Dict(spaces)

    def observation(self, observation):
        mask = self.unwrapped.action_masks().astype(np.float32)
        return {"observations": observation, "action_mask": mask}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # RLlib deprecates much of itself
def test_rllib_learns_by_the_masks(monkeypatch) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    pytest.importorskip("ray.rllib", reason="RLlib is not installed")
    ray, ppo, masking, modules, registry = (
        importlib.import_module(name)
        for name in (
            "ray",
            "ray.rllib.algorithms.ppo",
            "ray.rllib.examples.rl_modules.classes.action_masking_rlm",
            "ray.rllib.core.rl_module.rl_module",
            "ray.tune.registry",
        )
    )

    class Watched(gym.Wrapper):
        def step(self, action):
            result = super().step(action)
            assert result[-1]["end"] != "invalid action"
            return result

    registry.register_env(
        "packit", lambda settings: Masked(Watched(flattened(gym.make("PackIt-v0", **settings))))
    )
    config = (
        ppo.PPOConfig()
        .environment("packit", env_config=SHAPES_ONLY)
        .env_runners(num_env_runners=0, rollout_fragment_length=64)
        .rl_module(
            rl_module_spec=modules.RLModuleSpec(module_class=masking.ActionMaskingTorchRLModule)
        )
        .training(train_batch_size_per_learner=64, minibatch_size=32, num_epochs=1)
    )
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        algorithm = config.build_algo()
        found = algorithm.train()["env_runners"]
        algorithm.stop()
    finally:
        ray.shutdown()
    assert found["num_env_steps_sampled"] >= 64 and found["episode_return_mean"] > 0


@pytest.mark.slow
def test_d3rlpy_learns_from_a_recording(tmp_path) -> None:
    """The shapes that the Heuristic chooses, by behaviour cloning for a few steps."""
    pytest.importorskip("d3rlpy", reason="d3rlpy is not installed")
    algos, constants, data, logging = (
        importlib.import_module(f"d3rlpy.{name}")
        for name in ("algos", "constants", "dataset", "logging")
    )
    env = flattened(gym.make("PackIt-v0", **SHAPES_ONLY))
    recording = record(
        env, tmp_path / "heuristic", Agent.from_name("largest-first/aligned/blbf"), episodes=2
    )
    episodes = list(recording.iterate_episodes())
    columns = [
        [episode.observations[:-1] for episode in episodes],
        *([getattr(e, name) for e in episodes] for name in ("actions", "rewards", "terminations")),
    ]
    steps = [np.concatenate(column).astype(np.float32) for column in columns]
    dataset = data.MDPDataset(
        *steps, action_space=constants.ActionSpace.DISCRETE, action_size=int(env.action_space.n)
    )
    cloning = algos.DiscreteBCConfig(batch_size=8).create(device="cpu")
    cloning.fit(
        dataset,
        n_steps=5,
        n_steps_per_epoch=5,
        show_progress=False,
        logger_adapter=logging.NoopAdapterFactory(),
    )
    assert (cloning.predict(steps[0][:3]) < env.action_space.n).all()


@pytest.mark.parametrize("name", ["library", "split", "folder"])
def test_a_spec_with_objects_is_written_as_json(name, tmp_path) -> None:
    library = ShapeLibrary.open("everyday")
    if name == "folder":
        (tmp_path / "cube.obj").write_text(CUBE)
        library = ShapeLibrary.open(tmp_path)
    elif name == "split":
        library = library.split("test")
    rules = Rules(cells=(80, 80, 60), kinematic=True)
    settings = {**SHAPES_ONLY, "tasks": "fresh", "library": library, "rules": rules}
    env = flattened(gym.make("PackIt-v0", **settings))
    text = env.spec.to_json()
    again = gym.make(gym.envs.registration.EnvSpec.from_json(text))
    assert again.unwrapped.maker.library.ids == library.ids
    assert again.unwrapped.rules == rules and type(again) is type(env)
    assert again.reset(seed=1)[0].tolist() == env.reset(seed=1)[0].tolist()
    assert json.loads(text)["kwargs"]["library"]["digest"] == library.digest


CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def test_a_library_that_changed_since_the_spec_is_refused(tmp_path) -> None:
    (tmp_path / "one.obj").write_text(CUBE)
    record = ShapeLibrary.open(tmp_path).to_json()
    (tmp_path / "two.obj").write_text(CUBE)
    with pytest.raises(LibraryError, match=r"is not the recorded library .* its digest is"):
        PackItEnv("fresh", record)
    with pytest.raises(LibraryError, match="field 'digets' is unknown"):
        PackItEnv("fresh", {**record, "digets": ""})


def test_physics_of_a_spec_are_settings_again() -> None:
    physics = PhysicsSettings(friction=0.7)
    spec = gym.make("PackItPhysics-v0", physics=physics, **SHAPES_ONLY).spec
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert again.unwrapped.rules.physics == physics
