"""Which puzzles exact cover fills: a reference for what searches leave unsolved.

    .venv/bin/python -m benchmarks.exact_cover    (20 minutes; resumable; needs the extra exact)

Plays the puzzles of `benchmarks.puzzles` whose pieces are cuboids or polycubes, the first
(`--boxes`) of each kind and number of pieces, for at most `--seconds` each. Each filling is played
in an episode, so that the engine decides about it. Writes `exact_cover.json` after each
puzzle, and a table into the page of the puzzles; `--table` only writes the table.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.common import (
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from packit_agents.planning.exact_cover import Outcome, exact_cover
from packit_sim import Episode, cut_puzzle
from packit_sim.game.datasets.packs import Task
from packit_sim.game.datasets.provenance import PuzzleName
from packit_sim.game.episodes.agents import play_placement

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "puzzles.md"

KINDS: tuple[PuzzleName, ...] = ("guillotine", "pinwheel", "polycubes")

PIECES = (5, 8, 12, 16, 24, 32)

SEED = 0
"""The seed of the first puzzle, and of the restarts."""


@dataclass(frozen=True)
class Trial:
    """One puzzle: the outcome, the time, and the return of its episode (0 if it is not filled)."""

    cuts: PuzzleName
    pieces: int
    seed: int
    outcome: str
    seconds: float
    total: float


def tried(cuts: PuzzleName, pieces: int, seed: int, seconds: float) -> Trial:
    """Fill a puzzle, and play what was found."""
    box = cut_puzzle(cuts, pieces, seed)
    task = Task.of([placed.item.turned(0) for placed in box.placed], box.cells)
    started = time.perf_counter()
    found = exact_cover(task.items, box.cells, seconds, SEED)
    spent = time.perf_counter() - started
    episode = Episode(task)
    for placed in found.placed:
        play_placement(episode, placed)
    return Trial(cuts, pieces, seed, found.outcome, round(spent, 2), episode.total)


def markdown(trials: Sequence[Trial]) -> str:
    """Write a table with a row for each kind and number of pieces."""
    rows = []
    for cuts in KINDS:
        for pieces in PIECES:
            own = [one for one in trials if (one.cuts, one.pieces) == (cuts, pieces)]
            if not own:
                continue
            filled = [one for one in own if one.outcome == Outcome.FILLED]
            times = ", ".join(f"{one.seconds:.1f}" for one in filled)
            rows.append([f"`{cuts}`", str(pieces), f"{len(filled)} of {len(own)}", times])
    return markdown_table(["puzzle", "pieces", "filled", "seconds"], rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--boxes", type=int, default=2, help="puzzles a kind and number of pieces")
    parser.add_argument("--seconds", type=float, default=60.0, help="limit for each")
    parser.add_argument("--table", action="store_true", help="only write the table")
    arguments = parser.parse_args()
    file = arguments.out / "exact_cover.json"
    kept = json.loads(file.read_text())["trials"] if file.exists() else []
    trials = [Trial(**one) for one in kept]
    for pieces, cuts, n in itertools.product(PIECES, KINDS, range(arguments.boxes)):
        known = any((one.cuts, one.pieces, one.seed) == (cuts, pieces, SEED + n) for one in trials)
        if known or arguments.table:
            continue
        trials.append(tried(cuts, pieces, SEED + n, arguments.seconds))
        result = {
            "command": "python -m benchmarks.exact_cover "
            f"--boxes {arguments.boxes} --seconds {arguments.seconds:g}",
            "machine": machine(),
            "trials": [asdict(one) for one in trials],
        }
        write_json(file, result)
    write_into_page(PAGE, markdown(trials), "exact cover")


if __name__ == "__main__":
    main()
