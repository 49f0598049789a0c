"""The command line: `packit`."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.logging import RichHandler
from rich.markup import escape
from rich.table import Table

from packit_sim.cli import pack_commands as packs_cli
from packit_sim.cli import shape_commands as shapes_cli
from packit_sim.cli.console import (
    LibraryOption,
    PacksArgument,
    SeedOption,
    SplitOption,
    console,
    make_room,
    progress_bars,
)
from packit_sim.cli.evaluation_commands import (
    HEURISTICS,
    compare_command,
    evaluate_command,
    evaluate_shown,
)
from packit_sim.cli.figure_commands import figures_command
from packit_sim.cli.generation_commands import evolve_shown, generate_command
from packit_sim.cli.physics_commands import compact_command, score_command
from packit_sim.cli.picture_commands import export_command, film_command, render_command
from packit_sim.cli.report_commands import report_command
from packit_sim.cli.reproduction_commands import reproduce_command
from packit_sim.cli.viewer_commands import view_command
from packit_sim.core.errors import PackItError
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.packings import verify_packing
from packit_sim.datasets.packs import (
    Pack,
    dataset_file,
    dataset_path,
    verify,
    write_packs,
)
from packit_sim.datasets.verification import verify_dataset
from packit_sim.evaluation.results import Rollout
from packit_sim.game.agents import Agent
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.scene import Scene

DEMO_SEED = 7
"""Of a pool with few slender things in it, so that the demo's box gets full."""

DEMO_SIZE = (0.65, 0.65)
"""The demo's size factor: about 25 items fill a box, and a short evolution gets somewhere."""

app = typer.Typer(no_args_is_help=True, add_completion=False)
app.add_typer(shapes_cli.app, name="shapes")
app.add_typer(packs_cli.app, name="packs")
app.command("generate")(generate_command)
app.command("evaluate")(evaluate_command)
app.command("compare")(compare_command)
app.command("reproduce")(reproduce_command)
app.command("report")(report_command)
app.command("view")(view_command)
app.command("render")(render_command)
app.command("film")(film_command)
app.command("export")(export_command)
app.command("figures")(figures_command)
app.command("compact")(compact_command)
app.command("score")(score_command)
for _command in entry_points(group="packit_sim.commands"):
    app.command(_command.name)(_command.load())


@app.callback()
def configure(
    verbose: Annotated[
        int,
        typer.Option(
            "--verbose", "-v", count=True, help="Log progress to stderr; twice: also details."
        ),
    ] = 0,
) -> None:
    """Pack real 3D shapes into a box, exactly."""
    if verbose:
        handler = RichHandler(console=Console(stderr=True), show_path=False)
        for name in ("packit_sim", "packit_agents"):
            logger = logging.getLogger(name)
            logger.setLevel(logging.INFO if verbose == 1 else logging.DEBUG)
            logger.handlers = [handler]


