"""`packit reproduce`: the paper's tables and figures, one command each."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markdown import Markdown

from packit_sim.cli.console import (
    AddressOption,
    BackendOption,
    DatasetLibraryOption,
    SeedOption,
    WorkersOption,
    console,
    open_library,
    prepare_folder,
)
from packit_sim.cli.evaluation_commands import evaluate_shown, score_table, show_agents
from packit_sim.cli.output import RESUMABLE, stoppable
from packit_sim.core.errors import PackItError
from packit_sim.core.files import claimed, lock_path, replace_text
from packit_sim.core.parallel import Workers
from packit_sim.core.version import __version__
from packit_sim.game.datasets.pack_files import dataset_files, load_tasks, read_packs
from packit_sim.game.datasets.packs import LibraryRef, Task
from packit_sim.game.datasets.provenance import Evolved
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.results import Rollout
from packit_sim.game.paper import hardness, portfolio
from packit_sim.game.paper.reproduction import (
    HEURISTIC,
    TABLES,
    draw,
    markdown,
    reproduced,
    to_json,
)
from packit_sim.libraries.splits import Split
from packit_sim.render import plots
from packit_sim.rules import PACKIT, Rules

BENCHMARK = "everyday-v1"
"""The dataset of the benchmark."""

HISTORY = "everyday-v1-history"
"""The dataset of packs from the course of evolutions, for the figure."""

QUICK_TASKS = 20

QUICK_EVOLUTIONS = 4

EVOLUTION = "evolution"

PORTFOLIO = "portfolio"

ALL = "all"

CHOICES = (*TABLES, EVOLUTION, ALL, PORTFOLIO)
"""The tables and figures by name; `ALL` stands for those before it."""


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


def reproduce_command(
    what: Annotated[str, typer.Argument(help=f"What to reproduce: {', '.join(CHOICES)}.")] = ALL,
    dataset: Annotated[str, typer.Option(help="Dataset of the tables' tasks.")] = BENCHMARK,
    split: Annotated[
        Split | None, typer.Option(help="Split of the dataset; for the benchmark: test.")
    ] = None,
    history_dataset: Annotated[
        str,
        typer.Option(
            metavar="DATASET", help="Dataset of `packit generate --history`, for evolution."
        ),
    ] = HISTORY,
    library: DatasetLibraryOption = None,
    seed: SeedOption = 0,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help=f"Play only {QUICK_TASKS} tasks and {QUICK_EVOLUTIONS} evolutions, and search for "
            f"{portfolio.QUICK_SECONDS:g} s in the portfolio: takes minutes.",
        ),
    ] = False,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for tables, pictures and results.")
    ] = Path("reproduced"),
    workers: WorkersOption = 0,
    backend: BackendOption = "loky",
    address: AddressOption = None,
) -> None:
    """Reproduce a table or figure of the paper, and print our numbers next to the paper's.

    The portfolio is beyond the paper: returns of rules with searches over processor seconds.
    It takes over two hours of one core, and is not part of "all".

    The command can be stopped at any time: repeat it to resume.

    Example: packit reproduce table1 --quick
    """
    if what not in CHOICES:
        raise PackItError(f"there is no table or figure {what!r}: choose from {', '.join(CHOICES)}")
    plots.require()
    if dataset == BENCHMARK and split is None:
        split = "test"
    names = (*TABLES, EVOLUTION) if what == ALL else (what,)
    tables = [name for name in names if name in TABLES]
    with stoppable(RESUMABLE), _prepared(out), Workers(workers, backend, address) as processes:
        run = Run(library, seed, quick, out, processes)
        if tables:
            _tables(tables, dataset, split, run)
        if EVOLUTION in names:
            _evolution(history_dataset, run)
        if PORTFOLIO in names:
            _portfolio(dataset, split, run)


@contextmanager
def _prepared(out: Path) -> Iterator[None]:
    """Create the folder of the output, and keep other processes out of it."""
    prepare_folder(out / "results")
    with claimed(lock_path(out), out):
        yield


def _tables(names: Sequence[str], dataset: str, split: str | None, run: Run) -> None:
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


def _portfolio(dataset: str, split: str | None, run: Run) -> None:
    """Play the portfolio; the pairs that are not the best play the first tasks only."""
    library, tasks, source = _tasks(dataset, split, run)
    seconds = portfolio.QUICK_SECONDS if run.quick else portfolio.SECONDS
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


def _evolution(dataset: str, run: Run) -> None:
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
