"""Progress of evolutions and densifications."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.markup import escape
from rich.progress import TaskID

from packit_sim.cli.library_import import print_shells
from packit_sim.cli.terminal import console, progress_bars
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Densified, Evolved
from packit_sim.game.generation import time_estimates
from packit_sim.game.generation.evolution import Evolution, Generation, evolve
from packit_sim.game.generation.jobs import GenerationJob, under_way
from packit_sim.game.generation.time_estimates import TimeEstimate
from packit_sim.libraries.folder import MeshFolder
from packit_sim.libraries.library import ShapeLibrary


def readable_library(library: ShapeLibrary) -> ShapeLibrary:
    """Leave out the mesh files of a folder that can't be used, and print their names."""
    if not isinstance(library.source, MeshFolder):
        return library
    console.print(
        f"Shapes of {library.path} are drawn with replacement and rescaled: the packs are tasks of "
        "a benchmark, not a packing of these files in their real sizes.",
        soft_wrap=True,
        markup=False,
    )
    with progress_bars() as progress:
        bar = progress.add_task("reading meshes", total=len(library), note="")
        readable = library.readable(lambda id: progress.update(bar, advance=1, note=escape(id)))
        progress.update(bar, note="")
    skipped = {id: why for id, why in readable.missing.items() if id in library}
    for why in skipped.values():
        console.print(f"skipped {why}", style="yellow", markup=False, soft_wrap=True)
    if skipped:
        console.print(f"{len(readable)} of {len(library)} shapes can be used")
    print_shells(id for id in readable if readable[id].is_shell)
    return readable


def evolve_shown(library: ShapeLibrary, seed: int, settings: EvolutionSettings) -> Evolution:
    """Evolve a pack as `evolve` does, with a progress bar."""
    with progress_bars() as progress:
        bar = progress.add_task("evolving", total=settings.generations + 1, note="first generation")

        def show(generation: Generation) -> None:
            note = f"density {generation.best:.3f}, {len(generation.pack.items)} items"
            progress.update(bar, completed=generation.number + 1, note=note)

        evolution = evolve(library, seed, settings, show)
        progress.update(bar, total=len(evolution.densities))
    return evolution


@contextmanager
def shown(order: GenerationJob, file: Path, workers: int) -> Iterator[Callable[[int, Pack], None]]:
    """Show the progress from checkpoints, the time left, and a line for each finished pack."""
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
                            f"pack {at.number}", total=order.settings.steps, note=""
                        )
                    note = f"density {at.density:.3f}"
                    progress.update(bars[at.number], completed=at.generation + 1, note=note)
                left = time_estimates.format_remaining(expected.seconds_left(standing, clock()))
                progress.update(whole, note=left)

        def follow() -> None:
            while not over.wait(1.0):
                look()

        def on_pack(number: int, pack: Pack) -> None:
            with lock:
                expected.finish(number, pack)
                if number in bars:
                    progress.remove_task(bars.pop(number))
            left = time_estimates.format_remaining(expected.seconds_left(under_way(file), clock()))
            progress.console.print(
                f"pack {number}: density {pack.density:.3f}, {len(pack.items)} items, "
                f"{_effort(pack)}" + (f"; {left}" if left else ""),
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
    """Return the last pack of each finished search by number."""
    if not file.exists():
        return {}
    packs = read_packs(file)
    return {
        pack.provenance.seed - order.seed: pack
        for pack in packs
        if isinstance(pack.provenance, Evolved | Densified)
    }


def _effort(pack: Pack) -> str:
    if isinstance(pack.provenance, Densified):
        return f"{pack.provenance.rounds} rounds"
    assert isinstance(pack.provenance, Evolved)
    return f"generation {pack.provenance.generation}"
