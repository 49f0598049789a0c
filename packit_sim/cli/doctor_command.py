"""`packit doctor`: what works on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from rich import markup

    from packit_sim.cli import compiling, machine_checks, output, terminal

_OWN = 3
"""Checks of the installation itself, before those of packages."""

_STYLES = {"ok": "green", "missing": "yellow", "problem": "red"}


def doctor_command(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    compile: Annotated[
        bool,
        typer.Option("--compile", help="Compile the kernels of all commands first."),
    ] = False,
) -> None:
    """Check what works on this machine, and print remedies.

    It checks the packages (in separate processes if they may crash), EGL, the cores, the memory and
    the cache folders. Exit code 1 if something required is broken.

    Example: packit doctor --compile
    """
    if compile:
        compiling.compile_shown()
    checks = machine_checks.all_checks()
    broken = [check for check in checks if check.required and check.status != "ok"]
    if as_json:
        found = {"works": not broken, "checks": [asdict(check) for check in checks]}
        typer.echo(json.dumps(found, ensure_ascii=False, indent=1))
    else:
        _print(checks)
    if broken:
        raise typer.Exit(1)


def _print(checks: list[machine_checks.MachineCheck]) -> None:
    """Print a table; required packages that work share a row."""
    works = [check for check in checks if check.required and check.status == "ok"]
    rows = [check for check in checks if check not in works]
    table = output.simple_table("", "", "found", "remedy")
    for column in table.columns[2:]:
        column.overflow = "fold"
    for check in works[:_OWN]:
        table.add_row(check.name, "[green]ok[/]", markup.escape(check.found), "")
    names = ", ".join(f"{check.name} {check.found}" for check in works[_OWN:])
    table.add_row("required packages", "[green]ok[/]", markup.escape(names), "")
    for check in rows:
        status = f"[{_STYLES[check.status]}]{check.status}[/]"
        table.add_row(check.name, status, markup.escape(check.found), markup.escape(check.remedy))
    terminal.console.print(table)
