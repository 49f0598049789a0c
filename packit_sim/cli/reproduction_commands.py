"""`packit reproduce`: the paper's tables and figures by one command each."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markdown import Markdown

from packit_sim._version import __version__
from packit_sim.cli.console import (
    AddressOption,
    BackendOption,
    LibraryOption,
    SeedOption,
    WorkersOption,
    console,
    make_room,
)
from packit_sim.cli.evaluation_commands import evaluate_shown, score_table, show_agents
from packit_sim.core.errors import PackItError
from packit_sim.core.files import replace_text
from packit_sim.core.parallel import Workers
from packit_sim.datasets import statistics
from packit_sim.datasets.packs import Task, load_tasks, read_packs
from packit_sim.datasets.provenance import Evolved
from packit_sim.evaluation.results import Rollout
from packit_sim.game.agents import Agent
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.splits import Split
from packit_sim.paper import hardness
from packit_sim.paper.reproduction import HEURISTIC, TABLES, draw, markdown, reproduced, to_json
from packit_sim.render import plots
from packit_sim.rules import PACKIT, Rules

BENCHMARK = "everyday-v1"
"""The dataset of the benchmark."""

HISTORY = "everyday-v1-history"
"""The packs that evolutions kept on their way, for the figure."""

QUICK_TASKS = 20

QUICK_EVOLUTIONS = 4

EVOLUTION = "evolution"

ALL = "all"

CHOICES = (*TABLES, EVOLUTION, ALL)


@dataclass(frozen=True)
class Run:
    """What is common to all that is reproduced. out: folder for it. quick: a part of it only."""

    library: ShapeLibrary
    seed: int
    quick: bool
    out: Path
    workers: Workers

    def play(
        self, agents: Iterable[str], tasks: Sequence[Task], name: str, rules: Rules = PACKIT
    ) -> list[Rollout]:
        """The rollouts, which are kept in a file of this name."""
        return evaluate_shown(
            [Agent.from_name(agent) for agent in agents],
            tasks,
            self.seed,
            rules,
            workers=self.workers,
            file=self.out / f"{name}.jsonl",
        )

    def write(self, name: str, what: str, text: str, content: Mapping[str, Any]) -> None:
        """Markdown and JSON, with how they came to be."""
        made = (
            f"{what}; seed {self.seed}; library {self.library.name} {self.library.version}; "
            f"PackIt-Sim {__version__}"
        )
        replace_text(self.out / f"{name}.md", f"{text}\n{made}.\n")
        whole = {"what": made, **content}
        replace_text(self.out / f"{name}.json", json.dumps(whole, indent=1) + "\n")
        console.print(f"wrote {self.out / name}.md, .json and .png")


def reproduce_command(
    what: Annotated[str, typer.Argument(help=f"{', '.join(CHOICES)}.")] = ALL,
    packs: Annotated[str, typer.Option(help="Dataset of the tables' tasks.")] = BENCHMARK,
    split: Annotated[
        Split | None, typer.Option(help="Of the dataset; of the benchmark, test.")
    ] = None,
    history: Annotated[
        str, typer.Option(help="Dataset of evolution, made by packit generate --history.")
    ] = HISTORY,
    library: LibraryOption = "everyday",
    seed: SeedOption = 0,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help=f"Only the first {QUICK_TASKS} tasks, {QUICK_EVOLUTIONS} evolutions: minutes.",
        ),
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder for tables, pictures and results.")] = Path(
        "reproduced"
    ),
    workers: WorkersOption = 0,
    backend: BackendOption = "loky",
    address: AddressOption = None,
) -> None:
    """Plays what a table or figure of the paper shows, and sets our numbers beside the paper's.

    Stop it at any moment: the same command goes on.
    """
    if what not in CHOICES:
        raise PackItError(f"there is no {what!r}: choose from {', '.join(CHOICES)}")
    plots.require()
    if packs == BENCHMARK and split is None:
        split = "test"
    names = (*TABLES, EVOLUTION) if what == ALL else (what,)
    tables = [name for name in names if name != EVOLUTION]
    make_room(out / "results")
    try:
        with Workers(workers, backend, address) as hands:
            run = Run(ShapeLibrary.open(library), seed, quick, out, hands)
            if tables:
                _tables(tables, packs, split, run)
            if EVOLUTION in names:
                _evolution(history, run)
    except KeyboardInterrupt:
        console.print("stopped: the same command goes on from here")
        raise typer.Exit(130) from None


def _tables(names: Sequence[str], packs: str, split: str | None, run: Run) -> None:
    """All agents of tables with the same rules are played together: some are in several."""
    tasks = load_tasks(packs, run.library, split)[: QUICK_TASKS if run.quick else None]
    source = f"{packs}{f', {split}' if split else ''}: {len(tasks)} tasks"
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
        run.write(name, source + note, markdown(table, found), to_json(table, found))


def _evolution(dataset: str, run: Run) -> None:
    file = statistics.dataset_files(dataset)[0]
    evolutions = hardness.kept(read_packs(file), file)
    if run.quick:
        evolutions = dict(list(evolutions.items())[:QUICK_EVOLUTIONS])
    packs, at = hardness.different(evolutions)
    rollouts = run.play([HEURISTIC], [pack.task(run.library) for pack in packs], EVOLUTION)
    points = hardness.curve(evolutions, {key: rollouts[n].total for key, n in at.items()})
    title = f"The Heuristic on the packs of {len(evolutions)} evolutions"
    text = hardness.markdown(points)
    console.print(f"\n[bold]{title}[/]", Markdown(text))
    hardness.draw(points, title, run.out / f"{EVOLUTION}.png")
    evolved = packs[0].provenance
    settings = evolved.settings.to_json() if isinstance(evolved, Evolved) else None
    content = {"settings": settings, "points": [asdict(point) for point in points]}
    source = f"{dataset}: {len(evolutions)} evolutions"
    run.write(EVOLUTION, source, f"## {title}\n\n{text}", content)
