"""A store of results while they are computed: their file, which evaluations resume."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path

from packit_sim.core.files import claimed, lock_path
from packit_sim.game.datasets import manifests
from packit_sim.game.datasets.packs import Task
from packit_sim.game.evaluation.results import ResultsError, Rollout, read_results, write_results
from packit_sim.rules import Rules

CHECKPOINT_SECONDS = 5.0
"""The interval at which new results are written: if the process is killed, later ones are lost."""


class ResultsStore:
    """Rollouts by agent and task, and their file, if there is one (see `opened`).

    The file does not depend on the order in which rollouts are added.

    Parameters
    ----------
    file : Path | None
        The file of results, which is read if it exists.
    agents : Iterable[str]
        The names of further agents, in their order after those of the file.
    """

    def __init__(self, file: Path | None, agents: Iterable[str] = ()) -> None:
        existing = read_results(file) if file is not None and file.exists() else []
        self._file = file
        self._rollouts = {(rollout.agent, rollout.task): rollout for rollout in existing}
        self._names = list(dict.fromkeys([*(rollout.agent for rollout in existing), *agents]))
        self._new = False
        self._written = time.monotonic()

    @property
    def rollouts(self) -> list[Rollout]:
        """All rollouts, by agent, then by task."""
        by = self._names.index
        return sorted(
            self._rollouts.values(), key=lambda rollout: (by(rollout.agent), rollout.task)
        )

    def __contains__(self, agent_and_task: tuple[str, int]) -> bool:
        return agent_and_task in self._rollouts

    def __getitem__(self, agent_and_task: tuple[str, int]) -> Rollout:
        return self._rollouts[agent_and_task]

    def add(self, rollouts: Iterable[Rollout]) -> None:
        """Add or replace rollouts, and write the file every `CHECKPOINT_SECONDS`."""
        for rollout in rollouts:
            self._rollouts[rollout.agent, rollout.task] = rollout
            self._new = True
        if time.monotonic() - self._written > CHECKPOINT_SECONDS:
            self.write()

    def write(self) -> None:
        """Write the file, completely or not at all, if there are new rollouts."""
        if self._file is not None and self._new:
            write_results(self._file, self.rollouts)
        self._new = False
        self._written = time.monotonic()


@contextmanager
def opened(file: Path | None, agents: Iterable[str] = ()) -> Iterator[ResultsStore]:
    """Open a results store with its file locked, and write the file at the end.

    Parameters
    ----------
    file : Path | None
        The file of results, if there is one.
    agents : Iterable[str]
        The agents of `ResultsStore`.

    Yields
    ------
    ResultsStore
        The store.

    Raises
    ------
    BusyError
        If another process works on the file, or if `read_results` raises it.
    """
    alone = nullcontext() if file is None else claimed(lock_path(file), file)
    with alone:
        if file is not None:
            manifests.prepare(file)
        store = ResultsStore(file, agents)
        yield store
        store.write()


def check_evaluation(
    path: Path,
    rollouts: Iterable[Rollout],
    weights: Mapping[str, tuple[str | None, ...]],
    tasks: Mapping[int, Task],
    seed: int,
    rules: Rules,
) -> None:
    """Check that results belong to an evaluation.

    Parameters
    ----------
    path : Path
        The file of the results.
    rollouts : Iterable[Rollout]
        The results.
    weights : Mapping[str, tuple[str | None, ...]]
        The digest of the weights of each agent, and others that are known for the same weights.

    Raises
    ------
    ResultsError
        If one was played with another task, seed, rules or weights.
    """
    for rollout in rollouts:
        agent, number, digest = rollout.agent, rollout.task, rollout.task_digest
        known = weights.get(agent, (rollout.weights,))
        own = rollout.weights if rollout.weights in known else known[0]
        facts = {
            "seed": (rollout.seed, seed),
            "rules": (rollout.rules, rules),
            f"task {number}": (digest, tasks[number].digest if number in tasks else digest),
            f"weights of {agent}": (rollout.weights, own),
        }
        for name, (theirs, ours) in facts.items():
            if theirs != ours:
                raise ResultsError(
                    f"{path} contains results with {name} {theirs}, not {ours}: choose another file"
                )
