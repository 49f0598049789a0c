"""Environments in processes of a Ray cluster, as a vector environment of stable-baselines3."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import (
    VecEnvIndices,
    VecEnvObs,
    VecEnvStepReturn,
)

from packit_sim.core.parallel import Actors

EnvMaker = Callable[[], gym.Env[Any, Any]]
"""A function that makes an environment, called in the process that holds it."""


class RemoteEnvs(VecEnv):
    """Environments distributed over workers, which behave as they would in this process.

    Parameters
    ----------
    makers : sequence of callable
        A function for each environment.
    workers : int
        Number of processes.
    address : str, optional
        Address of the cluster's head, see `parallel.Workers`.

    Raises
    ------
    WorkersError
        If workers can't be started, or are lost.
    """

    def __init__(
        self, makers: Sequence[EnvMaker], workers: int, address: str | None = None
    ) -> None:
        dealt = np.array_split(np.arange(len(makers)), min(workers, len(makers)))
        self._groups: list[list[int]] = [numbers.tolist() for numbers in dealt]
        self._actors = Actors(
            DummyVecEnv, [([makers[n] for n in group],) for group in self._groups], address
        )
        self.num_envs = len(makers)
        (observations,) = self.get_attr("observation_space", 0)
        (actions,) = self.get_attr("action_space", 0)
        super().__init__(len(makers), observations, actions)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        seeds = super().seed(seed)
        self._actors.call("seed", [(seeds[group[0]],) for group in self._groups])
        return seeds

    def reset(self) -> VecEnvObs:
        self._reset_seeds()
        return _joined(self._actors.call("reset", [()] * len(self._groups)))

    def step_async(self, actions: npt.NDArray[np.int64]) -> None:
        self._actors.begin("step", [(actions[group],) for group in self._groups])

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, over, infos = zip(*self._actors.end(), strict=True)
        merged = [info for group in infos for info in group]
        return _joined(observations), np.concatenate(rewards), np.concatenate(over), merged

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return self._each("get_attr", indices, attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        self._each("set_attr", indices, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **others: Any
    ) -> list[Any]:
        return self._each("env_method", indices, method_name, *method_args, **others)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        return self._each("env_is_wrapped", indices, wrapper_class)

    def close(self) -> None:
        self._actors.close()

    def _each(self, method: str, indices: VecEnvIndices, *args: Any, **others: Any) -> list[Any]:
        """Call a method of some environments, and return their answers in order."""
        asked = list(self._get_indices(indices))
        within = [[group.index(n) for n in asked if n in group] for group in self._groups]
        answers = self._actors.call(
            method, [args] * len(within), [{**others, "indices": numbers} for numbers in within]
        )
        if answers[0] is None:  # `set_attr` returns nothing
            return []
        found = {
            group[k]: answer
            for group, numbers, answered in zip(self._groups, within, answers, strict=True)
            for k, answer in zip(numbers, answered, strict=True)
        }
        return [found[n] for n in asked]


def _joined(groups: Sequence[Any]) -> dict[str, npt.NDArray[Any]]:
    return {name: np.concatenate([group[name] for group in groups]) for name in groups[0]}
