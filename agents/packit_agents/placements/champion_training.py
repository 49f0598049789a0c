"""Training of the champion: plays of tasks, and a policy gradient; resumable and reproducible."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from packit_agents.learning.mixing import Mixture
from packit_agents.learning.run_folder import RunFolder
from packit_agents.placements.network import PlacementNetwork
from packit_agents.placements.placement_features import FEATURES
from packit_agents.placements.playing import Play, best_return, new_layout, play, plays
from packit_agents.placements.policy_gradient import StepSettings, improve
from packit_sim.core.checks import POSITIVE, Range, check_settings
from packit_sim.core.confidence import Estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.core.parallel import Workers
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.version import __version__
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.evaluation.learning_curves import CurvePoint, TrainingRecord
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import PACKIT, Rules

FIRST_WEIGHTS = {"log volume": 48.0, "contact": 24.0, "top": -6.0}
"""The rule to begin with, which prefers large items, much contact and low tops."""

FIRST_KINEMATIC_WEIGHTS = FIRST_WEIGHTS | {"top": -48.0, "free -z": -300.0}
"""In a kinematic box lower tops are worth more, and it avoids to cover free space."""

MIN_SCALE = 0.05
"""Least scale of a feature: those that hardly vary don't become large."""

_log = plain_logger(__name__)


@dataclass(frozen=True)
class PlacementTrainingSettings:
    """Everything that determines the weights.

    Attributes
    ----------
    packs : tuple of str
        Names or paths of datasets; tasks are drawn from the train split of each.
    rules : Rules
        The rules by which they are played: items stay on the grid and count by their volume.
    start : str, optional
        File of the weights to begin with; None for a rule (see `first_network`).
    tasks : int
        Number of tasks of each, the first.
    mixed : float
        Share of the tasks that are mixed from two (see `Mixture`).
    drawn : int
        Number of tasks of each dataset in a round.
    plays : int
        Number of plays of each task in a round.
    width : int
        Units of a hidden layer.
    step : StepSettings
        The learning from the plays of a round.
    validate_every : int
        Rounds between two validations.
    validation_tasks : int
        Number of tasks of each dataset's validation split, the first.
    library : str
        Name or path of the shape library.
    seed : int
        Seed of all random numbers.
    """

    packs: tuple[str, ...] = ("everyday-v1", "everyday-hard")
    rules: Rules = PACKIT
    start: str | None = None
    tasks: int = 300
    mixed: float = 0.8
    drawn: int = 20
    plays: int = 8
    rounds: int = 40
    width: int = 32
    step: StepSettings = field(default_factory=StepSettings)
    validate_every: int = 5
    validation_tasks: int = 48
    library: str = "everyday"
    seed: int = 0

    def __post_init__(self) -> None:
        check_settings(
            self,
            "setting",
            packs=(len(self.packs) > 0, "at least one dataset"),
            tasks=Range(2),
            mixed=Range(0, 1),
            drawn=Range(1),
            plays=Range(2),
            rounds=Range(1),
            width=Range(1),
            validate_every=Range(1),
            validation_tasks=Range(1),
        )
        if self.rules.moves_items or self.rules.values:
            raise ArgumentError(
                f"training by the rules {self.rules} is not possible: choose rules by which items "
                "stay on the grid and count by their volume"
            )
        check_settings(
            self.step,
            "setting of a step",
            learning_rate=POSITIVE,
            epochs=Range(1),
            minibatch=Range(1),
            clip=Range(0, 1),
        )


@dataclass(frozen=True)
class RoundResult:
    """The result of a round.

    Attributes
    ----------
    rounds : int
        Rounds so far.
    reward : float
        Mean return of its plays.
    best : CurvePoint
        The best point of the learning curve so far.
    """

    rounds: int
    reward: float
    best: CurvePoint


