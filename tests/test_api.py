"""The public API: every name in the README and the docs is imported from a public module."""

import ast
import re
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


def test_type_checkers_see_the_public_names_where_they_are_imported_from() -> None:
    stub = ast.parse(Path(packit_sim.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    names = []
    for node in stub.body[1:]:
        assert isinstance(node, ast.ImportFrom) and node.level == 1 and node.module
        for alias in node.names:
            assert alias.asname == alias.name, "stubs export a name only with `as`"
            home = import_module(f"packit_sim.{node.module}")
            assert getattr(packit_sim, alias.name) is getattr(home, alias.name)
            names.append(alias.name)
    assert sorted(names) == sorted(packit_sim.__all__)


def test_a_star_imports_every_public_name() -> None:
    names: dict[str, object] = {}
    exec("from packit_sim import *", names)
    assert set(packit_sim.__all__) <= set(names)


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="No packit_sim attribute Boxx"):
        packit_sim.Boxx  # noqa: B018
    with pytest.raises(ImportError, match="Boxx"):
        exec("from packit_sim import Boxx")
