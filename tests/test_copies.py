"""Copies of environments and scenes: they go on identically, and share no renderer and no page."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest

from packit_sim import Scene
from packit_sim.core.errors import RenderError
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.wrappers import features_only, flattened

Copier = Callable[[Any], Any]

WAYS: dict[str, Copier] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
    "cloudpickle": lambda one: pickle.loads(cloudpickle.dumps(one)),
}

STATES = "new", "reset", "rendered", "closed"

QUICK = {("new", "pickle"), ("rendered", "deepcopy"), ("closed", "cloudpickle")}


@pytest.fixture(autouse=True)
def _software(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PACKIT_RENDERER", "software")


def made(name: str, state: str, mode: str) -> gymnasium.Env[Any, Any]:
    env = gymnasium.make(name, render_mode=mode, rotation="aligned", location="blbf")
    if state != "new":
        env.reset(seed=1)
        env.step(0)
    if state in ("rendered", "closed"):
        env.render()
    if state == "closed":
        env.close()
    return env


def played(env: gymnasium.Env[Any, Any], steps: int = 2) -> list[Any]:
    """What an environment returns, with its frames."""
    found: list[Any] = []
    if not env.get_wrapper_attr("has_reset"):
        found += env.reset(seed=3)
    for _ in range(steps):
        mask = env.get_wrapper_attr("action_masks")()
        found += env.step(int(mask.argmax()))
        found.append(env.render())
    return found


def is_same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(is_same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(is_same, one, other))
    return type(one) is type(other) and np.array_equal(one, other)


def check(env: gymnasium.Env[Any, Any], copied: gymnasium.Env[Any, Any]) -> None:
    before, after = env.unwrapped, copied.unwrapped
    assert isinstance(before, PackItEnv) and isinstance(after, PackItEnv) and after is not before
    assert is_same(played(copied), played(env))
    copied.close()
    env.render()  # its renderer is still open
    env.close()


@pytest.mark.parametrize(
    ("state", "way"),
    [
        pytest.param(state, way, marks=() if (state, way) in QUICK else pytest.mark.slow)
        for state in STATES
        for way in WAYS
    ],
)
def test_a_copy_of_an_environment_goes_on_identically(state, way) -> None:
    env = made("PackItEasy-v0", state, "rgb_array")
    if way == "copy":  # of a wrapper, it has the same environment
        inner = env.unwrapped
        assert copy.copy(inner) is not inner
        return
    check(env, WAYS[way](env))


@pytest.mark.slow
@pytest.mark.parametrize("wrapper", [features_only, flattened])
@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_a_copy_of_a_wrapped_environment_goes_on_identically(wrapper, way) -> None:
    env = wrapper(made("PackItEasy-v0", "rendered", "rgb_array"))
    check(env, WAYS[way](env))


@pytest.mark.parametrize("way", ["pickle"])
def test_a_copy_opens_its_own_page(way, caplog) -> None:
    env = made("PackItEasy-v0", "reset", "human")
    check(env, WAYS[way](env))
    addresses = [r.getMessage() for r in caplog.records if "is shown at" in r.getMessage()]
    assert len(set(addresses)) == len(addresses) == 2


def test_a_shallow_copy_has_its_own_episode() -> None:
    env = PackItEnv(render_mode="rgb_array", easy=True, rotation="aligned", location="blbf")
    env.reset(seed=0)
    env.render()
    copied = copy.copy(env)
    before = env.render()
    copied.step(0)
    assert np.array_equal(before, env.render()) and not np.array_equal(before, copied.render())
    env.close()
    copied.close()


@pytest.mark.slow
@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_copies_of_physics_and_vector_environments_go_on_identically(way) -> None:
    env = made("PackItPhysics-v0", "rendered", "rgb_array")
    check(env, WAYS[way](env))
    settings = {"observation": "none", "rotation": "aligned", "location": "blbf", "easy": True}
    envs = gymnasium.make_vec("PackIt-v0", 2, render_mode="rgb_array", **settings)
    envs.reset(seed=0)
    envs.render()
    copied = WAYS[way](envs)
    for _ in range(2):
        assert is_same(list(copied.step([0, 1])), list(envs.step([0, 1])))
        assert is_same(list(copied.render()), list(envs.render()))
    envs.close()
    copied.close()


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_a_scene_has_its_own_world(way) -> None:
    env = PackItEnv(easy=True, rotation="aligned", location="blbf")
    env.reset(seed=0)
    env.step(0)
    scene = Scene(env.episode.box)
    picture = scene.snapshot(64, 64).image
    copied = WAYS[way](scene)
    scene.close()
    assert np.array_equal(copied.snapshot(64, 64).image, picture)
    copied.close()
    again = WAYS[way](copied)
    with pytest.raises(RenderError, match="closed"):
        again.snapshot()
