"""What was seen and told while a teacher is imitated, kept to be gone over again and again.

DAgger's aggregate (Ross, Gordon and Bagnell, 2011): a network that learns from its latest play
alone forgets what it was told before.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from sb3_contrib.common.maskable.buffers import MaskableDictRolloutBuffer
from torch import Tensor

from packit_sim.core.files import replacing

_STAYS = "shapes"
"""The field of observations that is the same throughout an episode."""

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class _Rollout:
    """States (n) in their order in each environment, features in half precision.

    seen: fields, (n, ...). masks: (n, bytes), of packed bits. episodes: (n,), the rows of shapes.
    """

    seen: Arrays
    masks: npt.NDArray[np.uint8]
    episodes: npt.NDArray[np.int64]
    shapes: npt.NDArray[np.float16]


class DaggerDataset:
    """The states of all rollouts so far, in memory and in a folder, a file a rollout.

    steps: only those of the first so many are read; the others were made by what a kill undid.
    """

    def __init__(self, folder: Path, actions: int, steps: int) -> None:
        self._folder = folder
        self._actions = actions
        self._rollouts: list[_Rollout] = []
        for file in sorted(folder.glob("*.npz")):
            if int(file.stem) > steps:
                file.unlink()
                continue
            with np.load(file, allow_pickle=False) as arrays:
                told = dict(arrays)
            parts = (told.pop(name) for name in ("_masks", "_episodes", "_shapes"))
            self._rollouts.append(_Rollout(told, *parts))

    def __len__(self) -> int:
        return sum(len(rollout.masks) for rollout in self._rollouts)

    def add(self, steps: int, buffer: MaskableDictRolloutBuffer) -> None:
        """Takes in a rollout, before it was drawn from; steps: made until its end."""
        starts = buffer.episode_starts.astype(bool)
        starts[0] = True
        starts = starts.T.ravel()
        seen = {name: _in_order(field) for name, field in buffer.observations.items()}
        shapes = seen.pop(_STAYS)[starts].astype(np.float16)
        for name, field in seen.items():
            if field.ndim > 2 and field.dtype == np.float32:
                seen[name] = field.astype(np.float16)
        masks = np.packbits(_in_order(buffer.action_masks).astype(bool), axis=1)
        rollout = _Rollout(seen, masks, np.cumsum(starts) - 1, shapes)
        self._folder.mkdir(exist_ok=True)
        with replacing(self._folder / f"{steps:012d}.npz") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                **seen,
                _masks=masks,
                _episodes=rollout.episodes,
                _shapes=shapes,
            )
        self._rollouts.append(rollout)

    def draw(self, count: int) -> tuple[dict[str, Tensor], Tensor]:
        """Observations of so many states, any as likely as any other, and their action masks."""
        ends = np.cumsum([len(rollout.masks) for rollout in self._rollouts])
        drawn = np.sort(torch.randint(int(ends[-1]), (count,)).numpy())
        rows = np.split(drawn, np.searchsorted(drawn, ends[:-1]))
        parts, masks = [], []
        for rollout, own, end in zip(self._rollouts, rows, ends, strict=True):
            own = own - (end - len(rollout.masks))
            part = {name: field[own] for name, field in rollout.seen.items()}
            parts.append({**part, _STAYS: rollout.shapes[rollout.episodes[own]]})
            masks.append(np.unpackbits(rollout.masks[own], axis=1, count=self._actions))
        seen = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        tensors = {name: torch.as_tensor(field).float() for name, field in seen.items()}
        return tensors, torch.as_tensor(np.concatenate(masks))

    def clear(self) -> None:
        """Forgets all."""
        self._rollouts.clear()
        shutil.rmtree(self._folder, ignore_errors=True)


def _in_order(field: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Of (steps, envs, ...) one environment after the other, (steps * envs, ...)."""
    return field.swapaxes(0, 1).reshape(-1, *field.shape[2:])
