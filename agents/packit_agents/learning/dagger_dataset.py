"""The DAgger dataset: labelled states of all rollouts so far, in memory and on disk.

A network that learns from its latest rollout alone forgets the earlier ones. DAgger therefore
aggregates all of them (Ross, Gordon and Bagnell, 2011).
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

_CONSTANT = "shapes"
"""The observation field that stays the same throughout an episode."""

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class _Rollout:
    """The n states of a rollout, ordered by environment; features in half precision.

    Attributes
    ----------
    fields : dict of ndarray
        Observation fields (n, ...) without `shapes`.
    masks : ndarray
        uint8 (n, bytes), action masks as packed bits.
    episodes : ndarray
        int64 (n,), the row of `shapes` of each state.
    shapes : ndarray
        float16 (episodes, ...), the field `shapes` of each episode.
    """

    fields: Arrays
    masks: npt.NDArray[np.uint8]
    episodes: npt.NDArray[np.int64]
    shapes: npt.NDArray[np.float16]


class DaggerDataset:
    """Labelled states of all rollouts so far, one file for each rollout.

    Parameters
    ----------
    folder : Path
        The folder of the files; existing ones are read.
    actions : int
        Number of actions of the environment.
    steps : int
        Step of the checkpoint that is resumed: files of later rollouts are not read.
    """

    def __init__(self, folder: Path, actions: int, steps: int) -> None:
        self._folder = folder
        self._actions = actions
        self._rollouts: list[_Rollout] = []
        for file in sorted(folder.glob("*.npz")):
            if int(file.stem) > steps:
                continue
            with np.load(file, allow_pickle=False) as arrays:
                fields = dict(arrays)
            others = (fields.pop(name) for name in ("_masks", "_episodes", "_shapes"))
            self._rollouts.append(_Rollout(fields, *others))

    def __len__(self) -> int:
        return sum(len(rollout.masks) for rollout in self._rollouts)

    def add(self, steps: int, buffer: MaskableDictRolloutBuffer) -> None:
        """Add a rollout, in memory and on disk.

        Parameters
        ----------
        steps : int
            Number of training steps at the end of the rollout.
        buffer : MaskableDictRolloutBuffer
            The rollout; nothing has been sampled from it yet.
        """
        starts = buffer.episode_starts.astype(bool)
        starts[0] = True
        starts = starts.T.ravel()
        fields = {name: _by_environment(field) for name, field in buffer.observations.items()}
        shapes = fields.pop(_CONSTANT)[starts].astype(np.float16)
        for name, field in fields.items():
            if field.ndim > 2 and field.dtype == np.float32:
                fields[name] = field.astype(np.float16)
        masks = np.packbits(_by_environment(buffer.action_masks).astype(bool), axis=1)
        rollout = _Rollout(fields, masks, np.cumsum(starts) - 1, shapes)
        self._folder.mkdir(exist_ok=True)
        with replacing(self._folder / f"{steps:012d}.npz") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                **fields,
                _masks=masks,
                _episodes=rollout.episodes,
                _shapes=shapes,
            )
        self._rollouts.append(rollout)

    def sample(self, count: int) -> tuple[dict[str, Tensor], Tensor]:
        """Draw states uniformly, with replacement.

        Parameters
        ----------
        count : int
            Number of states.

        Returns
        -------
        observations : dict of Tensor
            Fields (count, ...) as floats.
        masks : Tensor
            (count, actions), the action masks.
        """
        ends = np.cumsum([len(rollout.masks) for rollout in self._rollouts])
        drawn = np.sort(torch.randint(int(ends[-1]), (count,)).numpy())
        rows = np.split(drawn, np.searchsorted(drawn, ends[:-1]))
        parts, masks = [], []
        for rollout, own, end in zip(self._rollouts, rows, ends, strict=True):
            own = own - (end - len(rollout.masks))
            part = {name: field[own] for name, field in rollout.fields.items()}
            parts.append({**part, _CONSTANT: rollout.shapes[rollout.episodes[own]]})
            masks.append(np.unpackbits(rollout.masks[own], axis=1, count=self._actions))
        fields = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        tensors = {name: torch.as_tensor(field).float() for name, field in fields.items()}
        return tensors, torch.as_tensor(np.concatenate(masks))

    def clear(self) -> None:
        """Delete all states, in memory and on disk."""
        self._rollouts.clear()
        shutil.rmtree(self._folder, ignore_errors=True)


def _by_environment(field: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return (steps * envs, ...) of (steps, envs, ...), one environment after the other."""
    return field.swapaxes(0, 1).reshape(-1, *field.shape[2:])
