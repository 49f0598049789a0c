"""`packit report`: runs on one page."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli.console import LibraryOption, SplitOption, console, make_room
from packit_sim.core.files import replace_text
from packit_sim.datasets.packs import load_tasks
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.reports import page
from packit_sim.reports.examples import chosen, gallery
from packit_sim.reports.runs import ReportError, Runs

SUFFIXES = (".html", ".htm")


def report_command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="Files that `packit evaluate --out` wrote, and folders of `packit train`."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The page, NAME.html.")],
    title: Annotated[str, typer.Option(help="Above all.")] = "What the agents reached",
    packs: Annotated[
        str | None,
        typer.Option(help="The dataset that was played: its packs are then shown as well."),
    ] = None,
    split: SplitOption = None,
    agent: Annotated[
        str | None,
        typer.Option(help="Whose best and worst tasks are shown; the one with the most reward."),
    ] = None,
    each: Annotated[
        int, typer.Option("--gallery", min=0, help="So many best tasks, and so many worst.")
    ] = 3,
    library: LibraryOption = "everyday",
) -> None:
    """Writes a page of runs: tables, plots, the best and worst tasks to be turned, settings.

    It is one file that opens from disk, without a network.
    """
    if out.suffix.lower() not in SUFFIXES or out.is_dir():
        raise ReportError(f"{out} is no page: choose the name of a file that ends in .html")
    page.check_installed()
    found = Runs.read(runs)
    make_room(out)
    shown = None
    if found.played and each:
        chosen(found, agent)
        opened = ShapeLibrary.open(library)
        tasks = {task.digest: task for task in load_tasks(packs, opened, split)} if packs else {}
        if tasks and not any(r.task_digest in tasks for one in found.played for r in one.rollouts):
            raise ReportError(f"none of the tasks in these results is of the packs {packs}")
        shown = gallery(found, opened, each, agent, tasks)
    command = shlex.join(["packit", *sys.argv[1:]])
    text = page.page(title, found, shown, command)
    replace_text(out, text)
    size = len(text.encode()) / 1e6
    console.print(f"wrote {out} ({size:.1f} MB)", soft_wrap=True)
