"""Each package has a docstring. `lint-imports` checks which package may import which."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(
    file
    for source in (ROOT / "packit_sim", ROOT / "agents" / "packit_agents")
    for file in source.rglob("__init__.py")
)


@pytest.mark.parametrize("file", PACKAGES, ids=lambda file: file.parent.name)
def test_each_package_says_what_is_in_it(file) -> None:
    assert ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))


def test_file_names_do_not_repeat_across_folders() -> None:
    names = [
        file.name
        for package in PACKAGES
        for file in package.parent.glob("*.py")
        if not file.name.startswith("__")
    ]
    assert {name for name in names if names.count(name) > 1} == set()


def test_class_names_do_not_repeat_nor_stand_for_other_types() -> None:
    trees = [
        ast.parse(file.read_text(encoding="utf-8"))
        for package in PACKAGES
        for file in package.parent.glob("*.py")
    ]
    classes = [
        node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)
    ]
    aliases = [
        target.id
        for tree in trees
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    ]
    assert {name for name in classes if [*classes, *aliases].count(name) > 1} == set()
