"""The command line: `packit`."""

from __future__ import annotations

import inspect
import logging
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.main import get_group

from packit_sim.cli.help import Group, command, documented, write_summaries
from packit_sim.cli.stopping import stoppable
from packit_sim.core.entry_points import EntryPointError, announced, load, usable
from packit_sim.core.errors import PackItError, message
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.core.plain_text import plain_line
from packit_sim.core.signals import as_interrupts, end_at_once
from packit_sim.core.version import DOCUMENTATION, __version__

with lazy_imports():
    from packit_sim.cli import terminal

PACK, PLAY, BENCHMARK, LEARN, LOOK = "Pack", "Play", "Benchmark", "Learn", "Look"
INSTALLATION, OTHERS = "Installation", "Of other packages"

COMMANDS: dict[str, dict[str, str]] = {
    PACK: {
        "pack": "pack_command",
        "workbench": "viewer_commands",
        "fit": "fit_command",
        "containers": "containers_command",
        "nest": "nest_command",
    },
    PLAY: {
        "demo": "demo_command",
        "agents": "agent_commands",
        "datasets": "dataset_commands",
        "evaluate": "evaluation_commands",
        "execute": "execute_command",
        "compare": "evaluation_commands",
    },
    BENCHMARK: {
        "shapes": "shape_commands",
        "generate": "generation_commands",
        "prepare": "physics_commands",
        "verify": "verify_command",
        "compact": "physics_commands",
        "score": "physics_commands",
        "reproduce": "reproduction_commands",
        "report": "report_commands",
    },
    LEARN: {"record": "record_command", "train": "", "train-champion": "", "train-columns": ""},
    LOOK: {
        "view": "viewer_commands",
        "render": "picture_commands",
        "film": "picture_commands",
        "export": "picture_commands",
        "figures": "figure_commands",
    },
    INSTALLATION: {"doctor": "doctor_command", "selftest": "selftest_command"},
}
"""The commands in the order of use, by their headings in `--help`, with the modules that have them;
those without one, and those of other packages, are entry points."""


class _Commands(Mapping[str, Any]):
    """All commands, in the order of `COMMANDS`; each is imported and built when first used.

    A command of another package that can't be used raises EntryPointError.
    """

    def __getitem__(self, name: str) -> Any:
        function_or_group = _found(name)
        if _module(name):
            return _built(name, function_or_group)
        with usable(_entry_points()[name], "command"):
            return _built(name, function_or_group)

    def __iter__(self) -> Iterator[str]:
        found = _entry_points()
        known = [name for modules in COMMANDS.values() for name in modules]
        yield from (name for name in known if _module(name) or name in found)
        yield from sorted(found.keys() - set(known))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Commands(Group):
    """The commands, in the order of `COMMANDS`; Ctrl-C ends each with a line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands: Any = _Commands()

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        texts: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            try:
                text = _text(name) if _module(name) else str(self.commands[name].help or "")
            except EntryPointError as error:
                typer.echo(f"warning: {error}", err=True)
            else:
                texts.setdefault(_panel(name), []).append((name, text))
        for panel, found in texts.items():
            write_summaries(formatter, panel, found)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        try:
            return super().get_command(ctx, cmd_name)
        except EntryPointError:
            if ctx.resilient_parsing:  # the shell completes a line
                return None
            raise

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        with stoppable("nothing is begun"):  # typer itself would end without a word
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        with stoppable("the command is not finished"):
            return super().invoke(ctx)


app = typer.Typer(cls=Commands, rich_markup_mode=None)


def _panel(name: str) -> str:
    panels = (panel for panel, modules in COMMANDS.items() if name in modules)
    return next(panels, OTHERS)


def _module(name: str) -> str | None:
    return COMMANDS.get(_panel(name), {}).get(name)


@cache
def _entry_points() -> dict[str, Any]:
    """Find the commands of packages: slow, and only needed for those and for lists of all."""
    return announced("packit_sim.commands")


@cache
def _found(name: str) -> Any:
    """Import a command's function, or its group of commands; raise KeyError if there is none."""
    module = _module(name)
    if not module:
        return load(_entry_points()[name], "command")
    names = vars(import_module(f"packit_sim.cli.{module}"))
    return names.get(f"{name}_command") or names["app"]


def _built(name: str, function_or_group: Any) -> Any:
    if not isinstance(function_or_group, typer.Typer):
        return command(name, function_or_group, _panel(name))
    built = get_group(documented(function_or_group))
    built.name, built.rich_help_panel = name, _panel(name)
    return built


def _text(name: str) -> str:
    found = _found(name)
    help_ = found.info.help if isinstance(found, typer.Typer) else inspect.getdoc(found)
    return str(help_ or "")


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
        terminal.show_logs(logging.INFO if verbose == 1 else logging.DEBUG)


def main() -> None:
    """Run `packit`: a user's error is one line on stderr and exit code 2.

    SIGTERM and SIGHUP end it as Ctrl-C does, with exit codes 143 and 129.
    """
    arrived: list[int] = []
    try:
        with as_interrupts() as arrived:
            code = _run()
    except (KeyboardInterrupt, typer.Abort, SystemError) as error:  # outside of a command
        if isinstance(error, SystemError) and not _is_of_ctrl_c(error):
            raise
        end_at_once()
        terminal.console.print("stopped")
        code = 130
    sys.exit(128 + arrived[-1] if arrived else code)


def _is_of_ctrl_c(error: BaseException | None) -> bool:
    """Return whether Ctrl-C came while C code, such as numba's, called Python.

    Each such call makes another error of it.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


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
    if not isinstance(error, typer.TyperException):
        return message(error)
    text = error.format_message().replace("Value error, ", "")  # a word of pydantic
    return re.sub(r" \(Possible options: (.*)\)$", r". Did you mean \1?", text)


def _print_error(message: str) -> None:
    """Print a message as one line; none if it is empty, because the help was printed instead."""
    if line := plain_line(message):
        terminal.print_error(line)
