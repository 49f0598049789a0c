"""The help of commands, from the docstrings of their functions."""

from __future__ import annotations

import inspect
import re

import typer

_EXAMPLE = "Example: "


def document(app: typer.Typer) -> None:
    """Set the help of an app's commands: paragraphs on one line each, and examples at the end.

    Parameters
    ----------
    app : typer.Typer
        The app. In the docstring of a command, a paragraph that begins with "Example: " is an
        example.
    """
    for command in app.registered_commands:
        paragraphs = [
            " ".join(paragraph.split())
            for paragraph in re.split(r"\n\s*\n", inspect.getdoc(command.callback) or "")
        ]
        examples = [one.removeprefix(_EXAMPLE) for one in paragraphs if one.startswith(_EXAMPLE)]
        command.help = "\n\n".join(one for one in paragraphs if not one.startswith(_EXAMPLE))
        if examples:
            heading = "Examples:" if len(examples) > 1 else "Example:"
            command.epilog = "\n\n".join([heading, *(f"  $ {example}" for example in examples)])
