"""Measure how much disk space the base installation and each extra take.

    .venv/bin/python -m benchmarks.sizes

Sums the files of every package that this environment has, its compiled bytecode included. An extra
counts what it adds to the base installation; packages that several extras share count for each.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json

NAME = "packit-sim"
EXTRAS = ("learn", "view", "report", "physics", "cluster", "all")
LARGEST = 6
"""Number of packages that a row names."""


def closure(name: str, extras: frozenset[str] = frozenset()) -> dict[str, Distribution]:
    """Find a package and all that it requires, by canonical name."""
    found: dict[str, Distribution] = {}
    waiting = [(name, extras)]
    asked = set(waiting)
    while waiting:
        name, extras = waiting.pop()
        package = distribution(name)
        found[canonical(name)] = package
        for requirement in required(package, extras):
            wanted = (requirement.name, frozenset(requirement.extras))
            if wanted not in asked:
                asked.add(wanted)
                waiting.append(wanted)
    return found


def required(package: Distribution, extras: frozenset[str]) -> Iterator[Requirement]:
    """Yield the requirements of a package with extras that apply to this Python."""
    for line in package.requires or ():
        requirement = Requirement(line)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *extras}):
            yield requirement


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def size(package: Distribution) -> int:
    """Sum the bytes of a package's files."""
    paths = (Path(str(file.locate())) for file in package.files or ())
    return sum(path.stat().st_size for path in paths if path.is_file())


def megabytes(packages: dict[str, Distribution]) -> dict[str, float]:
    """Measure each package, the largest first."""
    sizes = {name: size(package) / 2**20 for name, package in packages.items()}
    return dict(sorted(sizes.items(), key=lambda pair: -pair[1]))


def main() -> None:
    arguments = argument_parser(__doc__).parse_args()
    base = closure(NAME)
    rows = {"base": megabytes(base)}
    for extra in EXTRAS:
        try:
            whole = closure(NAME, frozenset({extra}))
        except PackageNotFoundError as error:
            Console(stderr=True).print(f"{extra} is not measured: {error} is not installed")
            continue
        rows[extra] = megabytes({name: whole[name] for name in whole.keys() - base.keys()})
    table = Table("what", "MB", "largest packages, MB")
    for name, sizes in rows.items():
        largest = ", ".join(f"{one} {mb:.0f}" for one, mb in list(sizes.items())[:LARGEST])
        table.add_row(name, f"{sum(sizes.values()):.0f}", largest)
    Console(width=120).print(table)
    write_json(
        arguments.out / "sizes.json",
        {"command": "python -m benchmarks.sizes", "machine": machine(), "megabytes": rows},
    )


if __name__ == "__main__":
    main()
