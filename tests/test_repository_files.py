"""Files for contributors and for those who cite: valid, and in agreement with the project."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from packit_sim.core.version import DOCUMENTATION, __version__

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))

pytestmark = pytest.mark.skipif(not WORKFLOWS, reason="installed without the repository's files")


def text(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("schema", "files"),
    [
        ("github-workflows", [f".github/workflows/{file.name}" for file in WORKFLOWS]),
        (
            "github-issue-forms",
            [".github/ISSUE_TEMPLATE/bug.yml", ".github/ISSUE_TEMPLATE/feature.yml"],
        ),
        ("github-issue-config", [".github/ISSUE_TEMPLATE/config.yml"]),
        ("readthedocs", [".readthedocs.yaml"]),
        ("citation-file-format", ["CITATION.cff"]),
    ],
)
def test_a_file_follows_its_schema(schema, files) -> None:
    pytest.importorskip("check_jsonschema", reason="check-jsonschema comes with the extra dev")
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    run = subprocess.run([*command, *files], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_the_linter_of_workflows_has_nothing_to_say() -> None:
    linter = Path(sys.executable).with_name("zizmor")
    if not linter.exists():
        pytest.skip("zizmor comes with the extra dev")
    command = [
        linter,
        "--offline",
        "--persona",
        "pedantic",
        "--color",
        "never",
        ".github/workflows",
    ]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0 and "No findings" in run.stdout + run.stderr, run.stdout


def test_every_supported_python_is_tested() -> None:
    project = tomllib.loads(text("pyproject.toml"))["project"]
    supported = [
        found[1]
        for line in project["classifiers"]
        if (found := re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", line))
    ]
    assert project["requires-python"] == f">={supported[0]}"
    tested = re.findall(r"python: \[(.*)\]", text(".github/workflows/tests.yml"))
    assert len(tested) == 2
    for versions in tested:
        assert re.findall(r'"(.*?)"', versions) == supported


def test_workflows_use_targets_that_exist() -> None:
    makefile = text("Makefile")
    used = {
        target
        for file in WORKFLOWS
        for targets in re.findall(r"run: make ([\w -]+)", file.read_text(encoding="utf-8"))
        for target in targets.split()
    }
    assert {"setup", "lint", "types", "test", "docs", "wheel"} <= used
    for target in used:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


def test_the_citation_is_of_this_version() -> None:
    citation = text("CITATION.cff")
    assert f"\nversion: {__version__}\n" in citation
    assert f"\nurl: {DOCUMENTATION}\n" in citation
    assert f"url: {DOCUMENTATION}\n" in text(".github/ISSUE_TEMPLATE/config.yml")


def test_the_image_copies_what_it_installs() -> None:
    """What the wheel is made of must not be left out of the image's context."""
    ignored = {line.strip("/*") for line in text(".dockerignore").split()}
    wheel = tomllib.loads(text("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {path.partition("/")[0] for path in wheel["only-include"]}
    assert (
        needed | {"constraints.txt", "pyproject.toml", "README.md", "LICENSE"}
        == (needed | {"constraints.txt", "pyproject.toml", "README.md", "LICENSE"}) - ignored
    )
