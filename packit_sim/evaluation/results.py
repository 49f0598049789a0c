"""What agents made of tasks: rollouts, and files of them.

A file of results is a file of packs (see `packs`), the boxes as the agents left them: each tells in
`made` how it came to be, so that it can be repeated, and can be verified and drawn like any pack.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from packit_sim.box import Box
from packit_sim.core.errors import PackItError
from packit_sim.core.files import claimed
from packit_sim.datasets.packs import Pack, Task, read_packs, write_packs
from packit_sim.game.episode import End, Episode
from packit_sim.rules import Rules

RESULTS_FORMAT = 1
"""Version of what `made` of a rollout's pack holds, which it tells as "results"."""

CHECKPOINT_SECONDS = 5.0
"""What is new is written so often; what a kill can lose, and the work under way."""


class ResultsError(PackItError, ValueError):
    """A file that holds no results, or results of something else."""


@dataclass(frozen=True)
class Rollout:
    """One episode that was played.

    agent: its name. task: the number of the task. task_digest: tells it from others. seed: of the
    evaluation. total: the return. end: why it was over. pack: the box as the agent left it.
    weights: of an agent that learned, see `Agent.weights`. seconds: that it took, on a machine that
    may have done other things as well; two rollouts are equal whatever it was.
    """

    agent: str
    task: int
    task_digest: str
    seed: int
    rules: Rules
    total: float
    end: End
    pack: Pack
    seconds: float = field(compare=False)
    weights: str | None = None

    @classmethod
    def of(
        cls,
        episode: Episode,
        agent: str,
        number: int,
        seed: int,
        rules: Rules,
        seconds: float,
        weights: str | None = None,
    ) -> Rollout:
        """The record of an episode that is over.

        Raises ResultsError where items settled: a pack's stand on the grid.
        """
        assert episode.end is not None
        if not isinstance(episode.box, Box):
            raise ResultsError(
                f"what lies in a {type(episode.box).__name__} can't be told as a pack, "
                "whose items stand on the grid"
            )
        made = {
            "results": RESULTS_FORMAT,
            "by": agent,
            "task": number,
            "task_digest": episode.task.digest,
            "seed": seed,
            "easy": rules.easy,
            "kinematic": rules.kinematic,
            "return": episode.total,
            "end": str(episode.end),
            **({} if weights is None else {"weights": weights}),
        }
        pack = Pack.of(episode.box, episode.task.pack.library, **made)
        return cls(
            agent,
            number,
            episode.task.digest,
            seed,
            rules,
            episode.total,
            episode.end,
            pack,
            seconds,
            weights,
        )

    def to_pack(self) -> Pack:
        """The pack with all that `from_pack` reads."""
        return replace(self.pack, made={**self.pack.made, "seconds": round(self.seconds, 6)})

    @classmethod
    def from_pack(cls, pack: Pack) -> Rollout:
        """Raises ResultsError where the pack is no rollout's, or of another version."""
        made = dict(pack.made)
        if made.get("results") != RESULTS_FORMAT:
            raise ResultsError(
                f"field 'made.results' is {made.get('results')!r}: this version reads "
                f"{RESULTS_FORMAT}, which `packit evaluate --out` writes"
            )
        seconds = _get(made, "seconds", float)
        del made["seconds"]
        return cls(
            _get(made, "by", str),
            _get(made, "task", int),
            _get(made, "task_digest", str),
            _get(made, "seed", int),
            Rules(_get(made, "easy", bool), _get(made, "kinematic", bool)),
            _get(made, "return", float),
            End(_get(made, "end", str)),
            replace(pack, made=made),
            seconds,
            _get(made, "weights", str) if "weights" in made else None,
        )


def read_results(path: Path | str) -> list[Rollout]:
    """Raises ResultsError, or PackFormatError, that name the file, the line and what is wrong."""
    rollouts = []
    for number, pack in enumerate(read_packs(path), start=1):
        try:
            rollouts.append(Rollout.from_pack(pack))
        except ValueError as error:
            raise ResultsError(f"{path}, pack {number}: {error}") from None
    return rollouts


def write_results(path: Path | str, rollouts: Iterable[Rollout]) -> None:
    """Writes them, whole or not at all."""
    write_packs(path, [rollout.to_pack() for rollout in rollouts])


class ResultsStore:
    """Rollouts by agent and task, and the file that keeps them, if there is one (see `opened`).

    agents: names of those that are to come, in the order in which they stand after what the file
    holds already. The file is the same whatever is finished first.
    """

    def __init__(self, file: Path | None, agents: Iterable[str] = ()) -> None:
        held = read_results(file) if file is not None and file.exists() else []
        self._file = file
        self._held = {(rollout.agent, rollout.task): rollout for rollout in held}
        self._names = list(dict.fromkeys([*(rollout.agent for rollout in held), *agents]))
        self._new = False
        self._written = time.monotonic()

    @property
    def rollouts(self) -> list[Rollout]:
        """By agent, then by task."""
        by = self._names.index
        return sorted(self._held.values(), key=lambda rollout: (by(rollout.agent), rollout.task))

    def __contains__(self, agent_and_task: tuple[str, int]) -> bool:
        return agent_and_task in self._held

    def __getitem__(self, agent_and_task: tuple[str, int]) -> Rollout:
        return self._held[agent_and_task]

    def add(self, rollouts: Iterable[Rollout]) -> None:
        """Takes rollouts in, in place of older ones; writes if it is time to."""
        for rollout in rollouts:
            self._held[rollout.agent, rollout.task] = rollout
            self._new = True
        if time.monotonic() - self._written > CHECKPOINT_SECONDS:
            self.write()

    def write(self) -> None:
        """Writes the file, whole or not at all, where something is new."""
        if self._file is not None and self._new:
            write_results(self._file, self.rollouts)
        self._new = False
        self._written = time.monotonic()


@contextmanager
def opened(file: Path | None, agents: Iterable[str] = ()) -> Iterator[ResultsStore]:
    """A ledger, whose file no other process works on meanwhile, and is written at the end.

    Raises BusyError where another process is at work on it, and what `read_results` raises.
    """
    alone = nullcontext() if file is None else claimed(file.with_name(f".{file.name}.lock"), file)
    with alone:
        ledger = ResultsStore(file, agents)
        yield ledger
        ledger.write()


def check_same(
    path: Path,
    rollouts: Iterable[Rollout],
    weights: Mapping[str, str | None],
    tasks: Sequence[Task],
    seed: int,
    rules: Rules,
) -> None:
    """Raises ResultsError where results are not of these tasks, this seed and these rules, or of
    agents whose weights, by name, are others now.
    """
    for rollout in rollouts:
        known = rollout.task < len(tasks)
        facts = {
            "seed": (rollout.seed, seed),
            "rules": (rollout.rules, rules),
            f"task {rollout.task}": (
                rollout.task_digest,
                tasks[rollout.task].digest if known else rollout.task_digest,
            ),
            f"weights of {rollout.agent}": (
                rollout.weights,
                weights.get(rollout.agent, rollout.weights),
            ),
        }
        for name, (theirs, ours) in facts.items():
            if theirs != ours:
                raise ResultsError(
                    f"{path} holds results with {name} {theirs}, not {ours}: choose another file"
                )


def _get(made: Mapping[str, Any], key: str, kind: type) -> Any:
    value = made.get(key)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ResultsError(f"field 'made.{key}' is {value!r}: it must be of type {kind.__name__}")
    return value
