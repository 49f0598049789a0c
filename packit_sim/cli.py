"""The command line: `packit`."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import TaskID
from rich.table import Table

from packit_sim import shapes_cli
from packit_sim.chromosomes import EvolutionSettings, SearchName
from packit_sim.console import LibraryOption, SeedOption, console, make_room, progress_bars
from packit_sim.errors import PackItError
from packit_sim.evaluation import SUCCESS_LEVELS, Estimate, Rollout, Score, evaluate
from packit_sim.evolution import Evolution, Generation, evolve
from packit_sim.generation import Order, generate, under_way
from packit_sim.library import ShapeLibrary
from packit_sim.packings import verify_packing
from packit_sim.packs import (
    STARTER_PACKS,
    WHOLE,
    Pack,
    Task,
    dataset_file,
    dataset_path,
    load_tasks,
    read_packs,
    verify,
    write_packs,
)
from packit_sim.parallel import BackendName, Workers
from packit_sim.policies import Agent
from packit_sim.rendering import MAX_SIDE
from packit_sim.scene import Scene
from packit_sim.splits import Split
from packit_sim.verification import verify_dataset

HEURISTICS = tuple(
    "/".join(parts)
    for parts in itertools.product(
        ("random", "largest-first"), ("random", "aligned"), ("random", "blbf")
    )
)
"""Every combination of the paper's heuristics."""

DEMO_SEED = 7
"""Of a pool with few slender things in it, so that the demo's box gets full."""

DEMO_SIZE = (0.65, 0.65)
"""The demo's size factor: about 25 items fill a box, and a short evolution gets somewhere."""

app = typer.Typer(
    help="Pack real 3D shapes into a box, exactly.", no_args_is_help=True, add_completion=False
)
app.add_typer(shapes_cli.app, name="shapes")

PacksArgument = Annotated[
    str, typer.Argument(help="Packs: a dataset's name, such as starter, its folder or its file.")
]
SplitOption = Annotated[Split | None, typer.Option(help="Which of the dataset's splits.")]


def main() -> None:
    """Runs `packit`; a user's error is one line on stderr and exit code 2."""
    try:
        app()
    except (PackItError, OSError) as error:
        message = f"[bold red]error:[/] {escape(str(error))}"
        Console(stderr=True).print(message, highlight=False, soft_wrap=True)
        sys.exit(2)


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
    pack = _evolve(library, seed, settings, "evolving").best
    task = pack.task(library)
    agents = [Agent.from_name(name) for name in HEURISTICS]
    rollouts = _evaluate(agents, [task], seed)
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


@app.command("generate")
def generate_command(
    out: Annotated[Path, typer.Option("--out", help="The dataset's folder.")],
    packs: Annotated[int, typer.Option(min=1, help="How many, in all.")] = 1,
    split: Annotated[
        Split | None, typer.Option(help="Of the library; the dataset's file is named after it.")
    ] = None,
    seed: SeedOption = 0,
    library: LibraryOption = "everyday",
    pool: Annotated[int, typer.Option(min=1, help="Shapes drawn a pack.")] = 50,
    population: Annotated[int, typer.Option(help="Chromosomes a generation.")] = 100,
    generations: Annotated[int, typer.Option(min=0, help="At most, a pack.")] = 1000,
    patience: Annotated[
        int, typer.Option(min=1, help="Stop after so many generations without improvement.")
    ] = 100,
    size: Annotated[
        tuple[float, float], typer.Option(help="Range of a pack's linear size factor.")
    ] = (0.75, 1.0),
    search: Annotated[SearchName, typer.Option(help="The paper's is generational.")] = (
        "generational"
    ),
    history: Annotated[
        bool,
        typer.Option("--history", help="Also the best packs on the way, each 50 generations."),
    ] = False,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0 for one a core.")] = 0,
    backend: Annotated[BackendName, typer.Option(help="Where the workers are.")] = "loky",
    address: Annotated[str | None, typer.Option(help="Of the Ray cluster's head.")] = None,
) -> None:
    """Evolves packs. Pack n has the seed SEED + n, so that any one can be made again.

    Stop it at any moment: the same command goes on, and ends in the same packs.
    """
    opened = ShapeLibrary.open(library)
    try:
        settings = EvolutionSettings(
            pool=pool,
            population=population,
            generations=generations,
            patience=patience,
            size_range=size,
            search=search,
        )
    except ValueError as error:
        raise PackItError(str(error)) from None
    order = Order(opened.split(split) if split else opened, packs, seed, split, history, settings)
    file = out / f"{split or WHOLE}.jsonl"
    try:
        with Workers(workers, backend, address) as hands, _generation_shown(order, file) as shown:
            made = generate(order, file, hands, shown)
    except KeyboardInterrupt:
        console.print("stopped: the same command goes on from here")
        raise typer.Exit(130) from None
    console.print(f"wrote {file}: {len(made)} packs")


