"""The DAgger dataset: samples are added states, and a kill neither loses nor repeats any."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")

import torch

from packit_agents.learning.dagger_dataset import DaggerDataset

STEPS, ENVS, ROOM, ACTIONS = 6, 2, 3, 11


def rollout(first: int) -> SimpleNamespace:
    """States that are numbered from `first` on, one environment after the other.

    Environment 0 begins an episode at step 4, the other continues an earlier one. All shapes of an
    episode are filled with the number of its first state.
    """
    numbers = first + np.arange(STEPS * ENVS).reshape(ENVS, STEPS).T
    starts = np.zeros((STEPS, ENVS), np.float32)
    starts[4, 0] = 1
    shapes = np.empty((STEPS, ENVS, ROOM, 2, 2, 2), np.float32)
    shapes[:4, 0], shapes[4:, 0], shapes[:, 1] = first, first + 4, first + STEPS
    labels = numbers[..., None].astype(np.float32)
    observations = {
        "shapes": shapes,
        "box": np.broadcast_to(labels[..., None, None], (STEPS, ENVS, 2, 2, 2)).astype(np.float32),
        "outside": (numbers[..., None] + np.arange(ROOM)) % 2,
        "label": labels,
    }
    masks = (numbers[..., None] + np.arange(ACTIONS)) % 3 == 0
    return SimpleNamespace(
        observations=observations, episode_starts=starts, action_masks=masks.astype(np.float32)
    )


def check(dataset: DaggerDataset, numbers: Sequence[int]) -> None:
    """Sample until each state was drawn, and compare each field with the number of its state."""
    torch.manual_seed(0)
    seen, masks = dataset.sample(40 * len(numbers))
    drawn = seen["label"][:, 0].long()
    assert set(drawn.tolist()) == set(numbers)
    assert (seen["box"] == drawn[:, None, None, None]).all()
    assert (seen["outside"] == (drawn[:, None] + torch.arange(ROOM)) % 2).all()
    assert (masks.bool() == ((drawn[:, None] + torch.arange(ACTIONS)) % 3 == 0)).all()
    within = drawn % (STEPS * ENVS)
    begun = torch.where(within < 4, 0, torch.where(within < STEPS, 4, STEPS)) + drawn - within
    assert (seen["shapes"] == begun[:, None, None, None, None]).all()


def test_sampled_states_are_those_added(tmp_path) -> None:
    dataset = DaggerDataset(tmp_path / "dagger_dataset", ACTIONS, 0)
    for n in range(3):
        dataset.add(12 * (n + 1), rollout(12 * n))
    assert len(dataset) == 36
    check(dataset, range(36))


def test_states_are_sampled_uniformly(tmp_path) -> None:
    dataset = DaggerDataset(tmp_path / "dagger_dataset", ACTIONS, 0)
    for n in range(2):
        dataset.add(12 * (n + 1), rollout(12 * n))
    torch.manual_seed(0)
    counts = np.bincount(dataset.sample(24_000)[0]["label"][:, 0].long().numpy(), minlength=24)
    assert counts.min() > 850 and counts.max() < 1150


def test_states_after_the_checkpoint_are_not_read_and_soon_replaced(tmp_path) -> None:
    folder = tmp_path / "dagger_dataset"
    dataset = DaggerDataset(folder, ACTIONS, 0)
    for n in range(3):
        dataset.add(12 * (n + 1), rollout(12 * n))
    again = DaggerDataset(folder, ACTIONS, 24)
    check(again, range(24))
    torch.manual_seed(1)
    first = again.sample(20)
    torch.manual_seed(1)
    second = DaggerDataset(folder, ACTIONS, 24).sample(20)
    assert all((first[0][name] == second[0][name]).all() for name in first[0])
    again.add(36, rollout(48))
    check(DaggerDataset(folder, ACTIONS, 36), [*range(24), *range(48, 60)])


def test_clear_deletes_all_files(tmp_path) -> None:
    dataset = DaggerDataset(tmp_path / "dagger_dataset", ACTIONS, 0)
    dataset.add(12, rollout(0))
    dataset.clear()
    dataset.clear()
    assert len(dataset) == 0 and not (tmp_path / "dagger_dataset").exists()
