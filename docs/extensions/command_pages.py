"""The command reference: every command of `packit`, written from the command line itself.

The line `<!-- commands -->` of a page is replaced by a section for each command.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from typing import Any

import typer
from sphinx.application import Sphinx
from typer.main import get_command

from packit_sim.cli.app import app

MARKER = "<!-- commands -->"

TYPES = {"str": "text"}
"""Names of types in the tables."""


def commands() -> Iterator[tuple[str, Any, str]]:
    """List the commands in the order of `packit --help`.

    Yields
    ------
    str
        The words that call the command, such as `packit shapes list`.
    Command
        The command.
    str
        The panel of the help that lists it; empty if there is none.
    """
    yield from _below("packit", get_command(app), "")


def _below(name: str, group: Any, panel: str) -> Iterator[tuple[str, Any, str]]:
    context = typer.Context(group)
    for word in group.list_commands(context):
        command = group.get_command(context, word)
        within = panel or _text(command.rich_help_panel)
        if hasattr(command, "list_commands"):
            yield from _below(f"{name} {word}", command, within)
        else:
            yield f"{name} {word}", command, within


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def reference() -> str:
    """Write the command reference as Markdown.

    Returns
    -------
    str
        A section for each panel, a subsection for each command, with tables of its options.
    """
    lines = ["## Options of `packit` itself", "", *_table(get_command(app), "option"), ""]
    shown = None
    for name, command, panel in commands():
        if panel != shown:
            lines += [f"## {panel or 'Commands'}", ""]
            shown = panel
        lines += [f"### {name}", "", *_section(name, command), ""]
    return "\n".join(lines)


def _section(name: str, command: Any) -> Iterator[str]:
    for paragraph in textwrap.dedent(command.help or "").replace("\b", "").split("\n\n"):
        yield from (_plain(" ".join(paragraph.split())), "")
    examples = re.findall(r"^ *\$ (.+)$", command.epilog or "", flags=re.MULTILINE)
    if examples:
        yield from ("```console", *(f"$ {example}" for example in examples), "```", "")
    pieces = command.collect_usage_pieces(typer.Context(command))
    usage = [re.sub(r"^(?:\[\[(.*)\]\]|\{(.*)\})(\.*)$", _usage, piece) for piece in pieces]
    yield from ("**Usage:** " + _code(" ".join([name, *usage])), "")
    for kind in ("argument", "option"):
        yield from (*_table(command, kind), "")


def _usage(piece: re.Match[str]) -> str:
    """Write an argument as manuals do: [NAME] if it is optional, else NAME."""
    optional, required, dots = piece.groups()
    return (f"[{optional.upper()}]" if optional else required.upper()) + dots


def _table(command: Any, kind: str) -> Iterator[str]:
    context = typer.Context(command)
    records = [
        parameter.get_help_record(context)
        for parameter in command.get_params(context)
        if parameter.param_type_name == kind
    ]
    rows = [record for record in records if record is not None and record[0] != "--help"]
    if not rows:
        return
    yield from (f"| {kind} | meaning | default, range |", "|---|---|---|")
    for names, meaning in rows:
        if kind == "argument":
            names = names.partition(" ")[0].strip("[]").upper()
        match = re.fullmatch(
            r"(.*?)\s*(?:\[((?:default|required|x\b|\d).*)\])?", meaning, re.DOTALL
        )
        text, limits = match.groups() if match else (meaning, None)
        limits = (limits or "").removeprefix("default: ")
        yield f"| {_code(_short(names))} | {_plain(text)} | {_code(limits)} |"


def _short(names: str) -> str:
    """Write types as manuals do: `--seed <int range>` as `--seed INT`."""
    names = re.sub(r"<list\[([^\]]+)\]>", r"<\1> ...", names)
    return re.sub(r"<(\w+)(?: range)?>", lambda kind: TYPES.get(kind[1], kind[1]).upper(), names)


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`" if text else ""


def _plain(text: str) -> str:
    """Escape what Markdown would take for markup; mark options as code."""
    text = re.sub(r"([\\*<>|\[\]#])", r"\\\1", text)
    return re.sub(r"(?<![\w`-])(--[a-z][a-z-]*)", r"`\1`", text)


def insert(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the marker of a page.

    Parameters
    ----------
    app : Sphinx
        The application.
    page : str
        The name of the page.
    source : list of str
        Its text, changed in place.
    """
    if MARKER in source[0]:
        source[0] = source[0].replace(MARKER, reference())


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension with Sphinx.

    Parameters
    ----------
    app : Sphinx
        The application.

    Returns
    -------
    dict
        That the extension may run in parallel.
    """
    app.connect("source-read", insert)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
