"""Sentences of the security page that no other test holds: its limits, and what code may not do."""

import ast
import re
import stat
from functools import cache
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

from packit_sim.cli.viewer_commands import view_command, workbench_command
from packit_sim.core import typed_json
from packit_sim.core.files import replace_text
from packit_sim.game.envs import minari_format
from packit_sim.game.evaluation import transition_files
from packit_sim.geometry import lattice, quantized
from packit_sim.libraries import folder, mesh_limits, step_files
from packit_sim.libraries.importer import ImportSettings
from packit_sim.parts.filling import preparation
from packit_sim.parts.packings import bounds, validity
from packit_sim.parts.reading import limits, prepared, tables
from packit_sim.parts.workbench import uploads, workbench
from packit_sim.parts.workbench.workbench import Workbench
from packit_sim.robot import gantry, trajectory
from packit_sim.web import http_server, origins
from tests.doc_pages import DOCS, ROOT

PAGE = (DOCS / "trust" / "security.md").read_text()

GIB, MIB = 2**30, 2**20

LIMITS = (
    (f"files of {mesh_limits.MAX_BYTES // GIB} GiB", "mesh files"),
    (f"{mesh_limits.MAX_TRIANGLES // 10**6} million triangles", "mesh files"),
    (f"{mesh_limits.MAX_INSTANCES:,} instances", "mesh files"),
    (f"{mesh_limits.MAX_INSTANCES:,} materials of one object, or solids", "mesh files"),
    (f"{mesh_limits.MAX_COMPONENTS:,} components", "mesh files"),
    (f"{folder.MAX_ENTRIES:,} files in a folder", "mesh files"),
    (f"{ImportSettings().memory // GIB} GiB of memory", "mesh files"),
    (f"{ImportSettings().timeout:g} s per mesh", "mesh files"),
    (f"{step_files.SECONDS} s of CPU time", "STEP files"),
    (f"{step_files.MEMORY // GIB} GiB of addresses", "STEP files"),
    (f"{quantized.MAX_COMPRESSION} times the size", "stored meshes"),
    (f"{vars(workbench)['_MAX_JSON'] // MIB} MiB; {uploads.MAX_FILES} files", "orders"),
    (f"integers of {typed_json.MAX_DIGITS} digits", "packs, results"),
    (f"boxes of {lattice.MAX_CELLS} cells a side", "packs, results"),
    (f"{tables.MAX_BYTES // MIB} MiB, also unpacked", "manifests of parts"),
    (f"{tables.MAX_ROWS:,} rows, {tables.MAX_COLUMNS:,} columns", "manifests of parts"),
    (f"{tables.MAX_CELLS // 10**6} million cells", "manifests of parts"),
    (f"counts up to {bounds.MAX_COUNT:,}", "manifests of parts"),
    (f"{validity.MAX_PROBLEMS:,} problems", "`packing.json`"),
    (f"{trajectory.MAX_STEPS:,} steps", "trajectories of an arm"),
    (f"{gantry.MOST_BOXES} boxes of {gantry.SMALLEST:.0e}".replace("e-0", "e-"), "an arm's URDF"),
    (f"to {gantry.FARTHEST:,.0f} m", "an arm's URDF"),
    (f"{minari_format.MAX_COMPRESSION:,} times the size", "recordings"),
    (f"{transition_files.MAX_BYTES // GIB} GiB of arrays in a shard", "transitions"),
    (f"at most {prepared.MAX_TRIANGLES // 10**6} million triangles, all parts", "A part to pack"),
    (f"together have {preparation.MAX_TRIANGLES // 10**6} million", "A part to pack"),
    (f"It has at most {origins.MAX_CONNECTIONS} connections", "- It has"),
    (f"At most {origins.MAX_CONNECTIONS} connections are open", "- At most"),
    (f"silent for {http_server.SILENT_SECONDS:g} seconds", "- At most"),
    (f"at most {uploads.MAX_BYTES // MIB} MiB, all together", "- A file that is sent"),
    (f"{uploads.MAX_BYTES_TOGETHER // GIB} GiB in {uploads.MAX_FILES} files", "- A file"),
)


@pytest.mark.parametrize(("limit", "start"), LIMITS)
def test_the_page_has_the_limits_of_the_code(limit: str, start: str) -> None:
    lines = [each.removeprefix("| ") for each in PAGE.splitlines()]
    assert any(each.startswith(start) and limit in each for each in lines), limit


