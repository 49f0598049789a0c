"""The hardness curve of puzzles: what a rule, alone and with a search, packs by kind and pieces.

    .venv/bin/python -m benchmarks.puzzles    (half an hour of one core; a stopped run resumes)

Cuts boxes of each kind into 5 to 32 pieces, and lets the agents pack them. The rule alone plays all
of them (`--boxes` of each kind and number of pieces), the search the first ones (`--searched`). The
puzzles and the results of each task stay in `--folder`, where a stopped run resumes. Prints a
table, and writes `puzzles.json` and a plot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.common import argument_parser, machine, plot_file, write_json
from packit_sim import Rollout, evaluate
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.datasets.pack_files import WHOLE, load_tasks, read_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.datasets.provenance import RETURN_SLACK, Puzzle, PuzzleName
from packit_sim.game.generation.puzzles import PuzzleJob, generate_puzzles
from packit_sim.render import plots

RULE = "largest-fitting-first/lowest/maximal-contact"
SEARCH = f"{RULE}+lns=10s"
LABELS = {RULE: "rule alone", SEARCH: "with 10 s of search"}

KINDS: tuple[PuzzleName, ...] = get_args(PuzzleName)
ALL = "all"
"""Stands for all kinds together."""

PIECES = (5, 8, 12, 16, 24, 32)

SEED = 0
"""The seed of the first puzzle, and of the evaluation."""


@dataclass(frozen=True)
class Point:
    """What an agent reached on the puzzles of one kind and number of pieces.

    `solved` is Success@1 in percent.
    """

    agent: str
    cuts: str
    pieces: int
    boxes: int
    reward: Estimate
    solved: Estimate


def cut(job: PuzzleJob, folder: Path) -> tuple[Task, ...]:
    """Generate puzzles if they are not there yet, and load them."""
    file = folder / f"{WHOLE}.jsonl"
    if not file.exists() or [pack.provenance for pack in read_packs(file)] != list(job.records):
        generate_puzzles(job, folder)
    return load_tasks(file)


def puzzle(task: Task) -> Puzzle:
    """Return the provenance of a task."""
    record = task.pack.provenance
    assert isinstance(record, Puzzle)
    return record


def points(played: Mapping[str, Sequence[Rollout]], tasks: Sequence[Task]) -> Iterator[Point]:
    """Score each agent on each kind and number of pieces."""
    for agent, rollouts in played.items():
        for cuts in (*KINDS, ALL):
            for pieces in PIECES:
                records = [puzzle(tasks[rollout.task]) for rollout in rollouts]
                totals = np.array(
                    [
                        rollout.total
                        for rollout, record in zip(rollouts, records, strict=True)
                        if record.pieces == pieces and cuts in (record.cuts, ALL)
                    ]
                )
                reward = Estimate.of(totals)
                solved = Estimate.of(100.0 * (totals >= 1 - RETURN_SLACK))
                yield Point(agent, cuts, pieces, len(totals), reward, solved)


def markdown(found: Sequence[Point]) -> str:
    """Write a table with a row for each kind and number of pieces."""
    columns = ["puzzle", "pieces"]
    for label in LABELS.values():
        columns += [f"reward, {label}", "solved, %"]
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for cuts in (*KINDS, ALL):
        for pieces in PIECES:
            own = {p.agent: p for p in found if (p.cuts, p.pieces) == (cuts, pieces)}
            cells = [cuts if cuts == ALL else f"`{cuts}`", str(pieces)]
            for agent in LABELS:
                cells.append(format_estimate(own[agent].reward, ".3f"))
                cells.append(format_estimate(own[agent].solved, ".0f"))
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(found: Sequence[Point], file: Path) -> None:
    """Plot the mean return over the number of pieces, an agent in each panel."""
    with plots.drawn(file, [["rule", "search"]], 11, 4.5) as (figure, axes):
        for ax, agent in zip(axes.values(), LABELS, strict=True):
            for cuts, color, marker in zip(KINDS, plots.COLORS, "osD^", strict=False):
                own = [p for p in found if (p.agent, p.cuts) == (agent, cuts)]
                estimates = [p.reward for p in own]
                plots.line(ax, PIECES, estimates, color=color, marker=marker, label=cuts)
            boxes = min(p.boxes for p in found if p.agent == agent)
            ax.set(title=f"{LABELS[agent]}, {boxes} boxes a point", xlabel="pieces")
            ax.set(ylabel="mean return", ylim=(0.4, 1.02), xticks=PIECES)
        axes["rule"].legend()
        figure.suptitle("Puzzles: what is packed of boxes that can be filled")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--boxes", type=int, default=5, help="puzzles a kind and number of pieces")
    parser.add_argument("--searched", type=int, default=2, help="the same, for the search")
    parser.add_argument("--folder", type=Path, default=Path("puzzle-hardness"))
    arguments = parser.parse_args()
    tasks = cut(PuzzleJob(KINDS, PIECES, arguments.boxes, SEED), arguments.folder)
    first = [n for n, one in enumerate(tasks) if puzzle(one).seed < SEED + arguments.searched]
    results = arguments.folder / "results.jsonl"
    played = {
        agent: evaluate(
            [agent], [tasks[n] for n in numbers], SEED, file=results, numbers=list(numbers)
        )
        for agent, numbers in {RULE: range(len(tasks)), SEARCH: first}.items()
    }
    found = list(points(played, tasks))
    write_json(
        arguments.out / "puzzles.json",
        {
            "command": f"python -m benchmarks.puzzles --boxes {arguments.boxes} "
            f"--searched {arguments.searched}",
            "seed": SEED,
            "machine": machine(),
            "points": [asdict(point) for point in found],
        },
    )
    draw(found, plot_file(arguments.out, "puzzles"))
    print(markdown(found))


if __name__ == "__main__":
    main()
