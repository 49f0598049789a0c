"""The leaderboards: check results files, keep them, and write the pages of the boards.

    .venv/bin/python -m benchmarks.leaderboard results.jsonl   (a minute for 150 tasks)
    .venv/bin/python -m benchmarks.leaderboard                 (only writes the pages)
    .venv/bin/python -m benchmarks.leaderboard --verify        (checks all kept files again)
    .venv/bin/python -m benchmarks.leaderboard --verify KEPT   (only these .jsonl.gz files)

Each folder in `benchmarks/results/leaderboard` is a board: `board.json` says which tasks are played
by which rules, and next to it is a compressed results file, with its manifest, for each agent. All
numbers of the pages are computed from these files. A new run of an agent replaces its file. A new
board is a new folder with a `board.json`.
"""

from __future__ import annotations

import argparse
import gzip
import math
import os
import re
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from msgspec import Struct

from benchmarks.common import RESULTS, markdown_table, write_into_page
from packit_sim import PackItError, Rollout, SequenceSampler, ShapeLibrary
from packit_sim.core import typed_json
from packit_sim.core.choices import Split
from packit_sim.core.confidence import format_estimate
from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.files import replace_text, replacing
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import find_manifest, manifest_path
from packit_sim.game.datasets.pack_files import dataset_library, load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.evaluation.evaluation import Score
from packit_sim.game.evaluation.results import ResultsError, read_results
from packit_sim.game.evaluation.results_store import check_evaluation
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.measures import MEASURES
from packit_sim.rules import PACKIT, Rules

BOARDS = RESULTS / "leaderboard"

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "leaderboard.md"
"""The page that lists the boards; the page of each is in the folder `boards` next to it."""

SEQUENCE_CELLS = (20, 20, 20)
"""The box of sequences, in cells."""

SEQUENCE_STEP_CM = 5.9
"""The length of a grid step of it, in cm."""

SEED = 0
"""The seed of all entries, so that nobody chooses the best of several."""

LIMITS = (1.0, 10.0, 60.0)
"""Limits of the mean processor seconds of a task; agents under the same limit are comparable."""

OVERSHOOT = 1.1
"""Factor on the limits: a search ends after the rollout in which its time is up."""

LEVELS = (0.7, 0.9, 1.0)
"""The x of Success@x."""

EXAMPLE = "largest-first/aligned/blbf"
"""The agent of the commands of the pages."""

PACKAGE = "packit-sim"
"""The package of agents for which a board records no other."""

HEAD = ("limit", "agent", "s per task", "Average Reward")
"""The first columns of every board."""

SUCCESSES = tuple(f"S@{x:g}" for x in LEVELS)
"""The columns after them."""

EXECUTED = ("loss", "collapses", "not held or no path", "largest penetration")
"""The same of boards on which an arm packs."""

TAIL = ("weights", "package", "results")
"""The last columns of every board."""

_SUFFIX = ".gz"


