"""Tabulate for which systems and Pythons the dependencies have wheels.

    .venv/bin/python scripts/wheels.py

It asks pip, which asks the package index that it is configured for, and writes the tables of
`docs/start/install.md` with today's date. A cell counts the base dependencies that have a wheel, of
those that are installed there, and names the others. For packages of extras that hold machine code,
it lists the Pythons for which there is a wheel.
"""

from __future__ import annotations

import datetime
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from benchmarks.common import markdown_table, write_into_page

ROOT = Path(__file__).parents[1]

PAGE = ROOT / "docs" / "start" / "install.md"

BLOCK = "wheels"

EXTRAS_BLOCK = "wheels of extras"

EXTRAS = ("physics", "cluster", "cad", "containers", "sheets", "exact")
"""Extras of packages that hold machine code, and lack wheels somewhere, or might."""

PYTHONS = ("3.11", "3.12", "3.13", "3.14")

SYSTEMS = {
    "Windows, x86-64": ("win32", "AMD64", ("win_amd64",)),
    "macOS 14, Apple silicon": ("darwin", "arm64", ("macosx_14_0_arm64",)),
    "macOS 14, Intel": ("darwin", "x86_64", ("macosx_14_0_x86_64",)),
    "Linux, x86-64": ("linux", "x86_64", ("manylinux_2_28_x86_64", "manylinux2014_x86_64")),
    "Linux, ARM": ("linux", "aarch64", ("manylinux_2_28_aarch64", "manylinux2014_aarch64")),
}
"""The `sys_platform`, the machine, and the tags of wheels of each system."""


def dependencies(system: str, python: str) -> list[str]:
    """Return the requirements of the base installation on a system, without their markers."""
    platform, machine, _ = SYSTEMS[system]
    there = {"sys_platform": platform, "platform_machine": machine, "python_version": python}
    found = map(Requirement, _project()["dependencies"])
    return [
        f"{each.name}{each.specifier}"
        for each in found
        if each.marker is None or each.marker.evaluate(there)
    ]


def _project() -> dict[str, Any]:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return dict(project["project"])


def has_wheels(names: Sequence[str], system: str, python: str) -> bool:
    """Return whether pip finds wheels of all requirements, without those that they need."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--no-deps"]
    command += ["--ignore-installed", "--only-binary", ":all:", "--target", "unused"]
    command += ["--implementation", "cp", "--python-version", python]
    command += [f"--platform={tag}" for tag in SYSTEMS[system][2]]
    return subprocess.run([*command, *names], capture_output=True).returncode == 0


def cell(system: str, python: str) -> str:
    """Return how many dependencies have wheels, and which have none."""
    names = dependencies(system, python)
    if has_wheels(names, system, python):
        return f"{len(names)} of {len(names)}"
    lacking = [name for name in names if not has_wheels([name], system, python)]
    without = ", ".join(Requirement(name).name for name in lacking)
    return f"{len(names) - len(lacking)} of {len(names)}; not {without}"


def pythons(requirement: str, system: str) -> str:
    """Return the Pythons for which a requirement has a wheel."""
    found = [python for python in PYTHONS if has_wheels([requirement], system, python)]
    return "all" if len(found) == len(PYTHONS) else ", ".join(found) or "none"


def main() -> None:
    """Write the tables into the page."""
    rows = [[system, *(cell(system, python) for python in PYTHONS)] for system in SYSTEMS]
    table = markdown_table(["system", *PYTHONS], rows)
    today = datetime.datetime.now(tz=datetime.UTC).date()
    write_into_page(PAGE, f"{table}\nBy `python scripts/wheels.py`, {today}.\n", BLOCK)
    extras = _project()["optional-dependencies"]
    packages = [(extra, name) for extra in EXTRAS for name in extras[extra]]
    rows = [
        [f"`[{extra}]`", Requirement(name).name, *(pythons(name, system) for system in SYSTEMS)]
        for extra, name in packages
    ]
    table_of_extras = markdown_table(["extra", "package", *SYSTEMS], rows)
    write_into_page(PAGE, table_of_extras, EXTRAS_BLOCK)
    print(table, table_of_extras, sep="\n")


if __name__ == "__main__":
    main()
