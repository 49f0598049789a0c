"""Training of `ValueTables`: games against random arrivals, by temporal differences."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from packit_agents.learning.run_folder import RunFolder, TrainingError
from packit_agents.online.column_kernels import play
from packit_agents.online.columns import ColumnGame
from packit_agents.online.value_tables import Patterns, ValueTables
from packit_sim.core.checks import Range, check_settings
from packit_sim.core.choices import RotationSet
from packit_sim.core.confidence import Estimate
from packit_sim.core.files import replacing
from packit_sim.core.parallel import Workers
from packit_sim.core.version import __version__
from packit_sim.game.evaluation.learning_curves import CurvePoint, TrainingRecord
from packit_sim.game.generation.sequences import SequenceSampler
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import Triple
from packit_sim.libraries.library import ShapeLibrary

FIRST_VALUE = 0.8
"""Value of the empty box at first, as a share of the shapes that fill it: states that were never
seen are worth a visit."""

VALIDATION_SEED = 1 << 32
"""Seed of the games of validation, which no training has."""


@dataclass(frozen=True)
class ValueTrainingSettings:
    """Everything that determines the tables.

    Attributes
    ----------
    library : str
        Name or path of the shape library, of polycubes.
    cells : tuple of int
        Cells of the box along x, y and z.
    step_cm : float
        Side of a cube, a grid step, in cm.
    rotations : str
        The rotations that items may have.
    buffers : tuple of int
        Sizes of the buffer: each has tables of its own.
    games : int
        Games of a round, for each buffer.
    rounds : int
        Rounds.
    validation_games : int
        Games after each round, from which nothing is learned.
    seed : int
        Seed of the arrivals.
    """

    library: str = "blockout"
    cells: Triple = (20, 20, 20)
    step_cm: float = 5.9
    rotations: RotationSet = "yaw"
    buffers: tuple[int, ...] = (1, 3, 5, 10)
    games: int = 20_000
    rounds: int = 20
    validation_games: int = 1_000
    seed: int = 0

    def __post_init__(self) -> None:
        check_settings(
            self,
            "setting",
            buffers=(
                len(set(self.buffers)) == len(self.buffers) > 0 and min(self.buffers) >= 1,
                "different sizes from 1 on",
            ),
            games=Range(1),
            rounds=Range(1),
            validation_games=Range(2),
            seed=Range(0),
        )


@dataclass(frozen=True)
class RoundResult:
    """The result of a round: the shapes that were placed in validation, by size of the buffer."""

    rounds: int
    placed: dict[int, Estimate]


@dataclass(frozen=True)
class _Learner:
    """The tables for one size of the buffer, float64, and what determines the rates of learning."""

    entries: Floats
    errors: Floats
    sizes: Floats

    def after_games(
        self, game: ColumnGame, buffer: int, settings: ValueTrainingSettings, done: int
    ) -> tuple[_Learner, Floats]:
        """Play a round, and then games of validation: their numbers of placed shapes, (games,)."""
        rng = np.random.default_rng((settings.seed, buffer, done))
        own = _Learner(self.entries.copy(), self.errors.copy(), self.sizes.copy())
        tables = Patterns.of(game.sides).arrays(own.entries)
        arrivals = _arrivals(game, buffer, settings.games, rng)
        play(arrivals, buffer, game.arrays, tables, (own.errors, own.sizes))
        held_out = np.random.default_rng((VALIDATION_SEED, buffer))
        arrivals = _arrivals(game, buffer, settings.validation_games, held_out)
        nothing = np.empty(0)
        placed = play(arrivals, buffer, game.arrays, tables, (nothing, nothing))
        return own, placed.astype(float)


class ValueTraining:
    """A training in its own folder; the same settings give the same tables.

    Parameters
    ----------
    folder : Path
        A new folder, or that of a training with the same settings, which resumes.

    Raises
    ------
    TrainingError
        If the folder holds a training with other settings.
    ArgumentError
        If a shape of the library is no polycube of whole cubes.

    Notes
    -----
    The folder holds `settings.json`, `curve.json`, `last.safetensors` (the tables) and `last.npz`,
    from which a training resumes.
    """

    def __init__(self, settings: ValueTrainingSettings, folder: Path) -> None:
        self.settings = settings
        self.folder = folder
        library = ShapeLibrary.open(settings.library)
        sampler = SequenceSampler(library, settings.cells, settings.step_cm)
        items = [sampler.item(id) for id in library]
        self.game = ColumnGame.of(settings.cells, items, settings.rotations)
        self._run = RunFolder(folder, self._provenance())
        self._curve: list[CurvePoint] = []

    def run(
        self, workers: Workers, on_round: Callable[[RoundResult], None] = lambda result: None
    ) -> ValueTables:
        """Train to the end.

        Parameters
        ----------
        workers : Workers
            Processes that play, one for each size of the buffer at most.
        on_round : callable, optional
            Called after each round.

        Returns
        -------
        ValueTables
            The tables.
        """
        settings = self.settings
        with self._run.claim():
            learners, done = self._resume()
            while done < settings.rounds:
                jobs = [
                    (learner, self.game, buffer, settings, done)
                    for buffer, learner in zip(settings.buffers, learners, strict=True)
                ]
                found = workers.map(_Learner.after_games, jobs)
                learners = [learner for learner, _ in found]
                done += 1
                placed = [own for _, own in found]
                point = Estimate.of(np.concatenate(placed))
                self._curve.append(CurvePoint(done * settings.games, None, point))
                self._write(learners, done)
                each = zip(settings.buffers, map(Estimate.of, placed), strict=True)
                on_round(RoundResult(done, dict(each)))
        return ValueTables.read(self.folder / "last.safetensors")

    def _resume(self) -> tuple[list[_Learner], int]:
        """Return the tables, and how many rounds they have."""
        last = self.folder / "last.npz"
        if last.exists():
            try:
                with np.load(last, allow_pickle=False) as file:
                    done, arrays = int(file["done"]), file["learners"]
            except (OSError, EOFError, ValueError, KeyError, BadZipFile):
                raise TrainingError(f"{last} is damaged: start in another folder") from None
            steps = done * self.settings.games
            self._curve = [p for p in TrainingRecord.read(self.folder).curve if p.steps <= steps]
            return [_Learner(*own) for own in arrays], done
        patterns = Patterns.of(self.game.sides)
        first = FIRST_VALUE * self.game.most_shapes / len(patterns.starts)
        zeros = np.zeros((2, patterns.entries))
        entries = np.full(patterns.entries, first)
        return [_Learner(entries.copy(), *zeros.copy()) for _ in self.settings.buffers], 0

    def _write(self, learners: list[_Learner], done: int) -> None:
        self._run.write_curve(self._curve)
        buffers = {
            buffer: learner.entries.astype(np.float32)
            for buffer, learner in zip(self.settings.buffers, learners, strict=True)
        }
        provenance = {"version": __version__, "rounds": done, **self._provenance()}
        ValueTables(self.game, buffers, provenance).write(self.folder / "last.safetensors")
        arrays = np.array([(own.entries, own.errors, own.sizes) for own in learners])
        with replacing(self.folder / "last.npz") as file:
            np.savez(file, done=done, learners=arrays)

    def _provenance(self) -> dict[str, Any]:
        library = ShapeLibrary.open(self.settings.library)
        settings = json.loads(json.dumps(asdict(self.settings)))
        return {"settings": settings, "library": library.digest}


def _arrivals(
    game: ColumnGame, buffer: int, games: int, rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Draw the shapes that arrive: more than can be placed."""
    return rng.integers(len(game.shapes), size=(games, buffer + game.most_shapes + 1))