@contextmanager
def _generation_shown(order: Order, file: Path) -> Iterator[Callable[[int, Pack], None]]:
    """Bars of a generation, which follow its checkpoints, and a line for each finished pack."""
    over = threading.Event()
    with progress_bars() as progress:
        whole = progress.add_task("packs", total=order.packs, note="")
        bars: dict[int, TaskID] = {}

        def follow() -> None:
            while not over.wait(1.0):
                for at in under_way(file):
                    if at.number not in bars:
                        bars[at.number] = progress.add_task(
                            f"pack {at.number}", total=order.settings.generations + 1, note=""
                        )
                    note = f"density {at.density:.3f}"
                    progress.update(bars[at.number], completed=at.generation + 1, note=note)

        def on_pack(number: int, pack: Pack) -> None:
            if number in bars:
                progress.remove_task(bars.pop(number))
            progress.console.print(
                f"pack {number}: density {pack.density:.3f}, {len(pack.items)} items, "
                f"generation {pack.made['generation']}",
                highlight=False,
            )
            progress.update(whole, advance=1)

        if file.exists():
            done = {pack.made.get("seed") for pack in read_packs(file, manifest=False)}
            progress.update(whole, completed=len(done))
        thread = threading.Thread(target=follow, daemon=True)
        thread.start()
        try:
            yield on_pack
        finally:
            over.set()
            thread.join()


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
    if not report.holds:
        raise typer.Exit(1)


@app.command("evaluate")
def evaluate_command(
    packs: PacksArgument = STARTER_PACKS,
    split: SplitOption = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(help="shape/rotation/location; may be given more than once."),
    ] = None,
    seed: SeedOption = 0,
    library: LibraryOption = "everyday",
    out: Annotated[Path | None, typer.Option(help="Write what the agents packed.")] = None,
) -> None:
    """Lets agents play the tasks of a dataset and prints the paper's table."""
    opened = ShapeLibrary.open(library)
    agents = [Agent.from_name(name) for name in dict.fromkeys(agent or HEURISTICS)]
    tasks = load_tasks(packs, opened, split)
    if out is not None:
        make_room(out)
    rollouts = _evaluate(agents, tasks, seed)
    levels = (f"S@{x:g}" for x in SUCCESS_LEVELS)
    table = Table("agent", "reward", *levels, box=SIMPLE_HEAD, show_edge=False, padding=(0, 1))
    for name in (a.name for a in agents):
        score = Score.of(name, rollouts)
        table.add_row(
            name.replace("/", "/\n", 1),
            _interval(score.reward, ".3f", ".2f"),
            *(_interval(estimate, ".1f", ".0f") for estimate in score.success.values()),
        )
    table.caption = f"tasks: {len(tasks)}, seed: {seed}; below each mean its 95% bootstrap interval"
    console.print(table)
    if out is not None:
        write_packs(out, [rollout.pack for rollout in rollouts])
        console.print(f"wrote {out}")


@app.command()
def render(
    packs: PacksArgument,
    out: Annotated[Path, typer.Option("--out", help="The PNG to write.")],
    split: SplitOption = None,
    pack: Annotated[int, typer.Option(min=0, help="Which pack of the dataset.")] = 0,
    size: Annotated[int, typer.Option(min=16, max=MAX_SIDE, help="Pixels an edge.")] = 512,
    library: LibraryOption = "everyday",
) -> None:
    """Draws a pack."""
    opened = ShapeLibrary.open(library)
    read = read_packs(dataset_file(packs, split))
    if pack >= len(read):
        raise PackItError(f"{packs} has no pack {pack}: choose 0 to {len(read) - 1}")
    make_room(out)
    renderer = _render(read[pack], opened, out, size)
    console.print(f"wrote {out} by the {renderer} renderer")


def _evolve(library: ShapeLibrary, seed: int, settings: EvolutionSettings, label: str) -> Evolution:
    with progress_bars() as progress:
        bar = progress.add_task(label, total=settings.generations + 1, note="first generation")

        def show(generation: Generation) -> None:
            note = f"density {generation.best:.3f}, {len(generation.pack.items)} items"
            progress.update(bar, completed=generation.number + 1, note=note)

        evolution = evolve(library, seed, settings, show)
        progress.update(bar, total=len(evolution.densities))
    return evolution


def _evaluate(agents: Sequence[Agent], tasks: Sequence[Task], seed: int) -> list[Rollout]:
    with progress_bars() as progress:
        bar = progress.add_task("playing", total=len(agents) * len(tasks), note="")
        return evaluate(
            agents, tasks, seed, lambda rollout: progress.update(bar, advance=1, note=rollout.agent)
        )


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


def _interval(estimate: Estimate, mean_spec: str, spec: str) -> str:
    mean = format(estimate.mean, mean_spec)
    if estimate.low is None or estimate.high is None:
        return mean
    return f"{mean}\n[dim]{format(estimate.low, spec)}-{format(estimate.high, spec)}[/]"
