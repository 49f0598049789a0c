"""The command line: `packit`."""

from __future__ import annotations

import logging
import sys
from importlib.metadata import entry_points
from typing import Annotated, Any

import typer
from rich.logging import RichHandler
from rich.markup import escape
from typer.core import TyperGroup

from packit_sim.cli import agent_commands, dataset_commands, shape_commands
from packit_sim.cli.console import PlainConsole, console
from packit_sim.cli.demo_command import demo_command
from packit_sim.cli.doctor_command import doctor_command
from packit_sim.cli.evaluation_commands import compare_command, evaluate_command
from packit_sim.cli.figure_commands import figures_command
from packit_sim.cli.generation_commands import generate_command
from packit_sim.cli.help import document
from packit_sim.cli.nest_command import nest_command
from packit_sim.cli.output import stoppable
from packit_sim.cli.pack_command import pack_command
from packit_sim.cli.physics_commands import compact_command, prepare_command, score_command
from packit_sim.cli.picture_commands import export_command, film_command, render_command
from packit_sim.cli.report_commands import report_command
from packit_sim.cli.reproduction_commands import reproduce_command
from packit_sim.cli.selftest_command import selftest_command
from packit_sim.cli.verify_command import verify_command
from packit_sim.cli.viewer_commands import view_command, workbench_command
from packit_sim.core.errors import PackItError, message
from packit_sim.core.signals import as_interrupts, end_at_once
from packit_sim.core.version import DOCUMENTATION, __version__

LOGGERS = ("packit_sim", "packit_agents")

PACK, PLAY, BENCHMARK, LEARN, LOOK = "Pack", "Play", "Benchmark", "Learn", "Look"
INSTALLATION = "Installation"

COMMANDS: dict[str, tuple[str, ...]] = {
    PACK: ("pack", "workbench", "nest"),
    PLAY: ("demo", "agents", "datasets", "evaluate", "compare"),
    BENCHMARK: (
        "shapes",
        "generate",
        "prepare",
        "verify",
        "compact",
        "score",
        "reproduce",
        "report",
    ),
    LEARN: ("train", "train-champion"),
    LOOK: ("view", "render", "film", "export", "figures"),
    INSTALLATION: ("doctor", "selftest"),
}
"""The commands in the order of use, by their panels in `--help`; those of others follow."""


class Commands(TyperGroup):
    """The commands, in the order of `COMMANDS`; Ctrl-C ends each with a line."""

    def list_commands(self, ctx: Any) -> list[str]:
        known = [name for names in COMMANDS.values() for name in names if name in self.commands]
        return known + sorted(self.commands.keys() - set(known))

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        with stoppable("nothing is begun"):  # typer itself would end without a word
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        with stoppable("the command is not finished"):
            return super().invoke(ctx)


app = typer.Typer(cls=Commands, no_args_is_help=True, add_completion=False)


def _panel(name: str) -> str:
    panels = (panel for panel, names in COMMANDS.items() if name in names)
    return next(panels, "Of other packages")


for _name, _group in (
    ("agents", agent_commands.app),
    ("datasets", dataset_commands.app),
    ("shapes", shape_commands.app),
):
    app.add_typer(_group, name=_name, rich_help_panel=_panel(_name))
for _function in (
    demo_command,
    pack_command,
    workbench_command,
    nest_command,
    verify_command,
    selftest_command,
    generate_command,
    evaluate_command,
    compare_command,
    reproduce_command,
    report_command,
    view_command,
    render_command,
    film_command,
    export_command,
    figures_command,
    prepare_command,
    compact_command,
    score_command,
    doctor_command,
):
    _name = _function.__name__.removesuffix("_command")
    app.command(_name, rich_help_panel=_panel(_name))(_function)
for _command in entry_points(group="packit_sim.commands"):
    app.command(_command.name, rich_help_panel=_panel(_command.name))(_command.load())


for _typer in (app, agent_commands.app, dataset_commands.app, shape_commands.app):
    document(_typer)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"packit {__version__}")
        raise typer.Exit


@app.callback(epilog=f"Start with `packit demo`. Documentation: {DOCUMENTATION}")
def configure(
    verbose: Annotated[
        int,
        typer.Option(
            "--verbose", "-v", count=True, help="Log progress to stderr; twice: also details."
        ),
    ] = 0,
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Print the version."
        ),
    ] = False,
) -> None:
    """Pack real 3D shapes into a box, exactly."""
    if verbose:
        handler = RichHandler(console=PlainConsole(stderr=True), show_path=False)
        for name in LOGGERS:
            logger = logging.getLogger(name)
            logger.setLevel(logging.INFO if verbose == 1 else logging.DEBUG)
            logger.handlers = [handler]


def main() -> None:
    """Run `packit`: a user's error is one line on stderr and exit code 2.

    SIGTERM and SIGHUP end it as Ctrl-C does, with exit codes 143 and 129.
    """
    arrived: list[int] = []
    try:
        with as_interrupts() as arrived:
            code = _run()
    except (KeyboardInterrupt, typer.Abort, SystemError) as error:  # outside of a command
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise  # otherwise Ctrl-C came while C code, such as numba's, called Python
        end_at_once()
        console.print("stopped")
        code = 130
    sys.exit(128 + arrived[-1] if arrived else code)


def _run() -> Any:
    """Run the command, and return its exit code."""
    try:
        return app(standalone_mode=False)
    except (PackItError, OSError, typer.TyperException) as error:
        _print_error(_message(error))
    except MemoryError as error:
        _print_error("the memory is not enough" + (f": {error}" if str(error) else ""))
    return 2


def _message(error: PackItError | OSError | typer.TyperException) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        if isinstance(error, FileExistsError):  # of a folder that a command creates
            return f"{error.filename} is a file, not a folder: choose another place"
        if isinstance(error, NotADirectoryError):
            return f"{error.filename} is not possible: a part of this path is a file, not a folder"
    return error.format_message() if isinstance(error, typer.TyperException) else message(error)


def _print_error(message: str) -> None:
    """Print a message as one line; none if it is empty, because the help was printed instead."""
    if line := " ".join(message.split("\n")).strip():
        text = f"[bold red]error:[/] {escape(line)}"
        PlainConsole(stderr=True).print(text, highlight=False, soft_wrap=True)
