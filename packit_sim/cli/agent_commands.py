"""`packit agents`: the policies and searches that are installed."""

from __future__ import annotations

import packit_sim
from packit_sim.cli.help import group
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from rich import markup

    from packit_sim.cli import output, terminal
    from packit_sim.game.episodes import policy_registry

app = group("List the agents that can play.")


@app.command("list")
def list_command() -> None:
    """List policies and searches.

    The name of an agent is SHAPE/ROTATION/LOCATION, optionally with +SEARCH=VALUE.

    Example: packit agents list
    """
    for stage in packit_sim.Stage:
        _print_table(f"{stage.name.lower()} policy", policy_registry.installed_policies(stage))
    _print_table("search", policy_registry.installed_searches())
    terminal.console.print(
        "An agent has one policy of each kind, and optionally a search. Examples:\n"
        "  largest-first/aligned/blbf          the paper's Heuristic\n"
        "  largest-first/aligned/blbf+beam=4   the same, with a search over 4 beams\n"
        "  packnn/aligned/blbf                 with a bundled network for shapes",
        highlight=False,
        markup=False,
    )


def _print_table(kind: str, found: tuple[policy_registry.PolicySummary, ...]) -> None:
    table = output.simple_table(kind, "description")
    for one in found:
        table.add_row(markup.escape(one.form), markup.escape(one.summary))
    terminal.console.print(table)
    terminal.console.print()
