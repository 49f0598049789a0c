"""Checkpoints, from which a training resumes exactly: tensors, and JSON; no code."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.core.files import replacing
from packit_sim.game.evaluation.learning_curves import CurvePoint

FORMAT = 2


class CheckpointError(PackItError, ValueError):
    """A checkpoint that can't be read."""


class EnvReplay(Struct):
    """The seed and the actions that lead an environment to its state.

    Attributes
    ----------
    seed : int, optional
        Seed of the episode.
    random : dict, optional
        State of the random generator before the episode, if it has no seed.
    actions : list of int
        The episode's actions.
    """

    seed: int | None
    random: dict[str, Any] | None
    actions: list[int]


class CheckpointState(Struct):
    """The state of a training, apart from tensors and random generators.

    Attributes
    ----------
    steps, updates : int
        Number of steps and of updates.
    progress : float
        Share of the steps that are left.
    starts : list of bool
        True for each environment in which an episode begins.
    envs : list of EnvReplay
        The environments.
    returns : list of float
        Returns of the latest episodes.
    running : list of float
        The return so far of each environment's episode.
    curve : list of CurvePoint
        The learning curve.
    """

    steps: int
    updates: int
    progress: float
    starts: list[bool]
    envs: list[EnvReplay]
    returns: list[float]
    running: list[float]
    curve: list[CurvePoint]


class ReplayableEnv(gym.Wrapper[Any, Any, Any, Any]):
    """An environment that stores its state as the seed and the actions that led to it."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._replay = EnvReplay(None, None, [])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, without options, which could not be replayed."""
        if options:
            raise ArgumentError(f"options {options!r} can't be replayed")
        random = None if seed is not None else dict(self._generator().state)
        self._replay = EnvReplay(seed, random, [])
        return self.env.reset(seed=seed)

    def step(self, action: Any) -> Any:
        self._replay.actions.append(int(action))
        return self.env.step(action)

    def replay(self) -> EnvReplay:
        """Return the record that `restore` needs."""
        return self._replay

    def restore(self, replay: EnvReplay) -> Any:
        """Replay an episode, and return its last observation."""
        if replay.random is not None:
            self._generator().state = replay.random
        observation, _ = self.reset(seed=replay.seed)
        for action in replay.actions:
            observation, *_ = self.step(action)
        return observation

    def _generator(self) -> np.random.BitGenerator:
        return self.env.unwrapped.np_random.bit_generator


def write_checkpoint(path: Path, tensors: dict[str, Any], state: CheckpointState) -> None:
    """Write a checkpoint atomically, with the state of torch's and numpy's generators.

    Parameters
    ----------
    tensors : dict
        State dicts of the networks and the optimizer.
    state : CheckpointState
        The rest of the training's state.
    """
    random = np.random.get_state(legacy=False)  # noqa: NPY002 - sb3 draws from it
    random["state"]["key"] = random["state"]["key"].tolist()
    content = {
        "format": FORMAT,
        "tensors": tensors,
        "state": typed_json.encode(state),
        "torch": torch.get_rng_state(),
        "numpy": json.dumps(random),
    }
    buffer = BytesIO()  # torch reports a full disk as its own kind of error
    torch.save(content, buffer)
    with replacing(path) as file:
        file.write(buffer.getbuffer())


def read_checkpoint(
    path: Path, device: torch.device
) -> tuple[dict[str, Any], CheckpointState] | None:
    """Read a checkpoint, and restore the generators.

    Parameters
    ----------
    device : torch.device
        The device of the tensors.

    Returns
    -------
    tuple of dict and CheckpointState, optional
        The tensors and the state of `write_checkpoint`; None if there is no file.

    Raises
    ------
    CheckpointError
        If the file is damaged, or of another version.
    """
    if not path.exists():
        return None
    try:
        content = torch.load(path, map_location=device, weights_only=True)
        if content["format"] != FORMAT:
            raise CheckpointError(
                f"{path} is of format {content['format']!r}: this version reads {FORMAT}"
            )
        random = json.loads(content["numpy"])
        random["state"]["key"] = np.array(random["state"]["key"], dtype=np.uint32)
        state = typed_json.decode(content["state"], CheckpointState, ArgumentError, "the state")
    except CheckpointError:
        raise
    except Exception as error:  # whatever a damaged file makes torch and pickle raise
        raise CheckpointError(f"{path} is not a checkpoint, or is damaged: {error}") from None
    torch.set_rng_state(content["torch"].cpu())
    np.random.set_state(random)  # noqa: NPY002
    return content["tensors"], state
