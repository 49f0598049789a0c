"""Lessons that are kept: what is drawn is what was told, and a kill loses and doubles nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra train")

import torch

from packit_agents.learning.dagger_dataset import DaggerDataset

STEPS, ENVS, ROOM, ACTIONS = 6, 2, 3, 11


def rollout(first: int) -> SimpleNamespace:
    """States that are numbered from `first` on, one environment after the other.

    Environment 0 begins an episode at step 4, the other goes on with an old one. All shapes of an
    episode are filled with the number of its first state.
    """
    numbers = first + np.arange(STEPS * ENVS).reshape(ENVS, STEPS).T
    starts = np.zeros((STEPS, ENVS), np.float32)
    starts[4, 0] = 1
    shapes = np.empty((STEPS, ENVS, ROOM, 2, 2, 2), np.float32)
    shapes[:4, 0], shapes[4:, 0], shapes[:, 1] = first, first + 4, first + STEPS
    told = numbers[..., None].astype(np.float32)
    observations = {
        "shapes": shapes,
        "box": np.broadcast_to(told[..., None, None], (STEPS, ENVS, 2, 2, 2)).astype(np.float32),
        "outside": (numbers[..., None] + np.arange(ROOM)) % 2,
        "lesson": told,
    }
    masks = (numbers[..., None] + np.arange(ACTIONS)) % 3 == 0
    return SimpleNamespace(
        observations=observations, episode_starts=starts, action_masks=masks.astype(np.float32)
    )


def check(lessons: DaggerDataset, numbers: range) -> None:
    """Draws until each state has come, and holds each field against its state's number."""
    torch.manual_seed(0)
    seen, masks = lessons.draw(40 * len(numbers))
    drawn = seen["lesson"][:, 0].long()
    assert set(drawn.tolist()) == set(numbers)
    assert (seen["box"] == drawn[:, None, None, None]).all()
    assert (seen["outside"] == (drawn[:, None] + torch.arange(ROOM)) % 2).all()
    assert (masks.bool() == ((drawn[:, None] + torch.arange(ACTIONS)) % 3 == 0)).all()
    within = drawn % (STEPS * ENVS)
    begun = torch.where(within < 4, 0, torch.where(within < STEPS, 4, STEPS)) + drawn - within
    assert (seen["shapes"] == begun[:, None, None, None, None]).all()


def test_what_is_drawn_is_what_was_told(tmp_path) -> None:
    lessons = DaggerDataset(tmp_path / "lessons", ACTIONS, 0)
    for n in range(3):
        lessons.add(12 * (n + 1), rollout(12 * n))
    assert len(lessons) == 36
    check(lessons, range(36))


def test_each_state_is_as_likely(tmp_path) -> None:
    lessons = DaggerDataset(tmp_path / "lessons", ACTIONS, 0)
    for n in range(2):
        lessons.add(12 * (n + 1), rollout(12 * n))
    torch.manual_seed(0)
    counts = np.bincount(lessons.draw(24_000)[0]["lesson"][:, 0].long().numpy(), minlength=24)
    assert counts.min() > 850 and counts.max() < 1150


def test_after_a_kill_only_what_the_checkpoint_knows_is_left(tmp_path) -> None:
    folder = tmp_path / "lessons"
    lessons = DaggerDataset(folder, ACTIONS, 0)
    for n in range(3):
        lessons.add(12 * (n + 1), rollout(12 * n))
    again = DaggerDataset(folder, ACTIONS, 24)
    check(again, range(24))
    assert sorted(file.stem for file in folder.iterdir()) == ["000000000012", "000000000024"]
    torch.manual_seed(1)
    first = again.draw(20)
    torch.manual_seed(1)
    second = DaggerDataset(folder, ACTIONS, 24).draw(20)
    assert all((first[0][name] == second[0][name]).all() for name in first[0])


def test_what_is_forgotten_leaves_no_file(tmp_path) -> None:
    lessons = DaggerDataset(tmp_path / "lessons", ACTIONS, 0)
    lessons.add(12, rollout(0))
    lessons.clear()
    lessons.clear()
    assert len(lessons) == 0 and not (tmp_path / "lessons").exists()