class PlacementTraining:
    """A training in its own folder; the same settings give the same weights.

    Parameters
    ----------
    folder : Path
        A new folder, or that of a training with the same settings, which resumes.

    Raises
    ------
    TrainingError
        If the folder holds a training with other settings.

    Notes
    -----
    The folder holds `settings.json` (settings and digests of the tasks), `curve.json`,
    `best.safetensors` (the weights with the highest validation reward, the first of equal ones) and
    `last.safetensors`, from which a training resumes.
    """

    def __init__(self, settings: PlacementTrainingSettings, folder: Path) -> None:
        self.settings = settings
        self.folder = folder
        library = ShapeLibrary.open(settings.library)
        self._sources = []
        self._validation: list[Task] = []
        for packs in settings.packs:
            tasks = load_tasks(packs, library, "train")[: settings.tasks]
            self._sources.append(Mixture(tasks, library, settings.mixed))
            held_out = load_tasks(packs, library, "validation")
            self._validation += held_out[: settings.validation_tasks]
        self._start = PlacementNetwork.read(Path(settings.start)) if settings.start else None
        self._run = RunFolder(folder, self._provenance())
        self.curve: list[CurvePoint] = []

    @property
    def best(self) -> CurvePoint:
        """The point with the highest validation reward, the first of equal ones."""
        return max(self.curve, key=lambda point: point.validation.mean)

    def run(
        self, workers: Workers, on_round: Callable[[RoundResult], None] = lambda result: None
    ) -> None:
        """Train to the end.

        Parameters
        ----------
        workers : Workers
            Processes that play. The weights do not depend on their number.
        on_round : callable, optional
            Called after each round.
        """
        settings = self.settings
        with self._run.claim():
            network, done, reward = self._resume(workers)
            _log.info("%s: %d of %d rounds are done", self.folder, done, settings.rounds)
            started = time.monotonic()
            while done < settings.rounds:
                groups = self._play(network, done, workers)
                rate = 1 - done / settings.rounds
                network = improve(network, groups, settings.step, _seed(settings.seed, done), rate)
                done += 1
                totals = [play.total for group in groups for play in group]
                reward = float(np.mean(totals))
                if done % settings.validate_every == 0 or done == settings.rounds:
                    self._validate(network, done, reward, workers)
                self._write(network, "last", done)
                on_round(RoundResult(done, reward, self.best))
            _log.info("%s: finished in %.1f s", self.folder, time.monotonic() - started)

    def _resume(self, workers: Workers) -> tuple[PlacementNetwork, int, float | None]:
        """Return the last network and how many rounds it has; at first that to begin with."""
        last = self.folder / "last.safetensors"
        if last.exists():
            network = PlacementNetwork.read(last)
            done = int(network.provenance["rounds"])
            self.curve = [p for p in TrainingRecord.read(self.folder).curve if p.steps <= done]
            return network, done, None
        settings = self.settings
        network = self._start or first_network(
            self._validation, settings.rules, settings.width, settings.seed
        )
        self._validate(network, 0, None, workers)
        return network, 0, None

    def _play(self, network: PlacementNetwork, done: int, workers: Workers) -> list[list[Play]]:
        rng = np.random.default_rng((self.settings.seed, done))
        tasks = [source(rng) for source in self._sources for _ in range(self.settings.drawn)]
        jobs = [
            (task, self.settings.rules, network, self.settings.plays, (self.settings.seed, done, n))
            for n, task in enumerate(tasks)
        ]
        return workers.map(plays, jobs)

    def _validate(
        self, network: PlacementNetwork, done: int, reward: float | None, workers: Workers
    ) -> None:
        jobs = [(task, self.settings.rules, network) for task in self._validation]
        totals = workers.map(best_return, jobs)
        self.curve.append(CurvePoint(done, reward, Estimate.of(np.array(totals))))
        _log.info("round %d: validation reward %.3f", done, self.curve[-1].validation.mean)
        if self.curve[-1] is self.best:
            self._write(network, "best", done)
        self._run.write_curve(self.curve)

    def _write(self, network: PlacementNetwork, name: str, done: int) -> None:
        provenance = {"version": __version__, "rounds": done, **self._provenance()}
        PlacementNetwork(network.tensors, provenance).write(self.folder / f"{name}.safetensors")

    def _provenance(self) -> dict[str, Any]:
        digests = {
            packs: [task.digest for task in source.tasks]
            for packs, source in zip(self.settings.packs, self._sources, strict=True)
        }
        held_out = [task.digest for task in self._validation]
        settings = json.loads(json.dumps(asdict(self.settings)))
        start = {} if self._start is None else {"start": self._start.digest}
        return {"settings": settings, "tasks": digests, "validation": held_out, **start}


def first_network(tasks: Sequence[Task], rules: Rules, width: int, seed: int) -> PlacementNetwork:
    """Create the network to begin with: a rule, with hidden layers that add nothing yet.

    Parameters
    ----------
    tasks : sequence of Task
        Tasks that the rule plays: features are scaled by their mean and spread in these.
    width : int
        Units of a hidden layer.
    seed : int
        Seed of the weights.

    Returns
    -------
    PlacementNetwork
        The network.
    """
    rng = np.random.default_rng(seed)
    weights = FIRST_KINEMATIC_WEIGHTS if rules.kinematic else FIRST_WEIGHTS
    rule = np.array([weights.get(name, 0.0) for name in FEATURES], dtype=np.float32)
    seen = []
    for task in tasks:
        decisions = play(new_layout(task, rules), lambda features: features @ rule, rng)
        seen += [decision.features for decision in decisions]
    features = np.concatenate(seen)
    tensors = {}
    for name, shape in PlacementNetwork.shapes(width).items():
        is_random = name in ("first.weight", "second.weight")
        tensors[name] = np.zeros(shape, dtype=np.float32)
        if is_random:
            tensors[name][:] = rng.normal(size=shape) * np.sqrt(2 / shape[1])
    tensors["mean"] = features.mean(axis=0)
    tensors["scale"] = features.std(axis=0) + np.float32(MIN_SCALE)
    tensors["linear.weight"][0] = rule * tensors["scale"]
    return PlacementNetwork(tensors, {})


def _seed(seed: int, done: int) -> int:
    return int(np.random.SeedSequence((seed, done)).generate_state(1)[0])
