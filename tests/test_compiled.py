"""Kernels in read-only installations and within their arrays, and messages during compilation."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import packit_sim
from packit_sim.geometry import rotations

SCRIPT = """
import numpy as np
from packit_sim.geometry.bits import turning_swaps
from packit_sim.geometry.word_kernels import turn_words
words = np.array([1], dtype=np.uint64)
turn_words(words, turning_swaps(1))
print(int(words[0]))
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder with a copy of the package where nothing can be compiled to."""
    source = Path(packit_sim.__file__).parent
    copy = tmp_path / "site-packages" / "packit_sim"
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [copy, *(each.parent for each in copy.glob("*/__init__.py"))]:
        (folder / "__pycache__").write_text("a file, so that no folder can be created here")
    return copy.parent


def run(installed: Path, cache_home: Path) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(installed), "XDG_CACHE_HOME": str(cache_home)}
    return subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=environment,
        cwd=installed,
        capture_output=True,
        text=True,
        check=True,
    )


@pytest.mark.slow
def test_the_users_cache_serves_where_the_installation_cannot(
    installed: Path, tmp_path: Path
) -> None:
    first, second = (run(installed, tmp_path / "cache") for _ in range(2))
    assert first.stdout == second.stdout
    assert "compiling the placement engine" in first.stderr
    assert second.stderr == "", "it came from the disk, and there is nothing to say"
    assert list((tmp_path / "cache").rglob("*.nbc"))


@pytest.mark.slow
def test_where_nothing_can_be_kept_it_compiles_each_time_and_says_so(
    installed: Path, tmp_path: Path
) -> None:
    corner = np.zeros((4, 4, 4), dtype=bool)
    corner[0, 0, 0] = True
    turned = int(rotations.turn_array(corner, 1).ravel().argmax())
    no_folder = tmp_path / "cache"
    no_folder.write_text("a file")
    for _ in range(2):
        done = run(installed, no_folder)
        assert int(done.stdout) == 1 << turned
        assert done.stderr.count("compiling the placement engine") == 1


ONE = """
from packit_sim.core.compilation import kernel
@kernel
def one():
    return {}
"""

FACE = """
from packit_sim.one import one
from packit_sim.other import other
"""

TWO = """
from packit_sim.core.compilation import kernel
from packit_sim.face import one
@kernel
def two():
    return one() + 1
"""


RUN_TWO = "from packit_sim.two import two; print(two(), len(two.stats.cache_hits))"
"""Prints a number of the kernel, and how many of its compiled forms came from the disk."""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with a kernel that calls one of another module, behind a face."""
    package = tmp_path / "packit_sim"
    shutil.copytree(Path(packit_sim.__file__).parent / "core", package / "core")
    (package / "__init__.py").touch()
    for name, text in {
        "one": ONE.format(1),
        "other": "other = 0",
        "face": FACE,
        "two": TWO,
    }.items():
        (package / f"{name}.py").write_text(text)
    return package


def test_a_kernel_is_compiled_again_only_when_one_that_it_calls_changes(package: Path) -> None:
    """Not when another name of the face changes that it imports this one from.

    Changed files are longer: Python compares sizes and whole seconds before it reads bytecode.
    """
    folder, found = package.parent, []
    for value, other in ((1, 0), (1, 10), (50, 10)):
        (package / "one.py").write_text(ONE.format(value))
        (package / "other.py").write_text(f"other = {other}")
        done = subprocess.run(
            [sys.executable, "-c", RUN_TWO],
            env=os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder)},
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        found.append(tuple(map(int, done.stdout.split())))
    assert found == [(2, 0), (2, 1), (51, 0)]


MANY = """
import sys
from subprocess import PIPE, Popen
running = [Popen([sys.executable, "-c", sys.argv[1]], stdout=PIPE, stderr=PIPE, text=True)
           for _ in range(4)]
for each in running:
    out, err = each.communicate()
    print("compiled" in out, "compiling" in err, each.returncode)
"""

COUNTED = f"""
from numba.core import event
class Listener(event.Listener):
    def on_start(self, event):
        if event.data["dispatcher"].py_func.__name__ == "turn_words":
            print("compiled")
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())
{SCRIPT}
"""


@pytest.mark.slow
def test_processes_that_start_together_compile_and_announce_once(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", MANY, COUNTED],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [code for _, _, code in rows] == ["0"] * 4, done.stdout
    assert [compiled for compiled, _, _ in rows].count("True") == 1
    assert [announced for _, announced, _ in rows].count("True") == 1


WORKERS = """
import numpy as np
from packit_sim.core.parallel import Workers
def turn(word):
    from packit_sim.geometry.bits import turning_swaps
    from packit_sim.geometry.word_kernels import turn_words
    words = np.array([word], dtype=np.uint64)
    turn_words(words, turning_swaps(1))
    return int(words[0])
with Workers(3) as workers:
    print(sum(workers.map(turn, [(n,) for n in range(12)])))
"""


@pytest.mark.slow
def test_kernels_of_workers_are_announced_once_by_the_process_that_starts_them(
    tmp_path: Path,
) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = [
        subprocess.run(
            [sys.executable, "-c", WORKERS],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]
    assert done[0].stdout == done[1].stdout
    assert [each.stderr.count("compiling the placement engine") for each in done] == [1, 0]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_no_kernel_leaves_its_arrays(tmp_path: Path) -> None:
    """Compiled code does not check indices, unless numba is asked to, which is slow."""
    names = ("voxels", "nofit", "containment", "insertion", "off_grid", "box", "placement")
    files = [f"tests/test_{name}.py" for name in names]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-n0", "-q", "-x", "-m", "not slow", *files],
        env=os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout[-3000:]
