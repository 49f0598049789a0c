"""Quality scores of results: stability, insertability and floating items."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import starmap
from pathlib import Path

from msgspec import structs

from packit_sim.core.parallel import Workers
from packit_sim.core.plain_text import plain_logger
from packit_sim.game.evaluation.results import ResultsError, Rollout
from packit_sim.game.evaluation.results_store import opened
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.convex.decomposition import require
from packit_sim.physics.convex.settings import METHODS, DecompositionSettings, Method
from packit_sim.physics.quality import QualityScores
from packit_sim.physics.settings import PhysicsSettings

_log = plain_logger(__name__)

SCORES: Mapping[str, str] = {
    "stable": "share of the placed volume that does not move under gravity",
    "insertable": "share of the placed volume that can be inserted, in packing order, by at most "
    "three straight moves",
    "floating": "items with a gap below them of more than a grid step",
}
"""The fields of `QualityScores`, by their names in files of results, and their meanings."""


def judge(
    rollouts: Sequence[Rollout],
    library: ShapeLibrary,
    pieces: Method = METHODS[0],
    on_judged: Callable[[Rollout], None] = lambda rollout: None,
    *,
    workers: Workers | None = None,
    file: Path | None = None,
) -> list[Rollout]:
    """Add quality scores to rollouts.

    Parameters
    ----------
    rollouts : Sequence[Rollout]
        The rollouts. Those that have all `SCORES`, by the same decomposition, are not judged again.
    pieces : Method
        The method that decomposes shapes into convex pieces.
    on_judged : Callable[[Rollout], None]
        Called after each rollout.
    workers : Workers | None
        The processes that simulate; by default this one does.
    file : Path | None
        The file that contains the rollouts; scores are written as soon as they are computed.

    Returns
    -------
    list[Rollout]
        The same rollouts, with `SCORES` in their provenance.

    Raises
    ------
    MissingPackageError
        If the method is not installed.
    ResultsError
        If the file contains other rollouts.
    PackFormatError
        If the library is another one, or items settled off the grid.
    BusyError
        If another process works on the file.
    """
    require(DecompositionSettings(method=pieces))
    found = list(rollouts)
    with opened(file) as store:
        for rollout in found:
            key = rollout.agent, rollout.task
            if file is not None and (key not in store or store[key] != rollout):
                raise ResultsError(
                    f"{file} does not contain this result of {rollout.agent} on task "
                    f"{rollout.task}: the file has changed"
                )
        jobs = [
            (n, rollout.pack.contents(library), pieces)
            for n, rollout in enumerate(rollouts)
            if not is_judged(rollout, pieces)
        ]
        _log.info("%d of %d results to judge", len(jobs), len(found))
        started = time.monotonic()
        judged = starmap(judge_one, jobs) if workers is None else workers.as_done(judge_one, jobs)
        for n, verdict in judged:
            pack, played = found[n].pack, found[n].played
            scores = {**played.scores, **asdict(verdict)}
            judged_now = structs.replace(played, scores=scores, pieces=pieces)
            found[n] = Rollout(replace(pack, provenance=judged_now))
            on_judged(found[n])
            store.add([found[n]])
    _log.info("%d results judged in %.1f s", len(jobs), time.monotonic() - started)
    return found


def is_judged(rollout: Rollout, pieces: Method) -> bool:
    """Return whether a rollout has all scores, by this method of decomposition."""
    played = rollout.played
    return played.pieces == pieces and all(name in played.scores for name in SCORES)


def judge_one(number: int, box: BoxState[PlacedItem], pieces: Method) -> tuple[int, QualityScores]:
    """Compute the scores of a box, whose number is returned with them."""
    settings = PhysicsSettings(decomposition=DecompositionSettings(method=pieces))
    return number, QualityScores.of(box, settings)
