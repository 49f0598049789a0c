"""What agents left is judged: does it stand, can it be packed at all, does anything float?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import starmap
from pathlib import Path

from packit_sim.box import BoxState
from packit_sim.core.parallel import Workers
from packit_sim.evaluation.results import ResultsError, Rollout, opened
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.convex.decomposition import require
from packit_sim.physics.quality import QualityScores
from packit_sim.physics.settings import METHODS, DecompositionSettings, Method, PhysicsSettings

SCORES: Mapping[str, str] = {
    "stable": "share of the placed volume that stays where it is when all is let go",
    "insertable": "share of the placed volume that gets to its place, in packing order, by at most "
    "three straight moves",
    "floating": "items that hang more than a step of the grid above what is below them",
}
"""The fields of `QualityScores`, by their names in results files, and what each means."""

PIECES = "pieces"
"""The name under which results tell what made shapes convex pieces, a `Method`."""


def judge(
    rollouts: Sequence[Rollout],
    library: ShapeLibrary,
    pieces: Method = METHODS[0],
    on_judged: Callable[[Rollout], None] = lambda rollout: None,
    *,
    workers: Workers | None = None,
    file: Path | None = None,
) -> list[Rollout]:
    """The same rollouts, each with `SCORES` in what its pack tells of itself, in `made`.

    Those that have them are not judged again, unless their shapes became convex pieces in another
    way. file: which holds the rollouts, and gets the scores as they come. Raises PhysicsError where
    what makes pieces is not installed, ResultsError where the file holds other rollouts,
    PackFormatError where the library is another, and BusyError where another process is at work on
    the file.
    """
    require(DecompositionSettings(method=pieces))
    found = list(rollouts)
    with opened(file) as ledger:
        for rollout in found:
            key = rollout.agent, rollout.task
            if file is not None and (key not in ledger or ledger[key] != rollout):
                raise ResultsError(
                    f"{file} does not hold what {rollout.agent} made of task {rollout.task}: "
                    "it was changed meanwhile"
                )
        jobs = [
            (n, BoxState(rollout.pack.cells, rollout.pack.placed(library)), pieces)
            for n, rollout in enumerate(rollouts)
            if not is_judged(rollout, pieces)
        ]
        judged = starmap(_judged, jobs) if workers is None else workers.as_done(_judged, jobs)
        for n, verdict in judged:
            pack = found[n].pack
            told = {**pack.made, PIECES: pieces, **asdict(verdict)}
            found[n] = replace(found[n], pack=replace(pack, made=told))
            on_judged(found[n])
            ledger.add([found[n]])
    return found


def is_judged(rollout: Rollout, pieces: Method) -> bool:
    """Whether a rollout has all scores, of shapes that became convex pieces in this way."""
    made = rollout.pack.made
    return made.get(PIECES) == pieces and all(name in made for name in SCORES)


def _judged(number: int, box: BoxState, pieces: Method) -> tuple[int, QualityScores]:
    settings = PhysicsSettings(decomposition=DecompositionSettings(method=pieces))
    return number, QualityScores.of(box, settings)
