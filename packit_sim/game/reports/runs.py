"""The contents of a report: evaluations and trainings, under unique names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import mean

from packit_sim.core.errors import PackItError
from packit_sim.game.evaluation.learning_curves import TrainingRecord
from packit_sim.game.evaluation.results import Rollout, read_results
from packit_sim.rules import Rules


class ReportError(PackItError, ValueError):
    """Runs that cannot be reported."""


@dataclass(frozen=True)
class EvaluationRun:
    """The results of one agent.

    Attributes
    ----------
    name : str
        Its unique name in the report.
    file : Path
        The file of results.
    rollouts : tuple[Rollout, ...]
        At least one, one for each task, in the order of tasks.
    """

    name: str
    file: Path
    rollouts: tuple[Rollout, ...]

    @property
    def seed(self) -> int:
        """The seed of the evaluation."""
        return self.rollouts[0].seed

    @property
    def reward(self) -> float:
        """The mean return."""
        return mean(rollout.total for rollout in self.rollouts)

    @property
    def rules(self) -> Rules:
        """The rules that were played."""
        return self.rollouts[0].rules


@dataclass(frozen=True)
class TrainingRun:
    """A training.

    Attributes
    ----------
    name : str
        Its unique name in the report.
    run : TrainingRecord
        The record in its folder.
    """

    name: str
    run: TrainingRecord


@dataclass(frozen=True)
class Runs:
    """Everything that a report contains, in the requested order.

    Attributes
    ----------
    played : tuple[EvaluationRun, ...]
        The results of agents.
    """

    played: tuple[EvaluationRun, ...]
    learned: tuple[TrainingRun, ...]

    @classmethod
    def read(cls, paths: Sequence[Path]) -> Runs:
        """Read files of results (`packit evaluate --out`) and folders of trainings.

        Parameters
        ----------
        paths : Sequence[Path]
            Files and folders.

        Returns
        -------
        Runs
            The runs. Names of agents that are in several files contain the file's name.

        Raises
        ------
        ReportError
            If there is nothing to read.
        PackFormatError
            If a file cannot be read; ResultsError and CurveError likewise.
        """
        played: list[tuple[str, Path, list[Rollout]]] = []
        trained: list[TrainingRecord] = []
        for path in dict.fromkeys(paths):
            if path.is_dir():
                trained.append(TrainingRecord.read(path))
            elif path.exists():
                played += [(name, path, own) for name, own in _by_agent(path).items()]
            else:
                raise ReportError(
                    f"{path}: there is no such file or folder; choose files that "
                    "`packit evaluate --out` wrote, and folders of `packit train`"
                )
        if not played and not trained:
            raise ReportError("a report needs at least one file of results or folder of a training")
        names = _unique([(name, path) for name, path, _ in played])
        folders = _unique([(run.folder.resolve().name, run.folder) for run in trained])
        return cls(
            tuple(
                EvaluationRun(name, path, tuple(own))
                for name, (_, path, own) in zip(names, played, strict=True)
            ),
            tuple(TrainingRun(name, run) for name, run in zip(folders, trained, strict=True)),
        )


def _by_agent(file: Path) -> dict[str, list[Rollout]]:
    """Group rollouts by agent, each group in the order of tasks."""
    found: dict[str, list[Rollout]] = {}
    for rollout in read_results(file):
        found.setdefault(rollout.agent, []).append(rollout)
    for agent, own in found.items():
        own.sort(key=lambda rollout: rollout.task)
        for before, after in pairwise(own):
            if before.task == after.task:
                raise ReportError(
                    f"{file} holds two results of {agent!r} on task {after.task}: "
                    "write each evaluation to a separate file"
                )
    return found


def _unique(names: Sequence[tuple[str, Path]]) -> list[str]:
    """Make names unique by adding the path's stem, or all of it, where they repeat."""
    counts = Counter(name for name, _ in names)
    longer = [name if counts[name] == 1 else f"{name} ({path.stem})" for name, path in names]
    again = Counter(longer)
    return [
        long if again[long] == 1 else f"{name} ({path})"
        for long, (name, path) in zip(longer, names, strict=True)
    ]
