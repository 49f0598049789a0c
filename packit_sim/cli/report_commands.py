"""`packit report`: evaluations and trainings on one page."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli.options import DatasetLibraryOption, SplitOption
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import inputs, output
    from packit_sim.core import files
    from packit_sim.game.datasets import pack_files
    from packit_sim.game.reports import examples, page
    from packit_sim.game.reports import runs as report_runs
    from packit_sim.render import plots

SUFFIXES = (".html", ".htm")


def report_command(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Results files of `packit evaluate`, and folders of `packit train`."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="HTML file of the page.")],
    title: Annotated[str, typer.Option(help="Title of the page.")] = "Results of the agents",
    dataset: Annotated[
        str | None,
        typer.Option(help="Dataset that was played: to show its packs as well."),
    ] = None,
    split: SplitOption = None,
    agent: Annotated[
        str | None,
        typer.Option(
            help="Agent of the best and worst tasks; default: the one with the highest reward."
        ),
    ] = None,
    each: Annotated[
        int, typer.Option("--gallery", min=0, help="Number of best, and of worst, tasks to show.")
    ] = 3,
    library: DatasetLibraryOption = None,
) -> None:
    """Write a page about evaluations and trainings: tables, plots, tasks in 3D, settings.

    It shows the best and worst tasks. The page is one file that opens without a network.

    Example: packit report results.jsonl trainings/first --dataset starter --out report.html
    """
    if out.suffix.lower() not in SUFFIXES or out.is_dir():
        raise report_runs.ReportError(
            f"{out} is not an HTML file: choose a name that ends in .html"
        )
    plots.require()
    found = report_runs.Runs.read(runs)
    output.prepare_folder(out, *runs)
    shown = None
    if found.played:
        examples.chosen(found, agent)
        opened = packit_sim.ShapeLibrary.open(library) if library else None
        for run in found.played:
            inputs.check_shown(run.file, run.rollouts, opened)
    if found.played and each:
        refs = [one.pack.library for run in found.played for one in run.rollouts]
        opened = opened or pack_files.recorded_library(refs, runs[0])
        played = packit_sim.load_tasks(dataset, opened, split) if dataset else ()
        tasks = {task.digest: task for task in played}
        if tasks and not any(r.task_digest in tasks for one in found.played for r in one.rollouts):
            raise report_runs.ReportError(
                f"no task of these results belongs to the dataset {dataset}"
            )
        shown = examples.gallery(found, opened, each, agent, tasks)
    command = shlex.join(["packit", *sys.argv[1:]])
    text = page.page(title, found, shown, command)
    files.replace_text(out, text)
    size = len(text.encode()) / 1e6
    output.print_written(out, f" ({size:.1f} MB)")
