"""Several environments as one, for evaluation and training in batches."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

from packit_sim.core.checks import Range, check_range, one_of
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.parallel import ParallelVectorEnv
from packit_sim.game.envs.specs import WritableSpec

MemberSettings: TypeAlias = Sequence[Mapping[str, Any]]
"""Settings for each environment of a vector, in addition to those of all."""

_SOURCE = {"tasks", "library", "split"}
"""Settings that say which tasks are opened."""


class PackItVectorEnv(WritableSpec, SyncVectorEnv):
    """Environments that share one library, its tasks and the engine's caches.

    `gymnasium.make_vec("PackIt-v0", n)` creates one. Opening n environments costs as much as
    opening one.

    Parameters
    ----------
    num_envs : int
        The number of environments.
    autoreset_mode : str | AutoresetMode
        The time at which environments are reset, see Gymnasium's `SyncVectorEnv`.
    copy : bool
        Whether each observation has new arrays; otherwise the next one overwrites them.
    member_settings : sequence of mapping, optional
        Settings for each environment, such as different tasks, in addition to those of all.
    **settings : Any
        Settings of `PackItEnv`, the same for all.

    Attributes
    ----------
    members : tuple[PackItEnv, ...]
        The environments.

    Raises
    ------
    ArgumentError
        If there are not as many settings as environments.

    Examples
    --------
    >>> import gymnasium
    >>> import packit_sim
    >>> settings = {"observation": "none", "rotation": "aligned", "location": "blbf"}
    >>> envs = gymnasium.make_vec("PackIt-v0", 2, **settings)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations["action_mask"].shape
    (2, 50)
    >>> observations, rewards, over, truncated, infos = envs.step([0, 1])
    >>> (rewards > 0).tolist()
    [True, True]
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        member_settings: MemberSettings | None = None,
        **settings: Any,
    ) -> None:
        first, *others = _each(num_envs, settings, member_settings)
        members = [PackItEnv(**first)]
        opened = {"tasks": members[0].maker or members[0].tasks, "split": None}
        for own in others:
            is_same = all(own.get(name) is first.get(name) for name in _SOURCE)
            members.append(PackItEnv(**(own | opened if is_same else own)))
        self.members = tuple(members)
        super().__init__(
            [partial(_same, env) for env in self.members],
            copy=copy,
            autoreset_mode=autoreset_mode,
        )

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks of each environment; empty if they are generated on the fly.

        Raises
        ------
        ArgumentError
            If the environments have different tasks.
        """
        if any(env.tasks != self.members[0].tasks for env in self.members):
            raise ArgumentError("the environments have different tasks: use those of `members`")
        return self.members[0].tasks


def make_vec(
    name: str,
    num_envs: int = 1,
    vectorization_mode: Literal["vector_entry_point", "sync", "async", "parallel"] | None = None,
    *,
    workers: int = 0,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    wrappers: Sequence[Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]] = (),
    member_settings: MemberSettings | None = None,
    **settings: Any,
) -> VectorEnv[Any, Any, Any]:
    """Create environments as `gymnasium.make_vec` does, with one way to say when they are reset.

    Gymnasium's function takes `autoreset_mode` for a `PackItVectorEnv`, and for its own classes
    `vector_kwargs={"autoreset_mode": ...}`.

    Parameters
    ----------
    name : str
        The id, such as "PackIt-v0".
    num_envs : int
        The number of environments.
    vectorization_mode : str, optional
        "vector_entry_point" for a `PackItVectorEnv`, "sync" for Gymnasium's `SyncVectorEnv`,
        "async" for its `AsyncVectorEnv`: each environment in its own process; "parallel" for a few
        processes with several environments each, which pays with some 30 of them and more, or where
        steps are slow. By default the first, and "sync" for PackItContinuous-v0, which has
        no `PackItVectorEnv`.
    workers : int
        The number of processes of "parallel", with this one; 0: one for each core.
    autoreset_mode : str or AutoresetMode
        "NextStep": the step after the last of an episode resets, and its action is ignored;
        "SameStep": the last step resets, and `infos` has "final_obs" and "final_info"; "Disabled":
        `reset(options={"reset_mask": mask})` resets.
    wrappers : sequence of callable
        Wrappers of each environment, the innermost first; for "sync" and "async".
    member_settings : sequence of mapping, optional
        Settings for each environment, such as different tasks, in addition to those of all.
    **settings : Any
        Settings of `PackItEnv`, the same for all.

    Returns
    -------
    VectorEnv
        The environments.

    Raises
    ------
    ArgumentError
        If a setting is not possible.

    Examples
    --------
    >>> from packit_sim import load_tasks, make_vec
    >>> tasks = load_tasks("starter")
    >>> settings = {"observation": "none", "rotation": "aligned", "location": "blbf"}
    >>> easy_and_hard = [{"tasks": tasks[:5]}, {"tasks": tasks[5:]}]
    >>> envs = make_vec(
    ...     "PackIt-v0", 2, autoreset_mode="SameStep", member_settings=easy_and_hard, **settings
    ... )
    >>> envs.reset(seed=0)[0]["action_mask"].sum(axis=1).tolist()
    [29, 25]
    >>> envs.metadata["autoreset_mode"].value
    'SameStep'
    """
    resets = tuple(mode.value for mode in AutoresetMode)
    if isinstance(autoreset_mode, AutoresetMode):
        autoreset_mode = autoreset_mode.value
    modes: tuple[str, ...] = ("vector_entry_point", "sync", "async", "parallel")
    spec = gym.registry.get(name.rpartition(":")[2])
    if spec is not None and spec.vector_entry_point is None:
        modes = modes[1:]
    mode = vectorization_mode or modes[0]
    one_of("vectorization_mode", mode, modes)
    one_of("autoreset_mode", autoreset_mode, resets)
    check_range("workers", workers, Range(0, 1024))
    if workers and mode != "parallel":
        raise ArgumentError(f"workers are of the vectorization_mode parallel, not of {mode}")
    if mode == "vector_entry_point":
        if wrappers:
            raise ArgumentError(
                "a PackItVectorEnv has no wrappers of single environments: choose the "
                "vectorization_mode sync, async or parallel"
            )
        return gym.make_vec(
            name,
            num_envs,
            mode,
            autoreset_mode=autoreset_mode,
            member_settings=member_settings,
            **settings,
        )
    each = _each(num_envs, settings, member_settings)
    if mode == "parallel":
        return _parallel(
            name, each, workers or os.cpu_count() or 1, autoreset_mode, tuple(wrappers)
        )
    makers = [partial(_wrapped, name, tuple(wrappers), own) for own in each]
    kind = SyncVectorEnv if mode == "sync" else AsyncVectorEnv
    return kind(makers, autoreset_mode=autoreset_mode)


def _each(
    num_envs: int, settings: Mapping[str, Any], member_settings: MemberSettings | None
) -> list[dict[str, Any]]:
    """Return all settings of each environment."""
    if member_settings is None:
        return [dict(settings) for _ in range(num_envs)]
    if len(member_settings) != num_envs:
        raise ArgumentError(
            f"member_settings are {len(member_settings)}: give those of {num_envs} environments"
        )
    return [{**settings, **own} for own in member_settings]


def _parallel(
    name: str,
    settings: Sequence[dict[str, Any]],
    workers: int,
    autoreset_mode: str,
    wrappers: tuple[Callable[..., Any], ...],
) -> ParallelVectorEnv:
    """Create environments with these settings in processes, as many in each as in the others."""
    shares = np.array_split(np.arange(len(settings)), min(workers, len(settings)))
    own = [[settings[n] for n in share.tolist()] for share in shares]
    makers = [partial(_of_process, name, each, autoreset_mode, wrappers) for each in own]
    return ParallelVectorEnv(makers, [len(each) for each in own])


def _of_process(
    name: str,
    settings: Sequence[dict[str, Any]],
    autoreset_mode: str,
    wrappers: tuple[Callable[..., Any], ...],
) -> SyncVectorEnv:
    """Create the environments of a process, which share tasks where they can."""
    envs = make_vec(
        name,
        len(settings),
        "sync" if wrappers else None,
        autoreset_mode=autoreset_mode,
        wrappers=wrappers,
        member_settings=settings,
    )
    assert isinstance(envs, SyncVectorEnv)
    return envs


def _wrapped(name: str, wrappers: Sequence[Callable[..., Any]], settings: dict[str, Any]) -> Any:
    env = gym.make(name, **settings)
    for wrapper in wrappers:
        env = wrapper(env)
    return env


def _same(env: PackItEnv) -> PackItEnv:
    return env
