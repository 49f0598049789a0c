"""Run the tests on mutants: in a copy of the source, by a process that forks for each mutant.

The process has imported all libraries, but nothing of ours. It writes a mutant to the copy, forks,
and the child runs the tests that execute the mutated line, until one fails. Compiled kernels stay
cached: only those of the mutated module, and of modules that call them, are compiled again.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import json
import os
import resource
import select
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

COPIED = ("packit_sim", "agents", "assets", "benchmarks", "campaigns", "docs", "scripts", "tests")

MEMORY = 8 << 30
"""Bytes of address space that a mutant may use."""

COMPILATION = 300.0
"""Seconds of processor time that the first tests may take longer because of compilation."""

SLACK = 5.0
"""A test may take this many times as long as without a mutant, and as many seconds more."""

_OPTIONS = ("-n0", "-x", "-q", "--no-header", "-pno:cacheprovider", "-mnot slow")
_REWRITTEN = "-Wignore::pytest.PytestAssertRewriteWarning"


@dataclass(frozen=True)
class Outcome:
    """What the tests say of a mutant.

    Parameters
    ----------
    outcome : str
        "killed", "timeout" (which counts as killed) or "survived".
    test : str
        The test that failed or did not end; empty if the mutant survived, or broke an import.
    tests : int
        Number of tests that were run.
    """

    outcome: str
    test: str
    tests: int


@dataclass(frozen=True)
class Baseline:
    """What the tests do without a mutant.

    Parameters
    ----------
    seconds : dict
        Processor time by the tests that pass.
    lines : dict
        Tests by module and line; the line 0 has all tests that execute anything of the module.
    libraries : list of str
        Third-party modules that the tests import.
    """

    seconds: dict[str, float]
    lines: dict[str, dict[int, list[str]]]
    libraries: list[str]

    @classmethod
    def read(cls, file: Path) -> Baseline:
        found = json.loads(file.read_text())
        lines = {
            module: {int(line): tests for line, tests in own.items()}
            for module, own in found["lines"].items()
        }
        return cls(found["seconds"], lines, found["libraries"])


def copy_source(root: Path, copy: Path) -> None:
    """Copy the source with its caches of compiled kernels, which are valid if times are kept."""
    for name in COPIED:
        shutil.copytree(root / name, copy / name, symlinks=True)
    for file in root.iterdir():
        if file.is_file() and file.name != ".git":
            shutil.copy2(file, copy)


def measure(copy: Path, modules: Sequence[str], files: Sequence[str]) -> Baseline:
    """Run tests in a copy without a mutant, in a child process, unless that was done before."""
    result = copy / "baseline.json"
    if not result.exists():
        child = os.fork()
        if child == 0:
            with _child(copy, copy / "baseline.log"):
                _measure(copy, modules, files, result)
        os.waitpid(child, 0)
    return Baseline.read(result)


def _measure(copy: Path, modules: Sequence[str], files: Sequence[str], result: Path) -> None:
    import coverage
    import pytest

    watched = [str(copy / module) for module in modules]
    measured = coverage.Coverage(data_file=None, config_file=False, include=watched)
    seconds: dict[str, float] = {}
    failed = set()

    class Plugin:
        @pytest.hookimpl(wrapper=True)
        def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
            measured.switch_context(item.nodeid)
            started = time.process_time()
            yield
            seconds[item.nodeid] = time.process_time() - started

        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed or report.skipped:
                failed.add(report.nodeid)

    options = [option for option in _OPTIONS if option != "-x"]
    measured.start()
    pytest.main([*options, f"--basetemp={copy}/temporary", *files], plugins=[Plugin()])
    measured.stop()
    data = measured.get_data()
    lines = {}
    for module in modules:
        own = data.contexts_by_lineno(str(copy / module))
        by_line = {line: sorted({*tests} & {*seconds} - failed) for line, tests in own.items()}
        by_line = {line: tests for line, tests in by_line.items() if tests}
        by_line[0] = sorted({test for tests in by_line.values() for test in tests})
        lines[module] = by_line
    libraries = [
        name
        for name, module in sorted(sys.modules.items())
        if "site-packages" in (getattr(module, "__file__", None) or "")
    ]
    passed = {test: round(own, 3) for test, own in seconds.items() if test not in failed}
    result.write_text(json.dumps({"seconds": passed, "lines": lines, "libraries": libraries}))


def import_libraries(names: Sequence[str]) -> None:
    """Import third-party modules once, for all children."""
    for name in names:
        with contextlib.suppress(Exception):
            importlib.import_module(name)


def kernel_modules(copy: Path, module: str) -> list[str]:
    """List the modules whose compiled kernels contain code of a module, itself first."""
    importers: dict[str, set[str]] = {}
    for file in sorted(copy.glob("packit_sim/**/*.py")) + sorted(copy.glob("agents/**/*.py")):
        text = file.read_text()
        if "from packit_sim.core.compilation import " in text:
            name = file.relative_to(copy).as_posix()
            for found in _compiled_imports(ast.parse(text)):
                importers.setdefault(found, set()).add(name)
    reached = [module]
    for name in reached:
        reached += sorted(importers.get(name, set()) - set(reached))
    return reached


def _compiled_imports(tree: ast.Module) -> Iterator[str]:
    """List the modules whose functions and constants a module imports; types are not compiled."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [alias.name for alias in node.names if not alias.name[:2].istitle()]
            if names:
                yield node.module.replace(".", "/") + ".py"


