"""Options of a command in a file: those of an earlier run, kept and used again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import typer
from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackItError, located
from packit_sim.core.files import read_whole, replace_text

PERSONAL = ("parts", "out", "force", "workers", "backend", "address", "preset", "save_preset")
"""Parameters that are of one run or machine, and not kept."""


class _Preset(Struct):
    options: dict[str, Any]
    command: str = ""


def use_preset(ctx: typer.Context, file: Path | None) -> Path | None:
    """Take the options that a file has as defaults of a command, before others are read.

    Returns
    -------
    Path or None
        The file.

    Raises
    ------
    ArgumentError
        If the file has something else.
    """
    if file is None or ctx.resilient_parsing:
        return file
    with located(file, ArgumentError):
        preset = typed_json.decode(read_whole(file), _Preset, ArgumentError, "a preset")
        options = preset.options
        if preset.command not in ("", ctx.command.name):
            raise ArgumentError(f"it is of another command, {preset.command!r}")
        known = {each.name: each for each in ctx.command.params if each.name not in PERSONAL}
        for name, value in options.items():
            if name not in known:
                raise ArgumentError(
                    f"option {name!r} is not known: choose from {', '.join(sorted(known))}"
                )
            if isinstance(value, bool) and not getattr(known[name], "is_flag", False):
                raise ArgumentError(f"option {name!r} is {value}: it is no yes or no")
            try:
                known[name].process_value(ctx, value)
            except (typer.TyperException, TypeError, ValueError, PackItError) as error:
                reason = str(getattr(error, "message", error)).removeprefix("Value error, ")
                raise ArgumentError(f"option {name!r}: {reason}") from None
    ctx.default_map = options
    return file


def save_preset(ctx: typer.Context, file: Path) -> None:
    """Write the options of a command that were given, or that come from another such file.

    Raises
    ------
    OSError
        If the file can't be written.
    """
    given = {
        name: value
        for name, value in ctx.params.items()
        if name not in PERSONAL
        and getattr(ctx.get_parameter_source(name), "name", "") in ("COMMANDLINE", "DEFAULT_MAP")
    }
    content = {"command": ctx.command.name, "options": given}
    replace_text(file, json.dumps(content, indent=1, default=str) + "\n")
