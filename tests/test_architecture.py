"""Each package has a docstring. `lint-imports` checks which package may import which."""

import ast
import re
import tomllib
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


def test_every_file_that_the_page_names_exists() -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w/]+\.py)`", page))
    folders = [*(package.parent for package in PACKAGES), ROOT / "tests"]
    paths = [f"/{file}" for folder in folders for file in folder.glob("*.py")]
    assert len(named) > 30
    assert [name for name in named if not any(path.endswith(f"/{name}") for path in paths)] == []


def test_the_page_lists_the_layers_of_the_contract_in_its_order() -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, flags=re.MULTILINE)
    listed = [set(re.findall(r"`(\w+)(?:/|\.py)`", row)) for row in rows]
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    layers = [set(layer.split(" | ")) for layer in contract]
    assert set().union(*listed) == set().union(*layers)
    depth = {name: n for n, layer in enumerate(layers) for name in layer}
    depths = [depth[name] for row in listed for name in sorted(row, key=depth.__getitem__)]
    assert depths == sorted(depths)
