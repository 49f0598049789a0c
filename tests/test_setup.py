"""A set-up that fails says why, and leaves no half-made environment."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def script(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def fake_python(path: Path, version: str, pip: int) -> Path:
    """A Python that says its version, and creates an environment whose pip ends with a status."""
    script(
        path,
        f"""case "$*" in
        *version_info*) echo {version} ;;
        "-m venv "*) mkdir -p "$3/bin" && printf '#!/bin/sh\\nexit {pip}\\n' > "$3/bin/python"
            chmod +x "$3/bin/python" ;;
        esac""",
    )
    return path


def set_up(folder: Path, python: Path | str, extras: str = "") -> subprocess.CompletedProcess[str]:
    (folder / "scripts").mkdir(exist_ok=True)
    for name in ("setup.sh", "slim-pybullet.sh"):
        shutil.copy(ROOT / "scripts" / name, folder / "scripts")
    return subprocess.run(
        ["bash", "scripts/setup.sh", str(python), extras],
        cwd=folder,
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.mark.parametrize("version", ["3.10", "3.15"])
def test_another_python_is_refused(version: str, tmp_path: Path) -> None:
    done = set_up(tmp_path, fake_python(tmp_path / "python", version, 0))
    assert done.returncode == 1 and not (tmp_path / ".venv").exists()
    assert f"is Python {version}, PackIt-Sim needs 3.11 to 3.14" in done.stderr
    assert done.stderr.count("\n") == 1


def test_no_python_is_one_line(tmp_path: Path) -> None:
    done = set_up(tmp_path, "no-such-python")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "no-such-python does not run: install Python 3.11 to 3.14" in done.stderr


def test_a_failed_installation_leaves_nothing(tmp_path: Path) -> None:
    done = set_up(tmp_path, fake_python(tmp_path / "python", "3.13", 3), "dev")
    assert done.returncode != 0 and not (tmp_path / ".venv").exists()
    assert "is ready" not in done.stdout


def test_an_environment_that_was_there_is_kept(tmp_path: Path) -> None:
    script(tmp_path / ".venv" / "bin" / "python", "exit 3")
    done = set_up(tmp_path, fake_python(tmp_path / "python", "3.11", 0))
    assert done.returncode != 0 and (tmp_path / ".venv" / "bin" / "python").exists()


@pytest.mark.parametrize(
    ("version", "extras", "said"),
    [
        ("3.11", "", "into .venv: 0.6 GB"),
        ("3.11", "dev", "with the extras dev into .venv: 2.5 GB with a CPU build of torch"),
        ("3.13", "physics", "PyBullet has no wheel for Python 3.13: compiling it takes"),
    ],
)
def test_it_says_what_it_will_install(version: str, extras: str, said: str, tmp_path: Path) -> None:
    done = set_up(tmp_path, fake_python(tmp_path / "python", version, 0), extras)
    assert (done.returncode, done.stderr) == (0, "")
    assert said in done.stdout and ".venv is ready" in done.stdout


def test_what_pybullet_does_not_need_is_removed(tmp_path: Path) -> None:
    packages = tmp_path / "lib" / "python3.11" / "site-packages"
    needed = ("pybullet_data/franka_panda/panda.urdf", "pybullet_utils/bullet.py")
    for name in (*needed, "pybullet_data/r2d2.urdf", "pybullet_envs/gym.py"):
        (packages / name).parent.mkdir(parents=True, exist_ok=True)
        (packages / name).touch()
    script = ROOT / "scripts" / "slim-pybullet.sh"
    subprocess.run(["bash", str(script), str(tmp_path)], check=True, timeout=60)
    left = sorted(path.relative_to(packages) for path in packages.rglob("*") if path.is_file())
    assert left == [Path(name) for name in needed]
