"""The public API: every name in the README and the docs is imported from a public module."""

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import packit_sim

ROOT = Path(__file__).parents[1]

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

_NAMES, _SUBMODULES, _TYPES = (
    re.findall(r"^   (packit_sim\.[\w.]+)$", part, flags=re.MULTILINE)
    for part in re.split(
        r"^## (?:Submodules|Other types)$",
        (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )
)

PUBLIC = ["packit_sim", *_SUBMODULES]
"""The package and the public submodules that docs/reference/api.md lists."""


def imports(page: Path) -> list[tuple[str, str | None]]:
    """The module and the name of each import of ours in a page's Python blocks."""
    found: list[tuple[str, str | None]] = []
    for block in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module:
                found += [(node.module, alias.name) for alias in node.names]
            elif isinstance(node, ast.Import):
                found += [(alias.name, None) for alias in node.names]
    return [(module, name) for module, name in found if module.split(".")[0] == "packit_sim"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_imports_from_public_places_alone(page) -> None:
    for module, name in imports(page):
        if f"{module}.{name}" in PUBLIC:
            continue
        assert module in PUBLIC, f"{page.name} imports {module}, which is not public"
        if name is not None:
            public = import_module(module).__all__
            assert name in public, f"{page.name} imports {name} from {module}, which keeps it"


def test_the_reference_lists_every_public_name() -> None:
    assert len(PUBLIC) > 3
    assert sorted(_NAMES) == sorted(
        f"packit_sim.{name}" for name in packit_sim.__all__ if name != "__version__"
    )


@pytest.mark.parametrize("path", _TYPES)
def test_the_other_types_of_the_reference_exist(path) -> None:
    module, name = path.rsplit(".", 1)
    assert hasattr(import_module(module), name)
    assert name not in packit_sim.__all__


@pytest.mark.parametrize("module", PUBLIC)
def test_every_public_name_exists(module) -> None:
    found = import_module(module)
    assert len(set(found.__all__)) == len(found.__all__)
    for name in found.__all__:
        assert hasattr(found, name), f"{module}.{name}"
    assert set(found.__all__) <= set(dir(found))


def test_type_checkers_see_the_names_that_are_imported_when_used() -> None:
    tree = ast.parse(Path(packit_sim.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {
        (node.module, alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {(home, name) for name, home in packit_sim._HOME_OF.items()}


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Boxx'"):
        packit_sim.Boxx  # noqa: B018
    with pytest.raises(ImportError, match="Boxx"):
        exec("from packit_sim import Boxx")


def test_importing_the_package_loads_nothing_of_it_and_no_heavy_library() -> None:
    code = "import sys, packit_sim; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    loaded = set(run.stdout.split())
    assert {name for name in loaded if name.startswith("packit_sim")} == {
        "packit_sim",
        "packit_sim.core",
        "packit_sim.core.version",
    }
    assert not loaded & {"fcl", "joblib", "numba", "pybullet", "scipy", "trimesh", "typer"}
