"""What it takes to go on with a training exactly: tensors, and all else as JSON. No code."""

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

FORMAT = 1


class CheckpointError(PackItError, ValueError):
    """A checkpoint that can't be read."""


class ReplayableEnv(gym.Wrapper[Any, Any, Any, Any]):
    """An environment whose state is told as the way to it: generator, reset, actions."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._seed: int | None = None
        self._random: Mapping[str, Any] | None = None
        self._actions: list[int] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Raises ValueError for options: what they ask for could not be told again."""
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
        """Where it stands, for `restore`."""
        return {"seed": self._seed, "random": self._random, "actions": self._actions}

    def restore(self, state: dict[str, Any]) -> Any:
        """Goes to where another one stood; returns the observation there."""
        if state["random"] is not None:
            self._generator().state = state["random"]
        seen, _ = self.reset(seed=state["seed"])
        for action in state["actions"]:
            seen, *_ = self.step(action)
        return seen

    def _generator(self) -> np.random.BitGenerator:
        return self.env.unwrapped.np_random.bit_generator


def write_checkpoint(path: Path, tensors: dict[str, Any], told: dict[str, Any]) -> None:
    """Writes a checkpoint, whole or not at all, with the state of torch's and numpy's generators.

    tensors: state dicts. told: JSON's types.
    """
    random = np.random.get_state(legacy=False)  # noqa: NPY002 - sb3 draws from it
    random["state"]["key"] = random["state"]["key"].tolist()
    content = {
        "format": FORMAT,
        "tensors": tensors,
        "told": json.dumps(told),
        "torch": torch.get_rng_state(),
        "numpy": json.dumps(random),
    }
    with replacing(path) as file:
        torch.save(content, file)


def read_checkpoint(
    path: Path, device: torch.device
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The tensors and what was told, None where there is no checkpoint; restores the generators.

    Raises CheckpointError where it is damaged, or of another version.
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
        told = json.loads(content["told"])
    except CheckpointError:
        raise
    except Exception as error:  # whatever a damaged file makes torch and pickle raise
        raise CheckpointError(f"{path} is no checkpoint, or is damaged: {error}") from None
    torch.set_rng_state(content["torch"].cpu())
    np.random.set_state(random)  # noqa: NPY002
    return content["tensors"], told
