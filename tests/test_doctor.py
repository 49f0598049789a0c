"""`packit doctor`: what works, what is missing, and what to do."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

from packit_sim.cli import machine_checks
from packit_sim.cli.machine_checks import BASE, PURPOSES, MachineCheck, all_checks
from packit_sim.core.extras import EXTRAS
from tests.runs import run_packit

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]


@pytest.fixture(name="quick")
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the imports and the browser, which take seconds."""
    monkeypatch.setattr(machine_checks, "COMPILED", ())
    monkeypatch.setattr(machine_checks, "egl_problem", lambda: None)
    monkeypatch.setattr(machine_checks, "BROWSERS", ())


def test_all_required_packages_are_checked_and_all_optional_ones_have_an_extra() -> None:
    required = {re.split("[><;]", line)[0] for line in PROJECT["dependencies"]}
    assert set(BASE.values()) == required - {"pybullet"}
    assert PURPOSES.keys() <= EXTRAS.keys()


@pytest.mark.usefixtures("quick")
def test_a_working_machine_ends_with_0() -> None:
    done = run_packit("doctor", "--json")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert found["works"] is True
    by_name = {check["name"]: check for check in found["checks"]}
    for name in ("packit-sim", "Python", "built-in shapes", "numba", "cores", "memory", "cache"):
        assert by_name[name]["found"], name
    assert {check["status"] for check in found["checks"]} <= {"ok", "missing", "problem"}
    assert all((check["status"] == "ok") == (not check["remedy"]) for check in found["checks"])


def _check_nothing_but(*checks: MachineCheck):
    return lambda: [MachineCheck("packit-sim", "ok", "1", required=True), *checks]


def test_what_is_missing_has_a_remedy_in_the_table(monkeypatch) -> None:
    ray = MachineCheck("ray", "missing", "for --backend ray", "pip install 'packit-sim[cluster]'")
    monkeypatch.setattr("packit_sim.cli.machine_checks.all_checks", _check_nothing_but(ray))
    done = run_packit("doctor")
    assert done.returncode == 0
    text = "".join(done.stdout.split())
    assert "raymissing" in text and "packit-sim[cluster]" in text


def test_a_required_package_that_is_broken_ends_with_1(monkeypatch) -> None:
    numba = MachineCheck(
        "numba", "problem", "can't be imported", "pip install numba", required=True
    )
    monkeypatch.setattr("packit_sim.cli.machine_checks.all_checks", _check_nothing_but(numba))
    assert run_packit("doctor").returncode == 1
    done = run_packit("doctor", "--json")
    assert done.returncode == 1 and json.loads(done.stdout)["works"] is False


def test_packages_that_crash_hang_or_raise_are_distinguished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "packit_crash.py").write_text("import os; os.abort()")
    (tmp_path / "packit_raise.py").write_text("raise ImportError('no libX')")
    (tmp_path / "packit_loud.py").write_text("print('end')\nprint('failed packit_fine because')")
    (tmp_path / "packit_fine.py").write_text("")
    (tmp_path / "packit_hang.py").write_text("import time; time.sleep(60)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    names = ["packit_raise", "packit_crash", "packit_loud", "packit_fine"]
    assert machine_checks.import_problems(names) == {
        "packit_raise": "can't be imported: ImportError: no libX",
        "packit_crash": "its import ends with status -6",
    }
    monkeypatch.setattr(machine_checks, "PATIENCE", 0.5)
    problems = machine_checks.import_problems(["packit_hang"])
    assert problems == {"packit_hang": "its import takes more than 0.5 s"}


@pytest.mark.usefixtures("quick")
def test_a_cache_that_is_not_writable_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PACKIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(machine_checks.os, "access", lambda *_: False)
    (cache,) = (check for check in all_checks() if check.name == "cache")
    assert cache.status == "problem" and "PACKIT_CACHE" in cache.remedy and not cache.required


def test_little_memory_is_a_problem_and_other_systems_have_no_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "meminfo"
    monkeypatch.setattr(machine_checks, "MEMORY", file)
    assert [check.status for check in machine_checks.machine()] == ["ok", "ok"]
    file.write_text("MemTotal:  8000000 kB\nMemAvailable:  1000000 kB\n")
    memory = machine_checks.machine()[1]
    assert (memory.status, memory.found) == ("problem", "1.0 GB free of 8.2 GB")
    assert "--workers 1" in memory.remedy


def test_sizes_are_readable() -> None:
    assert [machine_checks.size_text(n) for n in (0, 999, 2_000, 3_500_000, 12e12)] == [
        *("0 B", "999 B", "2 kB", "4 MB", "12000.0 GB")
    ]