def main() -> None:
    """Run `packit`: a user's error is one line on stderr and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except (PackItError, OSError, typer.TyperException) as error:
        _print_error(_message(error))
        code = 2
    sys.exit(code)


def _message(error: PackItError | OSError | typer.TyperException) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return error.format_message() if isinstance(error, typer.TyperException) else str(error)


def _print_error(message: str) -> None:
    """Print a message as one line; none if it is empty, because the help was printed instead."""
    if line := " ".join(message.split("\n")).strip():
        text = f"[bold red]error:[/] {escape(line)}"
        Console(stderr=True).print(text, highlight=False, soft_wrap=True)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for what the demo makes.")] = Path("demo"),
    seed: SeedOption = DEMO_SEED,
    generations: Annotated[int, typer.Option(min=0, help="Of the short evolution.")] = 20,
) -> None:
    """Evolves a pack, takes it apart, lets the heuristic agents pack it again, and draws it."""
    started = time.perf_counter()
    make_room(out / "pack.jsonl")
    library = ShapeLibrary.open("everyday")
    console.print(
        f"Library [bold]{library.name}[/] {library.version}: {len(library)} shapes "
        f"in {len(library.categories)} categories"
    )
    settings = EvolutionSettings(generations=generations, size_range=DEMO_SIZE)
    pack = evolve_shown(library, seed, settings).best
    task = pack.task(library)
    agents = [Agent.from_name(name) for name in HEURISTICS]
    rollouts = evaluate_shown(agents, [task], seed)
    packs = [pack, *(rollout.pack for rollout in rollouts)]
    problems = _verify(packs, library)

    console.print(_rollout_table(pack, rollouts, problems))
    write_packs(out / "pack.jsonl", [pack])
    write_packs(out / "results.jsonl", [rollout.pack for rollout in rollouts])
    ranked = sorted(rollouts, key=lambda rollout: rollout.total)
    pictures = {"truth": pack, "best": ranked[-1].pack, "worst": ranked[0].pack}
    written = [out / "pack.jsonl", out / "results.jsonl"]
    for name, shown in pictures.items():
        renderer = _render(shown, library, out / f"{name}.png", 512)
        written.append(out / f"{name}.png")
    for path in written:
        console.print(f"wrote {path}")
    console.print(
        f"Pictures by the {renderer} renderer. Done in {time.perf_counter() - started:.0f} s."
    )
    if any(problems):
        raise typer.Exit(1)


@app.command("verify")
def verify_command(
    packs: PacksArgument, split: SplitOption = None, library: LibraryOption = "everyday"
) -> None:
    """Checks packs, all of a dataset or one split, against the oracle; exit code 1 if one is wrong.

    Also a packing that another tool made: a .json file of meshes and poses (see the README).
    """
    if packs.endswith(".json"):
        report = verify_packing(packs)
        verdict = f"density {report.density:.3f}, {len(report.problems)} problems"
    else:
        with progress_bars() as progress:
            bar = progress.add_task("verifying", total=None, note="")
            report = verify_dataset(
                dataset_file(packs, split) if split else dataset_path(packs),
                ShapeLibrary.open(library),
                lambda done, total: progress.update(bar, completed=done, total=total),
            )
        verdict = f"{report.packs - report.broken} of {report.packs} packs hold"
    for problem in report.problems:
        console.print(str(problem), highlight=False, soft_wrap=True, markup=False)
    console.print(verdict)
    if report.not_judged:
        console.print(report.not_judged, soft_wrap=True)
    if not report.holds:
        raise typer.Exit(1)


def _verify(packs: Sequence[Pack], library: ShapeLibrary) -> list[list[str]]:
    """The problems of each pack."""
    with progress_bars() as progress:
        bar = progress.add_task("verifying", total=len(packs), note="")
        problems = []
        for pack in packs:
            problems.append(verify(pack, library))
            progress.advance(bar)
    return problems


def _render(pack: Pack, library: ShapeLibrary, path: Path, size: int) -> str:
    """Draws a pack and returns the name of the renderer that did."""
    with Scene(pack.replay(library)) as scene:
        snapshot = scene.snapshot(size, size)
    snapshot.save(path)
    return snapshot.renderer


def _rollout_table(
    truth: Pack, rollouts: Sequence[Rollout], problems: Sequence[Sequence[str]]
) -> Table:
    """What each agent made of one task; the ground truth, whose problems come first, leads."""
    columns = ("agent", "return", "items", "density", "oracle", "ended")
    table = Table(*columns, box=SIMPLE_HEAD, show_edge=False, pad_edge=False)

    def add(name: str, total: float, pack: Pack, found: Sequence[str], why: str) -> None:
        table.add_row(
            name,
            f"{total:.3f}",
            f"{len(pack.items)}/{len(truth.items)}",
            f"{pack.density:.3f}",
            "; ".join(found) or "holds",
            why,
        )

    add("[bold]ground truth[/]", 1.0, truth, problems[0], "evolved")
    played = zip(rollouts, problems[1:], strict=True)
    for rollout, found in sorted(played, key=lambda row: -row[0].total):
        add(rollout.agent, rollout.total, rollout.pack, found, str(rollout.end))
    table.caption = "one task, played once by each agent"
    return table
