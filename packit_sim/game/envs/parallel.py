"""Environments in several processes, with several of them in each."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from multiprocessing.connection import Connection
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import (
    CloudpickleWrapper,
    batch_space,
    create_shared_memory,
    read_from_shared_memory,
)

from packit_sim.core.errors import ArgumentError, PackItError

Observations = Any
"""A batch of observations: an array, or a mapping of arrays."""

_PATIENCE = 5.0
"""Seconds that a process has to end by itself."""


class ParallelVectorEnv(VectorEnv[Any, Any, Any]):
    """Vectors of environments as one: the first in this process, each other in one of its own.

    A message to a process costs about as much as a step of an environment. So a process has several
    environments, and all of their steps take one message; observations are in shared memory. This
    process would otherwise only wait.

    Parameters
    ----------
    makers : sequence of callable
        Each makes the vector of one process, in that process.
    counts : sequence of int
        The number of environments of each.
    """

    def __init__(
        self,
        makers: Sequence[Callable[[], SyncVectorEnv]],
        counts: Sequence[int],
    ) -> None:
        own = makers[0]()
        self.num_envs = sum(counts)
        self.metadata = own.metadata
        self.render_mode = own.render_mode
        self.single_observation_space = own.single_observation_space
        self.single_action_space = own.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._counts = tuple(counts)
        self._rows = [
            slice(end - count, end) for end, count in zip(accumulate(counts), counts, strict=True)
        ]
        context: Any = multiprocessing.get_context("spawn")
        shared = self.single_observation_space, self.num_envs
        self._memory = create_shared_memory(*shared, context)
        self._seen = read_from_shared_memory(shared[0], self._memory, shared[1])
        self._pipes: list[Connection] = []
        self._processes = []
        for maker, rows in zip(makers[1:], self._rows[1:], strict=True):
            pipe, other = context.Pipe()
            job = CloudpickleWrapper(maker)  # type: ignore[type-var] # any callable
            given = job, other, shared[0], self._memory, shared[1], rows
            process = context.Process(target=_serve, args=given, daemon=True)
            process.start()
            other.close()
            self._pipes.append(pipe)
            self._processes.append(process)
        self._own = _joining(own, self._seen, self._rows[0])

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Reset all environments, or those of `options["reset_mask"]`."""
        if seed is None or isinstance(seed, int):
            seed = [None if seed is None else seed + n for n in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ArgumentError(f"{len(seed)} seeds are given for {self.num_envs} environments")
        asked: list[Any] = []
        for rows in self._rows:
            own = dict(options or {})
            if "reset_mask" in own:
                own["reset_mask"] = own["reset_mask"][rows]
                if not own["reset_mask"].any():
                    asked.append(None)
                    continue
            asked.append({"seed": list(seed[rows]), "options": own or None})
        infos = self._ask("reset", asked)
        return self._observations(), _joined(infos, self._counts)

    def step(self, actions: Any) -> tuple[Observations, Any, Any, Any, dict[str, Any]]:
        """Take a step in each environment."""
        found = self._ask("step", [np.asarray(actions)[rows] for rows in self._rows])
        rewards, terminated, truncated, infos = zip(*found, strict=True)
        arrays = (np.concatenate(each) for each in (rewards, terminated, truncated))
        return self._observations(), *arrays, _joined(infos, self._counts)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of each environment, or read an attribute."""
        found = self._ask("call", [(name, args, kwargs)] * len(self._rows))
        return tuple(value for values in found for value in values)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Read an attribute of each environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each environment: to the same value, or each to one of a list."""
        if not isinstance(values, list | tuple):
            values = [values] * self.num_envs
        self._ask("set_attr", [(name, list(values[rows])) for rows in self._rows])

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments of this process, and end the others."""
        self._own.close()
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            if process.is_alive():
                with contextlib.suppress(OSError):
                    pipe.send(("close", None))
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            process.join(_PATIENCE)
            process.kill()
            pipe.close()

    def _ask(self, command: str, values: Sequence[Any]) -> list[Any]:
        """Send a command to each process, and return all answers; raise the first error."""
        for pipe, value in zip(self._pipes, values[1:], strict=True):
            with contextlib.suppress(OSError):  # a process that has ended does not answer either
                pipe.send((command, value))
        answer, error = _answered(self._own, command, values[0])
        found, errors = [answer], [error]
        for process, pipe in zip(self._processes, self._pipes, strict=True):
            try:
                answer, error = pipe.recv()
            except (EOFError, OSError):
                process.join(_PATIENCE)
                text = f"a process of environments ended with exit code {process.exitcode}"
                answer, error = None, PackItError(text)
            found.append(answer)
            errors.append(error)
        for error in errors:
            if error is not None:
                raise error
        return found

    def _observations(self) -> Observations:
        """Return a copy of the observations."""
        return _each(np.copy, self._seen)


def _each(function: Callable[..., Any], *batches: Any) -> Any:
    """Apply a function to arrays, or to those of mappings by name."""
    if isinstance(batches[0], Mapping):
        return {name: _each(function, *(batch[name] for batch in batches)) for name in batches[0]}
    return function(*batches)


def _joined(infos: Sequence[dict[str, Any]], counts: Sequence[int]) -> dict[str, Any]:
    """Join the `infos` of vectors; what a vector lacks is 0 or None, as in Gymnasium's."""
    joined: dict[str, Any] = {}
    for key in dict.fromkeys(key for info in infos for key in info):
        first = next(info[key] for info in infos if key in info)
        if isinstance(first, dict):
            joined[key] = _joined([info.get(key, {}) for info in infos], counts)
            continue
        none = None if first.dtype == object else 0
        joined[key] = np.concatenate(
            [
                info[key]
                if key in info
                else np.full((count, *first.shape[1:]), none, dtype=first.dtype)
                for info, count in zip(infos, counts, strict=True)
            ]
        )
    return joined


def _serve(
    maker: Callable[[], SyncVectorEnv],
    pipe: Connection,
    space: gym.Space[Any],
    memory: Any,
    total: int,
    rows: slice,
) -> None:
    """Make a vector, and do what is asked, until the end."""
    seen = read_from_shared_memory(space, memory, total)
    try:
        envs = _joining(maker(), seen, rows)
    except Exception as error:
        pipe.recv()
        pipe.send((None, error))
        return
    try:
        while True:
            command, value = pipe.recv()
            if command == "close":
                return
            pipe.send(_answered(envs, command, value))
    except (EOFError, KeyboardInterrupt):
        return
    finally:
        envs.close()


def _joining(envs: SyncVectorEnv, seen: Observations, rows: slice) -> SyncVectorEnv:
    """Let Gymnasium join observations in the shared memory, and copy them nowhere else."""
    envs.copy = False
    envs._observations = _each(lambda batch: batch[rows], seen)
    return envs


def _answered(envs: SyncVectorEnv, command: str, value: Any) -> tuple[Any, Exception | None]:
    """Return the answer to a command, and the error that it raised."""
    try:
        return _answer(envs, command, value), None
    except Exception as error:
        return None, error


def _answer(envs: SyncVectorEnv, command: str, value: Any) -> Any:
    if command == "call":
        name, args, kwargs = value
        return envs.call(name, *args, **kwargs)
    if command == "set_attr":
        return envs.set_attr(*value)
    if command == "step":
        _, *answer = envs.step(value)
        return answer
    return {} if value is None else envs.reset(**value)[1]
