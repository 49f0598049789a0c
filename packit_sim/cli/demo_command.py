"""`packit demo`: evolve a pack, let agents pack its items, and draw the results."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli.options import SeedOption
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.game.datasets.evolution_settings import EvolutionSettings

with lazy_imports():
    from rich import table as rich_table

    from packit_sim.cli import evaluations, generation_progress, output, terminal
    from packit_sim.game.datasets import pack_checks

DEMO_SEED = 7
"""A seed whose pool contains few slender shapes, so that the box gets full."""

DEMO_SIZE = (0.65, 0.65)
"""The size factor: about 25 items fill a box, and a short evolution makes progress."""

PICTURE_SIDE = 512
"""Width and height of the pictures, in pixels."""

DRAWN = ("truth", "best", "worst")
"""The names of the pictures: the pack, and the results with the highest and the lowest return."""


def demo_command(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for packs, results and pictures.")
    ] = Path("demo"),
    seed: SeedOption = DEMO_SEED,
    generations: Annotated[
        int, typer.Option(min=0, help="Generations of the short evolution.")
    ] = 20,
) -> None:
    """Evolve a pack, let heuristic agents repack its items, and draw the results."""
    started = time.perf_counter()
    for name in ("packs.jsonl", "results.jsonl", *(f"{each}.png" for each in DRAWN)):
        output.prepare_folder(out / name)
    library = packit_sim.ShapeLibrary.open("everyday")
    terminal.console.print(
        f"Library [bold]{library.name}[/] {library.version}: {len(library)} shapes "
        f"in {len(library.categories)} categories"
    )
    settings = EvolutionSettings(generations=generations, size_range=DEMO_SIZE)
    pack = generation_progress.evolve_shown(library, seed, settings).best
    agents = [packit_sim.Agent.from_name(name) for name in evaluations.HEURISTICS]
    rollouts = evaluations.evaluate_shown(agents, [pack.task(library)], seed)
    problems = _verify([pack, *(rollout.pack for rollout in rollouts)], library)

    terminal.console.print(_rollout_table(pack, rollouts, problems))
    results = {"packs.jsonl": [pack], "results.jsonl": [rollout.pack for rollout in rollouts]}
    for name, packs in results.items():
        packit_sim.write_packs(out / name, packs)
        output.print_written(out / name)
    ranked = sorted(rollouts, key=lambda rollout: rollout.total)
    for name, shown in zip(DRAWN, (pack, ranked[-1].pack, ranked[0].pack), strict=True):
        renderer = _draw(shown, library, out / f"{name}.png")
        output.print_written(out / f"{name}.png")
    terminal.console.print(
        f"Pictures by the {renderer} renderer. Done in {time.perf_counter() - started:.0f} s."
    )
    if any(problems):
        raise typer.Exit(1)


def _verify(packs: Sequence[packit_sim.Pack], library: packit_sim.ShapeLibrary) -> list[list[str]]:
    """Return the problems of each pack."""
    with terminal.progress_bars() as progress:
        bar = progress.add_task("verifying", total=len(packs), note="")
        problems = []
        for pack in packs:
            problems.append(pack_checks.verify(pack, library))
            progress.advance(bar)
    return problems


def _draw(pack: packit_sim.Pack, library: packit_sim.ShapeLibrary, path: Path) -> str:
    """Draw a pack and return the renderer's name."""
    with packit_sim.Scene(pack.replay(library)) as scene:
        snapshot = scene.snapshot(PICTURE_SIDE, PICTURE_SIDE)
    snapshot.save(path)
    return snapshot.renderer


def _rollout_table(
    truth: packit_sim.Pack,
    rollouts: Sequence[packit_sim.Rollout],
    problems: Sequence[Sequence[str]],
) -> rich_table.Table:
    """Create a table of the ground truth, whose problems come first, and of each rollout."""
    table = output.simple_table("agent", "return", "items", "density", "oracle", "ended")

    def add(name: str, total: float, pack: packit_sim.Pack, found: Sequence[str], why: str) -> None:
        table.add_row(
            name,
            f"{total:.3f}",
            f"{len(pack.items)}/{len(truth.items)}",
            f"{pack.density:.3f}",
            "; ".join(found) or "valid",
            why,
        )

    add("[bold]ground truth[/]", 1.0, truth, problems[0], "evolved")
    played = zip(rollouts, problems[1:], strict=True)
    for rollout, found in sorted(played, key=lambda row: -row[0].total):
        add(rollout.agent, rollout.total, rollout.pack, found, str(rollout.end))
    table.caption = "one task, played once by each agent"
    return table
