"""Checkpoints, from which a training resumes exactly: tensors, and JSON; no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.core.files import replacing

FORMAT = 2


class CheckpointError(PackItError, ValueError):
    """A checkpoint that can't be read."""


class ReplayableEnv(gym.Wrapper[Any, Any, Any, Any]):
    """An environment that stores its state as the seed and the actions that led to it."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._seed: int | None = None
        self._random: Mapping[str, Any] | None = None
        self._actions: list[int] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, without options, which could not be replayed."""
        if options:
            raise ArgumentError(f"options {options!r} can't be replayed")
        self._seed = seed
        self._random = None if seed is not None else self._generator().state
        self._actions = []
        return self.env.reset(seed=seed)

    def step(self, action: Any) -> Any:
        self._actions.append(int(action))
        return self.env.step(action)

    def to_json(self) -> dict[str, Any]:
        """Return the state, for `restore`, in JSON's types."""
        return {"seed": self._seed, "random": self._random, "actions": self._actions}

    def restore(self, state: dict[str, Any]) -> Any:
        """Replay a state of `to_json`, and return its observation."""
        if state["random"] is not None:
            self._generator().state = state["random"]
        observation, _ = self.reset(seed=state["seed"])
        for action in state["actions"]:
            observation, *_ = self.step(action)
        return observation

    def _generator(self) -> np.random.BitGenerator:
        return self.env.unwrapped.np_random.bit_generator


def write_checkpoint(path: Path, tensors: dict[str, Any], state: dict[str, Any]) -> None:
    """Write a checkpoint atomically, with the state of torch's and numpy's generators.

    Parameters
    ----------
    path : Path
        The file.
    tensors : dict
        State dicts of the networks and the optimizer.
    state : dict
        The rest of the training's state, in JSON's types.
    """
    random = np.random.get_state(legacy=False)  # noqa: NPY002 - sb3 draws from it
    random["state"]["key"] = random["state"]["key"].tolist()
    content = {
        "format": FORMAT,
        "tensors": tensors,
        "state": json.dumps(state),
        "torch": torch.get_rng_state(),
        "numpy": json.dumps(random),
    }
    with replacing(path) as file:
        torch.save(content, file)


def read_checkpoint(
    path: Path, device: torch.device
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Read a checkpoint, and restore the generators.

    Parameters
    ----------
    path : Path
        The file.
    device : torch.device
        Where the tensors go.

    Returns
    -------
    tuple of dict, optional
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
        state = json.loads(content["state"])
    except CheckpointError:
        raise
    except Exception as error:  # whatever a damaged file makes torch and pickle raise
        raise CheckpointError(f"{path} is not a checkpoint, or is damaged: {error}") from None
    torch.set_rng_state(content["torch"].cpu())
    np.random.set_state(random)  # noqa: NPY002
    return content["tensors"], state
