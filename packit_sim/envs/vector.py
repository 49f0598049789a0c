"""Environments of one process that play side by side, for evaluation and training in batches."""

from __future__ import annotations

from functools import partial
from typing import Any

from gymnasium.vector import AutoresetMode, SyncVectorEnv

from packit_sim.datasets.packs import Task
from packit_sim.envs.env import PackItEnv


class PackItVectorEnv(SyncVectorEnv):
    """Environments that share one library, its tasks and the engine's caches.

    What `gymnasium.make_vec("PackIt-v0", n)` makes: n are as cheap to open as one, and what one of
    them found out about two items the others know. settings: of `PackItEnv`, all the same.
    autoreset_mode, copy: as of Gymnasium's `SyncVectorEnv`; with copy=False the arrays of an
    observation are those of the next. members: the environments.
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
        """Those of each environment; none where they are made on the fly."""
        return self.members[0].tasks


def _same(env: PackItEnv) -> PackItEnv:
    return env