@contextlib.contextmanager
def mutated(copy: Path, module: str, text: str) -> Iterator[None]:
    """Write a mutant to the copy; afterwards, restore the file and its compiled kernels."""
    for file in (copy / module, *_caches(copy, module)):
        kept = copy / "kept" / file.relative_to(copy)
        kept.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, kept)
    (copy / module).write_text(text)
    try:
        yield
    finally:
        restore(copy)


def restore(copy: Path) -> None:
    """Restore what a mutant changed in the copy, also after a kill."""
    for kept in sorted((copy / "kept").rglob("*.py")):
        for cache in _caches(copy, kept.relative_to(copy / "kept").as_posix()):
            cache.unlink()
    for kept in sorted((copy / "kept").rglob("*.*")):
        os.replace(kept, copy / kept.relative_to(copy / "kept"))


def _caches(copy: Path, module: str) -> list[Path]:
    """List the files of compiled kernels that contain code of a module."""
    return [
        cache
        for name in map(Path, kernel_modules(copy, module))
        for cache in (copy / name.parent).glob(f"__pycache__/{name.stem}.*.nb[ic]")
    ]


def run(copy: Path, tests: Sequence[str], seconds: dict[str, float]) -> Outcome:
    """Run tests in a child process, until one fails or takes too long.

    A mutant without tests has survived: pytest would collect all, and fail since none is left.
    """
    if not tests:
        return Outcome("survived", "", 0)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        with _child(copy, copy / "mutant.log"):
            _run(copy, tests, writer)
    os.close(writer)
    try:
        return _watch(child, reader, seconds)
    finally:
        os.close(reader)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _run(copy: Path, tests: Sequence[str], writer: int) -> None:
    import pytest

    order = {test: n for n, test in enumerate(tests)}

    def say(event: str, test: str) -> None:
        os.write(writer, f"{event} {test}\n".encode())

    class Plugin:
        def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
            items[:] = sorted(
                (item for item in items if item.nodeid in order), key=lambda i: order[i.nodeid]
            )

        def pytest_runtest_logstart(self, nodeid: str) -> None:
            say("start", nodeid)

        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                say("failed", report.nodeid)

    files = sorted({test.split("::")[0] for test in tests})
    found = pytest.main(
        [*_OPTIONS, _REWRITTEN, f"--basetemp={copy}/temporary", *files], plugins=[Plugin()]
    )
    say("survived" if found == pytest.ExitCode.OK else "failed", "")


@contextlib.contextmanager
def _child(copy: Path, log: Path) -> Iterator[None]:
    """Set up a child process that runs tests in a copy, and end it."""
    try:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        os.chdir(copy)
        roots = [str(copy), str(copy / "agents")]
        os.environ.update(
            PYTHONPATH=os.pathsep.join(roots),
            HOME=str(copy / "home"),
            XDG_CACHE_HOME=str(copy / "home"),
        )
        sys.path[:0] = roots
        with open(log, "w") as file:
            for stream in (1, 2):
                os.dup2(file.fileno(), stream)
            yield
    finally:
        sys.stdout.flush()
        os._exit(0)


def _watch(child: int, reader: int, seconds: dict[str, float]) -> Outcome:
    """Read what a child says, until a test fails or takes too long."""
    test, tests, unread = "", 0, b""
    allowance = COMPILATION
    started = _processor_time(child)
    while True:
        if not select.select([reader], [], [], 1.0)[0]:
            taken = _processor_time(child) - started
            if taken > SLACK + SLACK * seconds.get(test, 0.0) + allowance:
                return Outcome("timeout", test, tests)
            continue
        got = os.read(reader, 65536)
        if not got:  # a crash, such as a segmentation fault
            return Outcome("killed", test, tests)
        *lines, unread = (unread + got).split(b"\n")
        for line in lines:
            event, _, name = line.decode().partition(" ")
            if event == "start":
                now = _processor_time(child)
                allowance = max(0.0, allowance - (now - started))
                test, tests, started = name, tests + 1, now
            else:
                return Outcome("killed" if event == "failed" else event, name, tests)


def _processor_time(child: int) -> float:
    """Return the processor time of a process and of its children that have ended."""
    try:
        fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