class Board(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """The tasks and rules of a leaderboard.

    Attributes
    ----------
    title : str
        The heading of its table.
    dataset : str
        The dataset of the tasks: the name of a built-in one, or a path.
    split : Split, optional
        The split of the dataset.
    first : int, optional
        If only the first tasks of the split count: their number.
    sequences : int, optional
        If the tasks are sequences for the online game: their number. They are drawn from the
        library of the dataset's name, by the defaults of `packit datasets sequences`.
    rules : Rules
        The rules, of those that `packit evaluate` has options for; with a robot cell, `packit
        execute`.
    packages : Mapping of str to str
        Where to get agents, by their names, if not from the base install of `packit-sim`: what
        `pip install` needs, with the version or commit, and the address of weights.
    """

    title: str
    dataset: str
    split: Split | None = None
    first: int | None = None
    sequences: int | None = None
    rules: Rules = PACKIT
    packages: Mapping[str, str] = {}

    @classmethod
    def read(cls, folder: Path) -> Board:
        """Read `board.json` in a folder.

        Parameters
        ----------
        folder : Path
            The folder.

        Returns
        -------
        Board
            The board.

        Raises
        ------
        ArgumentError
            If the file is not a board; the message names the file.
        """
        file = folder / "board.json"
        with located(f"{file} is not a leaderboard", ArgumentError):
            return typed_json.decode(file.read_bytes(), cls, ArgumentError)

    @cached_property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks, in the order of their numbers."""
        if self.sequences is None:
            return load_tasks(self.dataset, split=self.split)[: self.first]
        sampler = SequenceSampler(self.library, SEQUENCE_CELLS, SEQUENCE_STEP_CM)
        return tuple(sampler.pack(seed).task(self.library) for seed in range(self.sequences))

    @cached_property
    def library(self) -> ShapeLibrary:
        """The library of the shapes."""
        if self.sequences is None:
            return dataset_library(self.dataset, self.split)
        return ShapeLibrary.open(self.dataset)

    @property
    def preparation(self) -> str:
        """The command that draws the sequences; "" if there are none."""
        if self.sequences is None:
            return ""
        count = str(self.sequences)
        words = ["packit", "datasets", "sequences", "--library", self.dataset]
        return shlex.join([*words, "--sequences", count, "--out", self.dataset])

    def command(self, agent: str) -> str:
        """Return the command that plays the tasks, which `preparation` may have to write first.

        Parameters
        ----------
        agent : str
            The name of the agent.

        Returns
        -------
        str
            The command; its seed is `SEED`, the default.

        Raises
        ------
        ArgumentError
            If it has no options for these rules.
        """
        rules, cell = self.rules, self.rules.robot
        words = ["packit", "evaluate" if cell is None else "execute", self.dataset]
        words += ["--split", self.split] if self.split else []
        words += ["--tasks", str(self.first)] if self.first else []
        if cell is not None:
            method = cell.decomposition.method
            plain = RobotCell(
                cell.arm, level=cell.level, decomposition=DecompositionSettings(method=method)
            )
            rules = rules.changed(robot=None if cell == plain else cell)
            words += ["--arm", cell.arm, "--level", str(cell.level), "--decomposition", method]
        if rules.changed(cells=None, physics=None, robot=None) != rules:
            raise ArgumentError(f"`packit {words[1]}` has no options for the rules {self.rules}")
        words += ["--easy"] if rules.easy else []
        words += ["--kinematic"] if rules.kinematic else []
        words += ["--buffer", str(rules.buffer)] if rules.buffer else []
        words += ["--rotations", rules.rotations] if rules.rotations != "all" else []
        words += ["--values"] if rules.values else []
        words += ["--support", str(rules.support)] if rules.support else []
        words += ["--boxes", str(rules.boxes)] if rules.boxes > 1 else []
        return shlex.join([*words, "--agent", agent, "--out", "results.jsonl"])

    def check(self, path: Path, rollouts: Sequence[Rollout]) -> None:
        """Check that results are one run of one agent on all tasks of this board.

        Parameters
        ----------
        path : Path
            The file of the results, for messages.
        rollouts : Sequence[Rollout]
            The results, at least one.

        Raises
        ------
        ResultsError
            If they are not.
        """
        agents = list(dict.fromkeys(each.agent for each in rollouts))
        if len(agents) > 1:
            raise ResultsError(
                f"{path} contains results of {len(agents)} agents, {', '.join(agents)}: "
                "write those of each to a separate file"
            )
        weights = {agents[0]: (rollouts[0].weights,)}
        check_evaluation(path, rollouts, weights, dict(enumerate(self.tasks)), SEED, self.rules)
        if sorted(each.task for each in rollouts) != list(range(len(self.tasks))):
            raise ResultsError(
                f"{path} contains {len(rollouts)} results: the board {self.title!r} needs one of "
                f"each of its {len(self.tasks)} tasks"
            )
        if not all(each.seconds > 0 for each in rollouts):
            raise ResultsError(f"{path} does not record how long each task took")

    def problems(self, path: Path, executions: bool = True) -> list[str]:
        """Check results with the oracle, as `packit verify` does.

        Parameters
        ----------
        path : Path
            Their file, with its manifest, and the folder of an arm's trajectories.
        executions : bool, default: True
            Whether the trajectories are checked too: they are not kept.

        Returns
        -------
        list of str
            A sentence for each problem.
        """
        report = verify_dataset(path, self.library, executions=executions)
        not_judged = [report.not_judged] if report.unjudged_returns else []
        return [*map(str, report.problems), *not_judged]


@dataclass(frozen=True)
class Row:
    """An agent on a board.

    Attributes
    ----------
    file : Path
        Its compressed results file.
    score : Score
        Average Reward and Success@x.
    seconds : float
        The mean processor seconds of a task.
    weights : str or None
        The digest of its weights, for an agent that learned.
    package : str
        Where to get it.
    scores : Mapping of str to sequence of float
        The measures of an arm's executions, by name, of each task; empty without an arm.
    """

    file: Path
    score: Score
    seconds: float
    weights: str | None
    package: str
    scores: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def limit(self) -> float:
        """The smallest of the limits that it keeps; infinite if it keeps none."""
        return next((each for each in LIMITS if self.seconds <= each * OVERSHOOT), math.inf)

    @property
    def name_of_limit(self) -> str:
        """The limit as the tables have it."""
        return f"over {LIMITS[-1]:g} s" if math.isinf(self.limit) else f"{self.limit:g} s"

    def cells(self, page: Path) -> list[str]:
        """Return its row of the table on a page."""
        reward = format_estimate(self.score.reward, ".3f")
        link = Path(os.path.relpath(self.file, page.parent)).as_posix()
        return [
            self.name_of_limit,
            f"`{self.score.agent}`",
            f"{self.seconds:.2f}",
            reward,
            *(self.measured or (f"{self.score.success[x].mean:.1f}" for x in LEVELS)),
            f"`{self.weights}`" if self.weights else "",
            f"`{self.package}`",
            f"[file]({link})",
        ]

    @property
    def measured(self) -> list[str]:
        """The columns of `EXECUTED`, if an arm packed."""
        if not self.scores:
            return []
        planned, total = np.mean(self.scores["planned"]), self.score.reward.mean
        return [
            f"{planned - total:.4f}",
            f"{np.mean(self.scores['collapses']):.2f}",
            f"{np.mean(self.scores['failed grasps']) + np.mean(self.scores['no path']):.2f}",
            f"{1000 * max(self.scores['penetration']):.1f} mm",
        ]


def read_boards(folder: Path = BOARDS) -> dict[Path, Board]:
    """Read all boards, by their folders, in the order of names and of the numbers in them."""
    folders = sorted(
        (file.parent for file in folder.glob("*/board.json")),
        key=lambda each: [int(x) if x.isdigit() else x for x in re.split(r"(\d+)", each.name)],
    )
    return {each: Board.read(each) for each in folders}


def entries(folder: Path) -> list[Path]:
    """Find the compressed results files of a board."""
    return sorted(folder.glob(f"*.jsonl{_SUFFIX}"))


@contextmanager
def unpacked(file: Path) -> Iterator[Path]:
    """Unpack a results file into a temporary folder, with its manifest."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / file.stem
        path.write_bytes(gzip.decompress(file.read_bytes()))
        shutil.copy(manifest_path(file.with_suffix("")), manifest_path(path))
        yield path


def add(path: Path, folder: Path = BOARDS) -> Path:
    """Check a results file completely, and keep it on its board.

    Parameters
    ----------
    path : Path
        The file, as `packit evaluate --out` wrote it, next to its manifest.
    folder : Path
        The folder of the boards.

    Returns
    -------
    Path
        The compressed file.

    Raises
    ------
    ResultsError
        If no board has such tasks and rules, or the results are not an entry of it.
    """
    rollouts = read_results(path)
    own, board = _board_of(path, rollouts[0], read_boards(folder))
    board.check(path, rollouts)
    if found := board.problems(path):
        raise ResultsError(f"{found[0]} (problems: {len(found)}; `packit verify` reports all)")
    data = path.read_bytes()
    described = find_manifest(path, data)
    assert described is not None
    plain = own / (re.sub(r"[^A-Za-z0-9-]+", "-", rollouts[0].agent) + ".jsonl")
    kept = plain.with_name(plain.name + _SUFFIX)
    with replacing(kept) as file:
        file.write(gzip.compress(data, mtime=0))
    shutil.copy(described, manifest_path(plain))
    return kept


def _board_of(path: Path, first: Rollout, boards: Mapping[Path, Board]) -> tuple[Path, Board]:
    for folder, board in boards.items():
        digests = {task.digest for task in board.tasks}
        if first.rules == board.rules and first.task_digest in digests:
            return folder, board
    titles = ", ".join(repr(board.title) for board in boards.values())
    raise ResultsError(
        f"{path}: no leaderboard has task {first.task_digest} with the rules {first.rules}; "
        f"there are {titles or 'none'}"
    )


def rows(folder: Path, board: Board) -> list[Row]:
    """Compute the rows of a board: those with the lowest limit first, then the best first."""
    found = []
    for file in entries(folder):
        with unpacked(file) as path:
            rollouts = read_results(path)
        board.check(file, rollouts)
        agent, weights = rollouts[0].agent, rollouts[0].weights
        seconds = float(np.mean([each.seconds for each in rollouts]))
        package = board.packages.get(agent, PACKAGE)
        scores: dict[str, list[float]] = {}
        if board.rules.robot:
            scores = {name: [one.played.scores[name] for one in rollouts] for name in MEASURES}
        found.append(Row(file, Score.of(agent, rollouts), seconds, weights, package, scores))
    return sorted(found, key=lambda row: (row.limit, -row.score.reward.mean, row.score.agent))


def board_page(folder: Path, own: Path) -> Path:
    """Return the path of the page of a board, in the folder of the pages."""
    return folder / f"{own.name}.md"


def pages(folder: Path = BOARDS, page: Path = PAGE) -> dict[Path, str]:
    """Write the page of each board.

    Parameters
    ----------
    folder : Path
        The folder of the boards.
    page : Path
        The page that lists them.

    Returns
    -------
    dict of Path to str
        The text of each page, by its path.
    """
    found = {}
    for own, board in read_boards(folder).items():
        path = board_page(page.parent / "boards", own)
        split = f", split `{board.split}`" if board.split else ""
        only = "the first of " if board.first else ""
        drawn = "sequences drawn with the seeds from 0, " if board.sequences else ""
        commands = [board.preparation, board.command(EXAMPLE)]
        lines = "".join(f"$ {line}\n" for line in commands if line)
        found[path] = (
            f"# {board.title}\n\n"
            f"- **Tasks:** {len(board.tasks)}, {only}{drawn}`{board.dataset}`{split} "
            f"([datasets](../../reference/datasets.md))\n"
            f"- **Rules:** {board.rules} ([rules of the game](../../concepts/rules.md))\n"
            "- **Columns, limits, and how to submit:** [the leaderboard](../leaderboard.md)\n\n"
            f"With the name of your agent:\n\n```console\n{lines}```\n\n"
            + markdown_table(
                [*HEAD, *(EXECUTED if board.rules.robot else SUCCESSES), *TAIL],
                [row.cells(path) for row in rows(own, board)],
            )
        )
    return found


def markdown(folder: Path = BOARDS) -> str:
    """Write the list of the boards: for each the best agent under each limit that is kept."""
    cells = []
    for own, board in read_boards(folder).items():
        best = {row.limit: row for row in reversed(rows(own, board))}
        leaders = "; ".join(
            f"{row.name_of_limit}: `{row.score.agent}` {row.score.reward.mean:.3f}"
            for _, row in sorted(best.items())
        )
        count = len(entries(own))
        cells.append((f"[{board.title}](boards/{own.name}.md)", len(board.tasks), count, leaders))
    return markdown_table(("board", "tasks", "entries", "best Average Reward by limit"), cells)


def write(folder: Path = BOARDS, page: Path = PAGE) -> None:
    """Write all pages."""
    for path, text in pages(folder, page).items():
        replace_text(path, text)
    write_into_page(page, markdown(folder))


def verify(kept: Sequence[Path] | None = None, folder: Path = BOARDS) -> list[str]:
    """Check kept files: that each is an entry of its board, and with the oracle.

    Parameters
    ----------
    kept : Sequence of Path, optional
        Compressed results files; by default those of all boards.
    folder : Path
        The folder of the boards.

    Returns
    -------
    list of str
        A sentence for each problem.

    Raises
    ------
    ResultsError
        If a file can't be read, or is not an entry of its board.
    """
    boards = read_boards(folder)
    known = {file.resolve(): own for own in boards for file in entries(own)}
    found = []
    for file in known if kept is None else kept:
        if file.resolve() not in known:
            raise ResultsError(f"{file} is not kept on a board: it must be in a folder of {folder}")
        board = boards[known[file.resolve()]]
        with unpacked(file) as path:
            board.check(file, read_results(path))
            found += [f"{file}: {problem}" for problem in board.problems(path, executions=False)]
    return found


def main(folder: Path = BOARDS) -> None:
    """Add results, write the pages, and verify what is kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", nargs="*", type=Path, help="results files of `packit evaluate`")
    parser.add_argument("--verify", action="store_true", help="check kept files again")
    arguments = parser.parse_args()
    try:
        if arguments.verify:
            if found := verify(arguments.results or None, folder):
                raise SystemExit("\n".join(found))
            print("the kept files hold")
        else:
            for path in arguments.results:
                print(f"{path} holds: kept as {add(path, folder)}")
        write(folder)
    except PackItError as error:
        raise SystemExit(f"error: {error}") from None
    print(f"wrote {PAGE} and the pages of the boards")


if __name__ == "__main__":
    main()
