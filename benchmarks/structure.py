"""Count what shows how simple the structure is: folders, imports between them, lines of code.

    .venv/bin/python -m benchmarks.structure

Prints a table. An import between folders is counted once for each pair of folders, where each
module at a package's root counts as a folder. A circle is a set of modules, or of folders, each of
which imports all others, directly or through others. Lines of code are those that `ast.unparse`
writes, without docstrings: they do not depend on comments or on how lines are broken.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path

import grimp
import networkx
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
PACKAGES = {"packit_sim": ROOT / "packit_sim", "packit_agents": ROOT / "agents/packit_agents"}
MAX_ARGUMENTS = 8
MOTION = re.compile(r"\[:3, ?:?3\]")
"""The rotation or the translation of a matrix (4, 4), taken out or set."""


def imports() -> set[tuple[str, str]]:
    """Return the pairs of modules of which the first imports the second."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    return {
        (one, other)
        for one in graph.modules
        for other in graph.find_modules_directly_imported_by(one)
    }


def circles(pairs: set[tuple[str, str]]) -> list[set[str]]:
    """Return the sets of modules or folders that import each other."""
    found = networkx.strongly_connected_components(networkx.DiGraph(pairs))
    return [circle for circle in found if len(circle) > 1]


def folder(module: str) -> str:
    """Return the dotted name of a module's folder; a package or a module at the root is its own."""
    package, *rest = module.split(".")
    is_package = PACKAGES[package].joinpath(*rest).is_dir()
    return module if is_package or len(rest) == 1 else module.rpartition(".")[0]


def code_lines(text: str) -> int:
    """Count the lines of code in a file's text."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        kept = [each for each in body if not is_text(each)]
        node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
    return len([line for line in ast.unparse(tree).splitlines() if line.strip()])


def is_text(node: ast.AST) -> bool:
    """Return whether a statement is only a string."""
    if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):
        return False
    return isinstance(node.value.value, str)


def long_signatures(text: str) -> Iterator[tuple[str, int]]:
    """Yield the name and number of arguments of each function that has more than eight."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            own = node.args
            names = [each.arg for each in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
            count = len([name for name in names if name not in ("self", "cls")])
            if count > MAX_ARGUMENTS:
                yield node.name, count


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    files = [file for path in PACKAGES.values() for file in sorted(path.rglob("*.py"))]
    texts = {file: file.read_text() for file in files}
    table = Table("measure", "count")
    table.add_row("modules at the root", str(len(list(PACKAGES["packit_sim"].glob("*.py")))))
    table.add_row("modules", str(len(files)))
    table.add_row("folders", str(len({file.parent for file in files})))
    between = imports()
    arrows = {(folder(one), folder(other)) for one, other in between}
    arrows = {(one, other) for one, other in arrows if one != other}
    table.add_row("imports between folders", str(len(arrows)))
    table.add_row("circles of modules", str(len(circles(between))))
    table.add_row("circles of folders", str(len(circles(arrows))))
    moving = [text for text in texts.values() if MOTION.search(text)]
    table.add_row("files with motion arithmetic", str(len(moving)))
    table.add_row("lines of code", str(sum(map(code_lines, texts.values()))))
    for file, text in texts.items():
        is_kernel = file.stem.endswith("_kernels")
        for name, count in long_signatures(text):
            if not is_kernel and not file.stem.endswith(("_command", "_commands")):
                table.add_row(f"arguments of {name} in {file.relative_to(ROOT)}", str(count))
    Console().print(table)


if __name__ == "__main__":
    main()
