"""Groups of commands, and their help: from docstrings, in lines of at most 80 columns."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Iterable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

_EXAMPLE = "Example: "

_CONTINUED = " \\"
"""The end of a line that the next one continues, for shells."""

_PLAIN: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None}
"""Help as plain text: the type stands beside its option, and nothing is cut or in a frame."""


_NO_OPTION = "packit_sim.no_option"
"""Whether the first word is no option, in the `meta` of a context."""


_NAMES = 24
"""Columns of an option with its type: a longer one stands on a line above its text."""

_HYPHEN = "\u2011"
"""The hyphen at which no line breaks."""


class _Formatter(typer.Context.formatter_class):  # type: ignore[valid-type,misc]
    """Breaks lines between words only: names of agents and addresses have hyphens."""

    def write_text(self, text: str) -> None:
        super().write_text(text.replace("-", _HYPHEN))

    def write_dl(self, rows: Iterable[tuple[str, str]], *widths: int) -> None:
        kept = [(name, text.replace("-", _HYPHEN)) for name, text in rows]
        super().write_dl(kept, *(widths or (_NAMES,)))

    def write(self, string: str) -> None:
        super().write(string.replace(_HYPHEN, "-"))


class _Context(typer.Context):
    formatter_class = _Formatter


class Group(TyperGroup):
    """Commands with their whole summaries in `--help`."""

    context_class = _Context

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.meta[_NO_OPTION] = bool(args) and not args[0].startswith("-")
        if not args and not ctx.resilient_parsing:
            typer.echo(self.get_help(ctx))
            raise typer.Exit(2)
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the options, or none if the first word is none.

        To read one that is not given, typer imports pydantic, which takes as long as all else.
        """
        return [] if ctx.meta.get(_NO_OPTION) else super().get_params(ctx)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        texts = [(name, str(self.commands[name].help)) for name in self.list_commands(ctx)]
        write_summaries(formatter, "Commands", texts)


class Command(TyperCommand):
    """A command whose examples in `--help` can be copied: long ones go on after a backslash."""

    context_class = _Context

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        for paragraph in (self.epilog or "").split("\n\n"):
            lines = textwrap.wrap(
                paragraph,
                formatter.width - len(_CONTINUED),
                initial_indent="  ",
                subsequent_indent="      ",
                break_on_hyphens=False,
                break_long_words=False,
            )
            formatter.write("\n" + f"{_CONTINUED}\n".join(lines) + "\n")


def write_summaries(formatter: Any, heading: str, texts: Iterable[tuple[str, str]]) -> None:
    """Write a section of help: names of commands, and the first paragraphs of their texts."""
    with formatter.section(heading):
        formatter.write_dl([(name, " ".join(summary(text).split())) for name, text in texts])


def summary(text: str) -> str:
    """Return the first paragraph of a text."""
    return text.strip().partition("\n\n")[0]


def group(help: str) -> typer.Typer:
    """Create a group of commands."""
    return typer.Typer(cls=Group, help=help, **_PLAIN)


def command(name: str, function: Callable[..., None], panel: str) -> Any:
    """Create a single command.

    Parameters
    ----------
    name : str
        Its name.
    function : callable
        What it does; its parameters are options and arguments.
    panel : str
        The heading under which `packit --help` lists it.

    Returns
    -------
    TyperCommand
        The command.
    """
    app = typer.Typer(**_PLAIN)
    app.command(name, rich_help_panel=panel)(function)
    return get_command(documented(app))


def documented(app: typer.Typer) -> typer.Typer:
    """Set the help of an app's commands: paragraphs on one line each, and examples at the end.

    Parameters
    ----------
    app : typer.Typer
        The app. In the docstring of a command, a paragraph that begins with "Example: " is an
        example.

    Returns
    -------
    typer.Typer
        The same.
    """
    for command in app.registered_commands:
        paragraphs = [
            " ".join(paragraph.split())
            for paragraph in re.split(r"\n\s*\n", inspect.getdoc(command.callback) or "")
        ]
        examples = [one.removeprefix(_EXAMPLE) for one in paragraphs if one.startswith(_EXAMPLE)]
        command.help = "\n\n".join(one for one in paragraphs if not one.startswith(_EXAMPLE))
        command.cls = Command
        if examples:
            heading = "Examples:" if len(examples) > 1 else "Example:"
            command.epilog = "\n\n".join([heading, *(f"  $ {example}" for example in examples)])
    return app
