"""Options and fixtures of all tests: how many examples are drawn, and from which seeds.

`--masks` and `--seed` are those of the slow test of full masks. Hypothesis has three profiles,
chosen by HYPOTHESIS_PROFILE: `quick` draws the same few examples on every run, `all` (of
`make test-all`) more from new seeds, and `thorough` ten times as many again.
"""

import hashlib
import logging
import os
import re
import shutil
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main
import typer.testing
from hypothesis import settings

from packit_sim.core import debugging
from packit_sim.geometry import shapes
from packit_sim.geometry.arrays import Floats
from packit_sim.libraries import importer
from packit_sim.render import bullet, renderers
from tests.runs import PoolOfNone

settings.register_profile("quick", deadline=None, max_examples=15, derandomize=True)
settings.register_profile("all", deadline=None, max_examples=100, print_blob=True)
settings.register_profile("thorough", deadline=None, max_examples=1000, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))

ROOT = Path(__file__).parents[1]

NOT_DISTRIBUTED = re.compile(
    r'^\s*(from|import) (benchmarks|campaigns)\b|"(benchmarks|campaigns)["/]', re.MULTILINE
)

collect_ignore = [
    file.name
    for file in (ROOT / "tests").glob("test_*.py")
    if not (ROOT / "benchmarks").is_dir()  # in an unpacked source distribution
    and NOT_DISTRIBUTED.search(file.read_text(encoding="utf-8"))
]

CHECKED = {
    *("test_box", "test_episode", "test_heuristics", "test_nofit", "test_off_grid", "test_online"),
    *("test_physics_env", "test_placement", "test_placements", "test_rollouts", "test_settling"),
}
"""The tests of state that is updated in steps: in these it is compared with state from scratch."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("packit")
    group.addoption("--masks", type=int, default=100, help="masks to hold against the oracle")
    group.addoption("--seed", type=int, default=0, help="what to draw those masks from")


def pytest_configure() -> None:
    """Build the command line once a process, not once a call: that takes 0.1 s.

    Let torch compute in one thread: several processes with more would take turns, and twice the
    time. Draw by software unless a test names the renderer: EGL takes a second to start. Hear
    Ctrl-C and the end of the terminal also where pytest runs in the background. What tests start
    inherits all this.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault(renderers.RENDERER_VARIABLE, "software")
    typer.main.get_command = typer.testing._get_command = cache(typer.main.get_command)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if (hangup := getattr(signal, "SIGHUP", None)) and signal.getsignal(hangup) == signal.SIG_IGN:
        signal.signal(hangup, signal.SIG_DFL)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "mask_seed" in metafunc.fixturenames:
        masks, seed = (metafunc.config.getoption(name) for name in ("--masks", "--seed"))
        metafunc.parametrize("mask_seed", [(seed, n) for n in range(masks)], ids=str)


@pytest.fixture(scope="module", autouse=True)
def checked_state(request: pytest.FixtureRequest) -> Iterator[None]:
    """State that is updated in steps is compared with state from scratch, here and in children.

    PACKIT_CHECK_STATE=1 compares in all tests, which takes twice as long in those of searches.
    """
    name = request.module.__name__.rpartition(".")[2]
    value = os.environ.get(debugging.CHECK_VARIABLE, str(int(name in CHECKED)))
    with pytest.MonkeyPatch.context() as patch, debugging.checking(value == "1"):
        patch.setenv(debugging.CHECK_VARIABLE, value)
        yield


@pytest.fixture(autouse=True)
def _loggers() -> Iterator[None]:
    """Restore the loggers that `-v` configures: other tests count the lines of a log."""
    loggers = [logging.getLogger(name) for name in ("packit_sim", "packit_agents")]
    before = [(logger.handlers, logger.level) for logger in loggers]
    yield
    for logger, (handlers, level) in zip(loggers, before, strict=True):
        logger.handlers = handlers
        logger.setLevel(level)


@pytest.fixture(scope="session", autouse=True)
def _volumes_once() -> Iterator[None]:
    """Measure the volume of a mesh once: that takes 20 ms, and checks of datasets do it anew."""
    measure, known = shapes.solid_volume_bounds, dict[bytes, tuple[float, float]]()

    def measured(triangles: Floats) -> tuple[float, float]:
        digest = hashlib.sha256(triangles.tobytes()).digest()
        if digest not in known:
            known[digest] = measure(triangles)
        return known[digest]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shapes, "solid_volume_bounds", measured)
        yield


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imports of meshes start no process."""
    monkeypatch.setattr(importer, "ProcessPool", PoolOfNone)


@pytest.fixture
def software(monkeypatch: pytest.MonkeyPatch) -> None:
    """The software renderer unless a test asks for more: it starts at once."""
    monkeypatch.setenv(renderers.RENDERER_VARIABLE, "software")


@pytest.fixture(params=["software", "egl"])
def renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Each renderer that starts here, set for the test."""
    name = str(request.param)
    if name == "egl" and bullet.egl_problem() is not None:
        pytest.skip("EGL does not start here")
    monkeypatch.setenv(renderers.RENDERER_VARIABLE, name)
    return name


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A headless browser that draws WebGL by software; closed soon, since no other event loop can
    run in the thread meanwhile.
    """
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("no Chromium: apt install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    flags.append("--enable-unsafe-swiftshader")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=flags)
        yield browser
        browser.close()
