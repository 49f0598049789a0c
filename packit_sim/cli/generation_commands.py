"""`packit generate`: evolves datasets, and shows how far it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import TaskID

from packit_sim.cli.console import (
    AddressOption,
    BackendOption,
    LibraryOption,
    SeedOption,
    WorkersOption,
    console,
    progress_bars,
)
from packit_sim.core.errors import PackItError
from packit_sim.core.parallel import Workers
from packit_sim.datasets.evolution_settings import EvolutionSettings, SearchName
from packit_sim.datasets.packs import WHOLE, Pack, read_packs
from packit_sim.datasets.provenance import Evolved
from packit_sim.generation import time_estimates
from packit_sim.generation.evolution import Evolution, Generation, evolve
from packit_sim.generation.jobs import GenerationJob, generate, under_way
from packit_sim.generation.time_estimates import TimeEstimate
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.splits import Split


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
    workers: WorkersOption = 0,
    backend: BackendOption = "loky",
    address: AddressOption = None,
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
    order = GenerationJob(
        opened.split(split) if split else opened, packs, seed, split, history, settings
    )
    file = out / f"{split or WHOLE}.jsonl"
    try:
        with (
            Workers(workers, backend, address) as hands,
            _shown(order, file, hands.count) as on_pack,
        ):
            made = generate(order, file, hands, on_pack)
    except KeyboardInterrupt:
        console.print("stopped: the same command goes on from here")
        raise typer.Exit(130) from None
    console.print(f"wrote {file}: {len(made)} packs")


def evolve_shown(library: ShapeLibrary, seed: int, settings: EvolutionSettings) -> Evolution:
    """As `evolve`, with a bar."""
    with progress_bars() as progress:
        bar = progress.add_task("evolving", total=settings.generations + 1, note="first generation")

        def show(generation: Generation) -> None:
            note = f"density {generation.best:.3f}, {len(generation.pack.items)} items"
            progress.update(bar, completed=generation.number + 1, note=note)

        evolution = evolve(library, seed, settings, show)
        progress.update(bar, total=len(evolution.densities))
    return evolution


@contextmanager
def _shown(order: GenerationJob, file: Path, workers: int) -> Iterator[Callable[[int, Pack], None]]:
    """Bars that follow a generation's checkpoints, the time left, a line for each finished pack."""
    done = _done(order, file)
    clock = time.monotonic
    expected = TimeEstimate(order.settings, order.packs, workers, clock(), under_way(file), done)
    over, lock = threading.Event(), threading.Lock()
    with progress_bars() as progress:
        whole = progress.add_task("packs", total=order.packs, completed=len(done), note="")
        bars: dict[int, TaskID] = {}

        def look() -> None:
            standing = under_way(file)
            with lock:
                for at in standing:
                    if expected.is_over(at.number):
                        continue
                    if at.number not in bars:
                        bars[at.number] = progress.add_task(
                            f"pack {at.number}", total=order.settings.generations + 1, note=""
                        )
                    note = f"density {at.density:.3f}"
                    progress.update(bars[at.number], completed=at.generation + 1, note=note)
                left = time_estimates.told(expected.seconds_left(standing, clock()))
                progress.update(whole, note=left)

        def follow() -> None:
            while not over.wait(1.0):
                look()

        def on_pack(number: int, pack: Pack) -> None:
            with lock:
                expected.finish(number, pack)
                if number in bars:
                    progress.remove_task(bars.pop(number))
            left = time_estimates.told(expected.seconds_left(under_way(file), clock()))
            progress.console.print(
                f"pack {number}: density {pack.density:.3f}, {len(pack.items)} items, "
                f"{_generation(pack)}" + (f"; {left}" if left else ""),
                highlight=False,
            )
            progress.update(whole, advance=1, note=left)

        thread = threading.Thread(target=follow, daemon=True)
        thread.start()
        try:
            yield on_pack
        finally:
            over.set()
            thread.join()


def _done(order: GenerationJob, file: Path) -> dict[int, Pack]:
    """The last pack of each evolution that is over, by number."""
    if not file.exists():
        return {}
    packs = read_packs(file, manifest=False)
    return {
        pack.provenance.seed - order.seed: pack
        for pack in packs
        if isinstance(pack.provenance, Evolved)
    }


def _generation(pack: Pack) -> str:
    assert isinstance(pack.provenance, Evolved)
    return f"generation {pack.provenance.generation}"
