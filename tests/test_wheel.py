"""Built distributions: the sdist builds the wheel, and the wheel works without a checkout."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

USE = """
import packit_agents
import packit_sim
from packit_sim import Box, Item, ShapeLibrary
from packit_sim.game.episodes.agents import Agent

assert not packit_sim.__file__.startswith({root!r}), packit_sim.__file__
library = ShapeLibrary.open("everyday")
item = Item(library[library.ids[0]], scale=0.25)
box = Box()
box.place(item, box.blbf(item))
assert len(box.placed) == 1
Agent.from_name("largest-first/aligned/blbf"), Agent.from_name("random/random/random")
"""


def run(*command: object, cwd: Path) -> str:
    """What a command prints; where it fails, that is the test's failure."""
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built from the sdist, built from the checkout."""
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, cwd=ROOT)
    (built,) = out.glob("*.whl")
    return built


def checked_out(folder: str) -> set[str]:
    """Files below a folder that are the project's, as paths relative to it."""
    if (ROOT / ".git").exists():
        options = ("--cached", "--others", "--exclude-standard", "-z")
        listed = run("git", "ls-files", *options, folder, cwd=ROOT).split("\0")
        files = [ROOT / name for name in listed if name and (ROOT / name).is_file()]
    else:
        files = [file for file in (ROOT / folder).rglob("*") if file.is_file()]
    found = {file.relative_to(ROOT / folder).as_posix() for file in files}
    return {name for name in found if "__pycache__" not in name}


def below(names: set[str], folder: str) -> set[str]:
    return {name.removeprefix(folder) for name in names if name.startswith(folder)}


@pytest.mark.slow
def test_the_wheel_claims_only_its_own_names_and_has_everything(wheel) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    version = wheel.name.split("-")[1]
    own = {"packit_command.py", "packit_sim", "packit_agents"}
    top = own | {f"packit_sim-{version}.dist-info"}
    assert {name.partition("/")[0] for name in names} == top
    assets = below(names, "packit_sim/assets/")
    assert assets == checked_out("assets")
    code = below(names, "packit_sim/") - {f"assets/{name}" for name in assets}
    assert code == checked_out("packit_sim")
    assert below(names, "packit_agents/") == checked_out("agents/packit_agents")
    assert {"py.typed", "__init__.py", "__init__.pyi"} <= code


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_sdist_has_neither_benchmarks_nor_campaigns_and_its_tests_are_found(
    wheel, tmp_path
) -> None:
    (sdist,) = wheel.parent.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.iterdir()
    assert not {"benchmarks", "campaigns"} & {path.name for path in unpacked.iterdir()}
    found = run(sys.executable, "-m", "pytest", "--collect-only", "-q", cwd=unpacked)
    assert "test_box.py" in found and "error" not in found.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_installed_wheel_packs_an_item(wheel, tmp_path) -> None:
    run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    python = tmp_path / "venv" / "bin" / "python"
    pip = (python, "-m", "pip", "--disable-pip-version-check")
    run(*pip, "install", "--constraint", ROOT / "constraints.txt", wheel, cwd=tmp_path)
    run(python, "-I", "-c", USE.format(root=str(ROOT)), cwd=tmp_path)
    assert "evaluate" in run(python.with_name("packit"), "--help", cwd=tmp_path)
