"""Reproductions of the paper: what is played, printed and written for each table and figure."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.markdown import Markdown

from packit_sim.cli.evaluations import evaluate_shown, score_table, show_agents
from packit_sim.cli.inputs import open_library
from packit_sim.cli.output import prepare_folder
from packit_sim.cli.terminal import console
from packit_sim.core.files import claimed, lock_path, replace_text
from packit_sim.core.parallel import Workers
from packit_sim.core.version import __version__
from packit_sim.game.datasets.pack_files import dataset_files, load_tasks, read_packs
from packit_sim.game.datasets.packs import LibraryRef, Task
from packit_sim.game.datasets.provenance import Evolved
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.paper import hardness, portfolio
from packit_sim.game.paper.names import (
    EVOLUTION,
    HEURISTIC,
    PORTFOLIO,
    QUICK_EVOLUTIONS,
    QUICK_SECONDS,
    QUICK_TASKS,
)
from packit_sim.game.paper.reproduction import TABLES, draw, markdown, reproduced, to_json
from packit_sim.rules import PACKIT, Rules


@dataclass(frozen=True)
class Run:
    """The settings that all tables and figures of a reproduction share.

    Attributes
    ----------
    library : str or None
        The library of the tasks' shapes; None for the one that each dataset records.
    seed : int
        The seed of all evaluations.
    quick : bool
        Whether only a part of the tasks is played.
    out : Path
        The folder of the output.
    workers : Workers
        The processes that play.
    """

    library: str | None
    seed: int
    quick: bool
    out: Path
    workers: Workers

    def play(
        self, agents: Iterable[str], tasks: Sequence[Task], name: str, rules: Rules = PACKIT
    ) -> list[Rollout]:
        """Play tasks, or read the results if a file of this name has them."""
        return evaluate_shown(
            [Agent.from_name(agent) for agent in agents],
            tasks,
            self.seed,
            rules,
            workers=self.workers,
            file=self.out / f"{name}.jsonl",
        )

    def write(
        self, name: str, what: str, library: LibraryRef, text: str, content: Mapping[str, Any]
    ) -> None:
        """Write Markdown and JSON, with their provenance."""
        provenance = (
            f"{what}; seed {self.seed}; library {library.name} {library.version}; "
            f"PackIt-Sim {__version__}"
        )
        replace_text(self.out / f"{name}.md", f"{text}\n{provenance}.\n")
        whole = {"what": provenance, **content}
        replace_text(self.out / f"{name}.json", json.dumps(whole, indent=1) + "\n")
        console.print(f"wrote {self.out / name}.md, .json and .png", markup=False)


@contextmanager
def prepared(out: Path, names: Iterable[str]) -> Iterator[None]:
    """Create the folder of the outputs of these names, and keep other processes out of it."""
    for name in names:
        prepare_folder(out / f"{name}.json", field="what")
        prepare_folder(out / f"{name}.png")
    with claimed(lock_path(out), out):
        yield


def write_tables(names: Sequence[str], dataset: str, split: str | None, run: Run) -> None:
    """Reproduce tables; those with the same rules share their agents' rollouts."""
    library, tasks, source = _tasks(dataset, split, run)
    played = {}
    for rules in dict.fromkeys(TABLES[name].rules for name in names):
        together = [TABLES[name] for name in names if TABLES[name].rules == rules]
        agents = dict.fromkeys(row.agent for table in together for row in table.playable)
        played[rules] = run.play(agents, tasks, "easy" if rules.easy else "packit", rules)
    for name in names:
        table = TABLES[name]
        found = reproduced(table, played[table.rules])
        console.print(f"\n[bold]{table.title}[/]")
        show_agents(each.row.agent for each in found)
        console.print(score_table([each.score for each in found]))
        missing = [row.agent for row in table.rows if row not in table.playable]
        note = f"; not installed, so not played: {', '.join(missing)}" if missing else ""
        draw(table, found, run.out / f"{name}.png")
        run.write(name, source + note, library, markdown(table, found), to_json(table, found))


def write_portfolio(dataset: str, split: str | None, run: Run) -> None:
    """Play the portfolio; the pairs that are not the best play the first tasks only."""
    library, tasks, source = _tasks(dataset, split, run)
    seconds = QUICK_SECONDS if run.quick else portfolio.SECONDS
    alone = portfolio.rules()
    best = portfolio.agents((*portfolio.LEARNED, *portfolio.BEST), seconds)
    others = portfolio.agents(portfolio.OTHERS, seconds)
    rollouts = run.play((*alone, *best), tasks, PORTFOLIO)
    rollouts += run.play(others, tasks[: portfolio.FIRST_TASKS], PORTFOLIO)
    played = {
        name: [each for each in rollouts if each.agent == name] for name in (*alone, *best, *others)
    }
    found = portfolio.rows(played, seconds)
    text = portfolio.markdown(found, seconds)
    console.print(Markdown(text))
    portfolio.draw(played, seconds, run.out / f"{PORTFOLIO}.png")
    run.write(PORTFOLIO, source, library, text, portfolio.to_json(found, seconds))


def _tasks(dataset: str, split: str | None, run: Run) -> tuple[LibraryRef, list[Task], str]:
    """Load tasks; also return their library and their description."""
    opened = open_library(run.library, dataset, split)
    tasks = list(load_tasks(dataset, opened, split)[: QUICK_TASKS if run.quick else None])
    source = f"{dataset}{f', {split}' if split else ''}: {len(tasks)} tasks"
    return LibraryRef.of(opened), tasks, source


def write_evolution(dataset: str, run: Run) -> None:
    """Play the packs of evolutions, and draw how hard they are."""
    file = dataset_files(dataset)[0]
    evolutions = hardness.by_evolution(read_packs(file), file)
    if run.quick:
        evolutions = dict(list(evolutions.items())[:QUICK_EVOLUTIONS])
    packs, at = hardness.distinct(evolutions)
    opened = open_library(run.library, dataset)
    rollouts = run.play([HEURISTIC], [pack.task(opened) for pack in packs], EVOLUTION)
    points = hardness.curve(evolutions, {key: rollouts[n].total for key, n in at.items()})
    title = f"The Heuristic on the packs of {len(evolutions)} evolutions"
    text = hardness.markdown(points)
    console.print(f"\n[bold]{title}[/]", Markdown(text))
    hardness.draw(points, title, run.out / f"{EVOLUTION}.png")
    evolved = packs[0].provenance
    settings = evolved.settings.to_json() if isinstance(evolved, Evolved) else None
    content = {"settings": settings, "points": [asdict(point) for point in points]}
    source = f"{dataset}: {len(evolutions)} evolutions"
    run.write(EVOLUTION, source, LibraryRef.of(opened), f"# {title}\n\n{text}", content)
