"""Several environments in one process, for evaluation and training in batches."""

from __future__ import annotations

from functools import partial
from typing import Any

from gymnasium.vector import AutoresetMode, SyncVectorEnv

from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv


class PackItVectorEnv(SyncVectorEnv):
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
    **settings : Any
        Settings of `PackItEnv`, the same for all.

    Attributes
    ----------
    members : tuple[PackItEnv, ...]
        The environments.

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
        **settings: Any,
    ) -> None:
        first = PackItEnv(**settings)
        shared = settings | {"tasks": first.maker or first.tasks, "split": None}
        self.members = (first, *(PackItEnv(**shared) for _ in range(num_envs - 1)))
        super().__init__(
            [partial(_same, env) for env in self.members],
            copy=copy,
            autoreset_mode=autoreset_mode,
        )

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks of each environment; empty if they are generated on the fly."""
        return self.members[0].tasks


def _same(env: PackItEnv) -> PackItEnv:
    return env
