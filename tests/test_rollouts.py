"""Any rollout: the box stays consistent, seeds determine results, and memory is bounded."""

import gc
import hashlib
import os
import resource
import subprocess
import sys
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core import caches
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.libraries.library import ShapeLibrary
from tests.examples import examples

RESETS = 10_000
STEPS = 100_000
SMALL_BUDGETS = {
    "turned voxels": 2**26,
    "no-fit tables": 2**25,
    "collisions": 20_000,
    "pairs that met": 20_000,
}


@pytest.fixture(scope="module")
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter", ShapeLibrary.open("everyday"))


ANY = st.integers(0, 15624) | st.sampled_from([-1, 15625, 2**40, -(2**40)])


@pytest.mark.parametrize("easy", [False, True])
@examples(25)
@given(task=st.integers(0, 9), seed=st.integers(0, 2**32), valid=st.integers(0, 60), last=ANY)
def test_no_sequence_of_actions_corrupts_the_box(tasks, easy, task, seed, valid, last) -> None:
    """Some valid actions by chance, then any number at all."""
    env = PackItEnv(tasks, easy=easy, observation="none", max_shapes=40)
    env.reset(options={"task": task})
    rng = np.random.default_rng(seed)
    total, over = 0.0, False
    for number in (*[None] * valid, last):
        mask = env.action_masks()
        if number is None:
            number = int(rng.choice(np.flatnonzero(mask)))
        possible = 0 <= number < len(mask) and bool(mask[number])
        seen, reward, over, truncated, info = env.step(number)
        total += reward
        assert seen in env.observation_space and not truncated
        assert (info["end"] == "invalid action") == (not possible)
        assert possible or reward == 0
        if over:
            break
    episode = env.episode
    assert over == (episode.end is not None)
    assert sum(episode.outside) + len(episode.box.placed) == len(episode.task.items)
    placed_volume = sum(p.item.volume for p in episode.box.placed)
    assert total == pytest.approx(placed_volume / episode.task.volume) and total <= 1 + 1e-9
    replayed = Box()
    for n, candidate in enumerate(episode.box.placed):
        if n < 4:
            assert placement.is_valid((100, 100, 100), episode.box.placed[:n], candidate)
        replayed.place(candidate.item, candidate.location)
    assert np.array_equal(replayed.outer_words, episode.box.outer_words)
    if over:
        assert not env.action_masks().any()
        with pytest.raises(RuntimeError, match="over"):
            env.step(0)


def fingerprint(env_id: str, vectorization: str, steps: int = 12) -> str:
    """A digest of all that two seeded environments say, step by step."""
    envs = gym.make_vec(env_id, 2, vectorization, observation="features", max_shapes=40)
    digest = hashlib.sha256()
    rng = np.random.default_rng(3)
    seen, info = envs.reset(seed=[8, 9])
    for _ in range(steps):
        everything = {
            **seen,
            **{k: v for k, v in info.items() if k not in ("mesh_comparisons", "_mesh_comparisons")},
        }
        for key in sorted(everything):
            values = np.asarray(everything[key])
            plain = values.dtype != object
            digest.update(values.tobytes() if plain else repr(values.tolist()).encode())
        actions = [rng.choice(np.flatnonzero(m)) if m.any() else 0 for m in seen["action_mask"]]
        seen, rewards, over, _, info = envs.step(np.array(actions))
        digest.update(rewards.tobytes() + over.tobytes())
    envs.close()
    return digest.hexdigest()


@pytest.mark.slow
def test_a_seed_determines_all_in_one_process_in_many_and_in_a_new_one() -> None:
    ids = ("PackIt-v0", "PackItEasy-v0")
    expected = [fingerprint(env_id, "sync") for env_id in ids]
    assert [fingerprint(env_id, "async") for env_id in ids] == expected
    assert [fingerprint(env_id, "vector_entry_point") for env_id in ids] == expected
    script = (
        "import packit_sim; from tests.test_rollouts import fingerprint\n"
        f"for env_id in {ids!r}: print(fingerprint(env_id, 'sync'))"
    )
    fresh = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "77"},
    )
    assert fresh.stdout.split() == expected


def held() -> tuple[int, int]:
    """Resident MB, and open files."""
    gc.collect()
    with open("/proc/self/statm") as file:
        resident = int(file.read().split()[1]) * resource.getpagesize()
    return resident // 2**20, len(os.listdir("/proc/self/fd"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("easy", "share"), [(False, 1.0), (True, 0.1)])
def test_ten_thousand_resets_and_a_hundred_thousand_steps_leave_nothing_behind(
    tasks, easy, share, request
) -> None:
    """Caches fill up to their budgets at first, here small ones; then memory stands still."""
    before = {name: int(caches.usage()[name].budget) for name in SMALL_BUDGETS}
    for name, budget in SMALL_BUDGETS.items():
        caches.limit(name, budget)
        request.addfinalizer(partial(caches.limit, name, before[name]))
    env = PackItEnv(tasks, easy=easy, observation="features", order="cycle", max_shapes=40)
    rng = np.random.default_rng(0)
    quarters = []
    resets = steps = 0
    over = True
    for part in (share / 4, share / 2, 3 * share / 4, share):
        while resets < RESETS * part or steps < STEPS * part:
            if over:
                env.reset(seed=resets)
                resets += 1
                over = env.episode.end is not None
                continue
            _, _, over, _, _ = env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))
            steps += 1
        quarters.append(held())
    print(f"{resets} resets, {steps} steps: MB and open files after each quarter: {quarters}")
    (_, _), (_, _), (before, files), (after, files_after) = quarters
    assert files_after == files
    assert after - before <= 0.02 * before
