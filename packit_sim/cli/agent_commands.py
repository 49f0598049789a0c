"""`packit agents`: the policies and searches that are installed."""

from __future__ import annotations

import typer
from rich.markup import escape

from packit_sim.cli.console import console
from packit_sim.cli.output import simple_table
from packit_sim.game.episodes.episode import Stage
from packit_sim.game.episodes.policy_registry import (
    PolicySummary,
    installed_policies,
    installed_searches,
)

app = typer.Typer(help="List the agents that can play.", no_args_is_help=True)


@app.command("list")
def list_command() -> None:
    """List policies and searches.

    The name of an agent is SHAPE/ROTATION/LOCATION, optionally with +SEARCH=VALUE.

    Example: packit agents list
    """
    for stage in Stage:
        _print_table(f"{stage.name.lower()} policy", installed_policies(stage))
    _print_table("search", installed_searches())
    console.print(
        "An agent has one policy of each kind, and optionally a search. Examples:\n"
        "  largest-first/aligned/blbf          the paper's Heuristic\n"
        "  largest-first/aligned/blbf+beam=4   the same, with a search over 4 beams\n"
        "  packnn/aligned/blbf                 with a bundled network for shapes",
        highlight=False,
        markup=False,
    )


def _print_table(kind: str, found: tuple[PolicySummary, ...]) -> None:
    table = simple_table(kind, "description")
    for one in found:
        table.add_row(escape(one.form), escape(one.summary))
    console.print(table)
    console.print()
