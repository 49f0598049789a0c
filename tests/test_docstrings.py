"""Public docstrings are in NumPy style: what a linter does not see."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(
    file
    for folder in ("packit_sim", "agents")
    for file in (ROOT / folder).rglob("*.py")
    if "command" not in file.name  # docstrings of commands are their help texts
)

Documented = ast.FunctionDef | ast.ClassDef


def public(node: ast.Module | ast.ClassDef) -> Iterator[Documented]:
    for child in node.body:
        if isinstance(child, Documented) and not child.name.startswith("_"):
            yield child
            if isinstance(child, ast.ClassDef):
                yield from public(child)


def names(node: Documented) -> list[str]:
    """The parameters of a function, or the fields of a class."""
    if isinstance(node, ast.ClassDef):
        return [
            child.target.id
            for child in node.body
            if isinstance(child, ast.AnnAssign)
            and isinstance(child.target, ast.Name)
            and not child.target.id.startswith("_")
        ]
    arguments = node.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return [argument.arg for argument in every if argument.arg not in ("self", "cls")]


def problems(node: Documented) -> Iterator[str]:
    text = ast.get_docstring(node)
    if text is None or not names(node):
        return
    sections = re.findall(r"^(\w[\w ]*)\n-{3,}$", text, re.MULTILINE)
    if isinstance(node, ast.ClassDef):
        if len(names(node)) > 1 and not {"Parameters", "Attributes"} & set(sections):
            yield "fields have no Parameters or Attributes section"
    elif "\n\n" in text and "Parameters" not in sections:
        yield "more than a summary, but no Parameters section"
    prose = text.split("\n----")[0]
    for name in names(node):
        if re.search(rf"(^|[.:;,] |\n){name}(, \w+)*: \w", prose):
            yield f"{name!r} is described in prose"


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_public_docstrings_document_their_parameters_in_sections(file) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    found = [f"{node.name}: {problem}" for node in public(tree) for problem in problems(node)]
    assert found == []