BOUNDS = {
    "sides and lengths of meshes": bounds.LENGTHS,
    "clearances": bounds.DISTANCES,
    "counts of a part, boxes of a size": bounds.COUNTS,
    "priorities": bounds.PRIORITIES,
    "values": bounds.VALUES,
    "masses": bounds.MASSES,
    "loads": bounds.LOADS,
    "shares of a balance": limits.SHARES,
    "densities": bounds.DENSITIES,
    "times to search": bounds.SECONDS,
    "passes of a search": bounds.ITERATIONS,
    "seeds of `pack` and `nest`": bounds.SEEDS,
}


@pytest.mark.parametrize("name", BOUNDS)
def test_the_page_has_the_bounds_of_the_code(name: str) -> None:
    (line,) = (each for each in PAGE.splitlines() if each.startswith(f"| {name} |"))
    text = line.replace(",", "").replace("g/cm3", "").replace("2<sup>63</sup> - 1", str(2**63 - 1))
    stated = [float(each) for each in re.findall(r"-?\d+(?:e[+-]?\d+)?", text)]
    if name == "times to search":
        assert "above 0" in line
        stated = [0.0, *stated[-1:]]
    assert stated == [float(BOUNDS[name].low), float(BOUNDS[name].high)]


@cache
def calls() -> list[tuple[str, str, ast.Call]]:
    """List each call in the code: its file, the name of what is called, and the call."""
    files = [each for root in ("packit_sim", "agents") for each in (ROOT / root).rglob("*.py")]
    return [
        (file.relative_to(ROOT).as_posix(), ast.unparse(node.func), node)
        for file in files
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Call)
    ]


PICKLES = {"packit_sim/core/parallel.py"}
"""Reads the pickles of worker processes."""

PROGRAMS = {
    "packit_sim/libraries/step_files.py": "Python",
    "packit_sim/physics/convex/decomposition.py": "Python, for CoACD",
    "packit_sim/render/bullet.py": "Python, a probe of OpenGL",
    "packit_sim/cli/compiling.py": "`packit` itself, for `packit doctor --compile`",
    "packit_sim/cli/machine_checks.py": "Python, a check of `packit doctor`",
    "packit_sim/cli/local_pages.py": "the browser",
}
"""The modules that start programs; films start ffmpeg by imageio-ffmpeg."""


def test_no_file_can_hold_code() -> None:
    names = {(file, name) for file, name, _ in calls()}
    assert not {each for each in names if each[1] in ("eval", "exec", "compile", "__import__")}
    readers = {
        file for file, name in names if re.match(r"(c?loud)?pickle\.loads?|joblib\.load", name)
    }
    assert readers == PICKLES
    for file, name, call in calls():
        settings = {each.arg: ast.unparse(each.value) for each in call.keywords}
        if name == "np.load":
            assert settings.get("allow_pickle", "False") == "False", file
        if name == "torch.load":
            assert settings["weights_only"] == "True", file
    assert not signature(np.load).parameters["allow_pickle"].default


def test_only_these_programs_are_started() -> None:
    start = re.compile(r"subprocess\.\w+|os\.(system|popen|exec\w*|spawn\w*)|webbrowser\.open")
    assert {file for file, name, _ in calls() if start.fullmatch(name)} == set(PROGRAMS)
    assert all(
        each.arg != "shell"
        for _, name, call in calls()
        if "subprocess" in name
        for each in call.keywords
    )


def test_files_are_replaced_with_mode_644_and_links_stay(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    target, link = tmp_path / "far" / "target.txt", tmp_path / "link.txt"
    target.write_text("before")
    target.chmod(0o600)
    link.symlink_to(target)
    replace_text(link, "after")
    assert link.is_symlink() and target.read_text() == "after"
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    assert [each.name for each in (tmp_path / "far").iterdir()] == ["target.txt"]


def test_pages_listen_on_this_machine_alone() -> None:
    with Workbench() as bench:
        assert bench.address.startswith("http://127.0.0.1:")
    for command in (view_command, workbench_command):
        assert signature(command).parameters["host"].default == origins.LOOPBACK


def test_each_test_that_the_page_names_exists() -> None:
    named = set(re.findall(r"`(test_\w+\.py)`", PAGE))
    known = {file.name for file in (ROOT / "tests").glob("test_*.py")}
    assert len(named) > 10 and named <= known
