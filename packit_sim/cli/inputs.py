"""Inputs of commands: the library, results that are checked, convex pieces of shapes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from packit_sim.cli.terminal import console, progress_bars
from packit_sim.core.errors import LibraryError
from packit_sim.game.datasets.pack_files import dataset_library, recorded_library
from packit_sim.game.evaluation.results import Rollout, check_results
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.convex.decomposition import Decomposition, decompose_all, is_cached
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.world import require_engine


def open_library(library: str | None, dataset: str, split: str | None = None) -> ShapeLibrary:
    """Open the library that was chosen, or else the one that a dataset records."""
    return ShapeLibrary.open(library) if library else dataset_library(dataset, split)


def check_shown(
    file: Path, rollouts: Sequence[Rollout], library: ShapeLibrary | None = None
) -> None:
    """Check results as `check_results` does, and print how many returns could not be checked.

    Parameters
    ----------
    file : Path
        The file of the results.
    rollouts : Sequence[Rollout]
        The results.
    library : ShapeLibrary | None
        Their library; by default the recorded one, if it can be opened.
    """
    why = "the items of their tasks are not recorded"
    if library is None:
        try:
            library = recorded_library((rollout.pack.library for rollout in rollouts), file)
        except LibraryError as error:
            why = str(error)
    if unchecked := check_results(file, rollouts, library):
        note = f"{file}: {unchecked} of {len(rollouts)} returns are not checked: {why}"
        console.print(note, style="yellow", markup=False, soft_wrap=True)


def decompose_shown(
    shapes: Sequence[Shape],
    settings: DecompositionSettings | None = None,
    workers: int | None = None,
) -> int:
    """Decompose the shapes that are in no cache yet for a simulation, with a progress bar.

    Returns
    -------
    int
        The number of shapes that were decomposed.
    """
    require_engine()
    missing = [
        shape
        for shape in {shape.digest: shape for shape in shapes}.values()
        if not is_cached(shape, settings)
    ]
    if not missing:
        return 0
    with progress_bars() as progress:
        bar = progress.add_task("decomposing", total=len(missing), note="shapes, once")

        def show(shape: Shape, found: Decomposition) -> None:
            progress.update(bar, advance=1, note=f"{shape.id}: {len(found.pieces)} convex pieces")

        decompose_all(missing, settings, workers or None, show)
        progress.update(bar, note="")
    return len(missing)
