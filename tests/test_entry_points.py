"""Entry points of another package that can't be used: a line that names them, never a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from packit_sim.core.entry_points import EntryPointError, announced, load, usable
from packit_sim.core.errors import LibraryError
from packit_sim.libraries.library import ShapeLibrary

MODULES = {
    "missing": "import packit_absent",
    "syntax": "def (",
    "old": "from packit_sim import NoSuchName",
    "ends": "raise SystemExit(3)",
    "works": "NUMBER = 5\ndef command():\n    'Print a word.'\n    print('printed')",
}

COMMANDS = {
    "missing": ("missing:command", "its imports need packit_absent, which is not installed"),
    "syntax": ("syntax:command", "SyntaxError: invalid syntax (broken_syntax.py, line 1)"),
    "old": ("old:command", "cannot import name 'NoSuchName' from 'packit_sim'"),
    "ends": ("ends:command", "it ends the program"),
    "number": ("works:NUMBER", "TypeError: 5 is not a callable object"),
    "nameless": ("works:nothing", "has no attribute 'nothing'"),
    "nowhere": ("nowhere:command", "its imports need broken_nowhere, which is not installed"),
}
"""Entry points that can't be used: their objects, and the reasons."""


@pytest.fixture(name="package")
def _package(tmp_path: Path) -> Path:
    """A folder in which a package with broken entry points is installed."""
    for name, text in MODULES.items():
        (tmp_path / f"broken_{name}.py").write_text(text)
    metadata = tmp_path / "broken-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    objects = {name: f"broken_{found}" for name, (found, _) in COMMANDS.items()}
    commands = "\n".join(f"{name} = {found}" for name, found in objects.items())
    (metadata / "entry_points.txt").write_text(
        f"[packit_sim.commands]\n{commands}\nworks = broken_works:command\n"
        "[packit_sim.shape_policies]\nabsent = broken_nowhere:Policy\n"
        "garbled = broken_syntax:Policy\n"
        "[packit_sim.shape_sources]\ngarbled = broken_syntax:Source\n"
    )
    return tmp_path


def packit(package: Path, *words: str, **env: str) -> subprocess.CompletedProcess[str]:
    code = "import sys; sys.argv[0] = 'packit'; from packit_sim.__main__ import main; main()"
    return python(package, code, *words, **env)


def python(package: Path, code: str, *words: str, **env: str) -> subprocess.CompletedProcess[str]:
    """Run code where the package is installed: a process finds entry points once."""
    path = os.pathsep.join([str(package), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        env={**os.environ, "PYTHONPATH": path, **env},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_help_names_commands_that_can_not_be_used(package: Path) -> None:
    shown = packit(package, "--help")
    assert shown.returncode == 0
    assert "  works  Print a word." in shown.stdout and "  selftest" in shown.stdout
    warnings = shown.stderr.splitlines()
    assert len(warnings) == len(COMMANDS)
    for warning, name in zip(warnings, sorted(COMMANDS), strict=True):
        assert warning.startswith(f"warning: the command {name!r} of broken can't be used: ")
        assert COMMANDS[name][1] in warning
        assert f"  {name}" not in shown.stdout


@pytest.mark.parametrize("name", ["number", "syntax"])
def test_a_command_that_can_not_be_used_is_one_error(package: Path, name: str) -> None:
    failed = packit(package, name)
    assert failed.returncode == 2 and not failed.stdout
    prefix = f"error: the command {name!r} of broken can't be used: "
    assert failed.stderr.startswith(prefix) and failed.stderr.count("\n") == 1


def test_the_shell_completes_the_other_commands(package: Path) -> None:
    env = {"_PACKIT_COMPLETE": "complete_bash", "COMP_WORDS": "packit ", "COMP_CWORD": "1"}
    completed = packit(package, **env)
    assert not completed.stderr
    words = completed.stdout.split()
    assert "pack" in words and "works" in words and not COMMANDS.keys() & set(words)


AGENTS = """
from packit_sim.core.entry_points import EntryPointError
from packit_sim.game.episodes.episode import Stage
from packit_sim.game.episodes.policy_registry import installed_policies, load_policy
for one in installed_policies(Stage.SHAPE):
    print(one.form, one.summary)
try:
    load_policy(Stage.SHAPE, "garbled")
except EntryPointError as error:
    print(error)
"""


@pytest.mark.slow
def test_agents_are_listed_with_what_is_wrong(package: Path) -> None:
    lines = python(package, AGENTS).stdout.splitlines()
    (absent,) = (line for line in lines if line.startswith("absent "))
    assert "the shape policy 'absent' of broken can't be used: ModuleNotFoundError" in absent
    (listed,) = (line for line in lines if line.startswith("garbled "))
    assert "broken can't be used: SyntaxError" in listed
    assert any(line.startswith("random One of the valid shapes") for line in lines)
    assert lines[-1].startswith("the shape policy 'garbled' of broken can't be used: SyntaxError")


def test_a_shape_source_that_can_not_be_used_is_an_error(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(package)
    with pytest.raises(EntryPointError, match=r"shape source 'garbled' of broken .*SyntaxError"):
        ShapeLibrary.open(f"garbled:{package}")
    with pytest.raises(LibraryError, match="no shape library 'unknown:"):
        ShapeLibrary.open(f"unknown:{package}")


def test_an_entry_point_is_what_its_package_says(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(package)
    points = announced("packit_sim.commands")
    assert list(points) == sorted(points) and {"train", "works"} < points.keys()
    assert load(points["works"], "command").__doc__ == "Print a word."
    with pytest.raises(KeyboardInterrupt), usable(points["works"], "command"):
        raise KeyboardInterrupt
