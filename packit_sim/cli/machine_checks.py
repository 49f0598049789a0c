"""Checks of this machine: packages, renderers, cores, memory and caches.

Packages are imported in separate processes: one that is broken may crash its process.
"""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Literal

from packit_sim.core import compilation
from packit_sim.core.assets import assets_folder
from packit_sim.core.extras import EXTRAS
from packit_sim.core.version import __version__
from packit_sim.physics.convex.disk_cache import CACHE_VARIABLE, cache_folder
from packit_sim.render.bullet import egl_problem

Status = Literal["ok", "missing", "problem"]

PATIENCE = 60.0
"""Seconds that the import of a package may take; a few are usual."""

BASE = {
    "cachetools": "cachetools",
    "collada": "pycollada",
    "fast_simplification": "fast-simplification",
    "fcl": "python-fcl",
    "filelock": "filelock",
    "gymnasium": "gymnasium",
    "jinja2": "jinja2",
    "joblib": "joblib",
    "lazy_loader": "lazy-loader",
    "lib3mf": "lib3mf",
    "lxml": "lxml",
    "msgspec": "msgspec",
    "networkx": "networkx",
    "numba": "numba",
    "numpy": "numpy",
    "pebble": "pebble",
    "PIL": "pillow",
    "platformdirs": "platformdirs",
    "rich": "rich",
    "safetensors": "safetensors",
    "scipy": "scipy",
    "trimesh": "trimesh",
    "typer": "typer",
}
"""The distributions that everything needs, by the name that is imported."""

if sys.platform == "linux" and platform.machine() != "x86_64":
    del BASE["lib3mf"]  # it has no wheel there, and 3MF files are refused

PURPOSES = {
    "cascadio": "STEP files",
    "coacd": "convex pieces for physics; without it: --decomposition bisection",
    "imageio_ffmpeg": "MP4 films; GIF films need nothing",
    "matplotlib": "plots",
    "minari": "recorded demonstrations",
    "pybullet": "physics, and pictures by EGL",
    "pysat": "exact cover with polycubes",
    "python_calamine": "lists of parts in .xlsx",
    "ray": "--backend ray",
    "stable_baselines3": "packit train",
    "torch": "networks",
    "viser": "the viewer: packit view",
}
"""The purpose of each optional package, by the name that is imported."""

COMPILED = ("cascadio", "coacd", "pybullet", "ray", "torch")
"""Optional packages with compiled code that may not work here: they are imported."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

_IMPORTS = """
import importlib, json, os, sys
out = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)
for name in sys.argv[1:]:
    print(json.dumps((name, None)), file=out)
    try:
        importlib.import_module(name)
    except BaseException as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())
        print(json.dumps((name, why)), file=out)
print(json.dumps(("", None)), file=out)
"""
"""A script that imports packages; it prints each name before, so that the last one has crashed."""

MEMORY = Path("/proc/meminfo")
"""The file in which Linux reports the memory."""

MIN_MEMORY = 2 * 2**30
"""Bytes of free memory below which large shapes and several processes may not fit."""


@dataclass(frozen=True)
class MachineCheck:
    """The result of one check.

    Attributes
    ----------
    name : str
        The thing.
    status : Status
        "ok"; "missing" for a missing optional package; or "problem".
    found : str
        A version, a size or the problem.
    remedy : str
        An instruction; empty if it works.
    required : bool
        Whether everything needs it.
    """

    name: str
    status: Status
    found: str
    remedy: str = ""
    required: bool = False


def all_checks() -> list[MachineCheck]:
    """Run all checks, several at the same time.

    Returns
    -------
    list of MachineCheck
        The results, in the order of importance.
    """
    tasks: list[Callable[[], list[MachineCheck]]] = [
        _installation,
        _base,
        machine,
        _caches,
        lambda: [_egl()],
        lambda: [_browser()],
        *(partial(_optional, name) for name in PURPOSES),
    ]
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        return [check for found in pool.map(lambda task: task(), tasks) for check in found]


def _installation() -> list[MachineCheck]:
    """Look up versions, and check that the package's own files are there."""
    system = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    shapes = assets_folder() / "everyday"
    found = [
        MachineCheck("packit-sim", "ok", __version__, required=True),
        MachineCheck("Python", "ok", system, required=True),
    ]
    if shapes.is_dir():
        return [*found, MachineCheck("built-in shapes", "ok", "there", required=True)]
    remedy = "pip install --force-reinstall packit-sim"
    missing = MachineCheck(
        "built-in shapes", "problem", f"{shapes} is missing", remedy, required=True
    )
    return [*found, missing]


def _base() -> list[MachineCheck]:
    """Import what everything needs in another process, except what this one has imported."""
    problems = import_problems([name for name in BASE if name not in sys.modules])
    found = []
    for name, distribution in BASE.items():
        problem = problems.get(name)
        if problem is None:
            version = _version(distribution) or "of unknown version"
            found.append(MachineCheck(distribution, "ok", version, required=True))
        else:
            remedy = f"pip install --force-reinstall {distribution}"
            found.append(MachineCheck(distribution, "problem", problem, remedy, required=True))
    return found


def _optional(name: str) -> list[MachineCheck]:
    """Look for an optional package, and import it in another process if it may crash."""
    purpose = PURPOSES[name]
    install = f"pip install 'packit-sim[{EXTRAS[name]}]'"
    if importlib.util.find_spec(name) is None:
        return [MachineCheck(name, "missing", f"for {purpose}", install)]
    problem = import_problems((name,)).get(name) if name in COMPILED else None
    if problem is not None:
        return [
            MachineCheck(
                name, "problem", f"{problem}; for {purpose}", f"{install} --force-reinstall"
            )
        ]
    return [MachineCheck(name, "ok", _version(name) or "of unknown version")]


def import_problems(names: Sequence[str]) -> dict[str, str]:
    """Import packages one after another in another process; return the problems by name."""
    problems: dict[str, str] = {}
    rest = list(names)
    while rest:
        ended, output = _run([sys.executable, "-P", "-c", _IMPORTS, *rest])
        lines = [json.loads(line) for line in output.splitlines()]
        problems |= {name: f"can't be imported: {why}" for name, why in lines if why}
        begun = [name for name, why in lines if why is None]
        if begun and begun[-1] == "":
            break
        crashed = begun[-1] if begun else rest[0]
        problems[crashed] = f"its import {ended}"
        rest = rest[rest.index(crashed) + 1 :]
    return problems


def _run(command: Sequence[str]) -> tuple[str, str]:
    """Run a command without input; return how it ended, after "it", and what it printed."""
    try:
        run = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=PATIENCE,
        )
    except subprocess.TimeoutExpired as error:
        return f"takes more than {PATIENCE:g} s", (error.stdout or b"").decode(errors="replace")
    except OSError as error:
        return f"does not start: {error}", ""
    return f"ends with status {run.returncode}", run.stdout.decode(errors="replace")


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def machine() -> list[MachineCheck]:
    """Look up the cores and the memory, all of which only Linux reports."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cores = MachineCheck("cores", "ok", f"{usable} usable of {os.cpu_count()}")
    if not MEMORY.is_file():
        return [cores, MachineCheck("memory", "ok", "unknown: this system has no /proc/meminfo")]
    fields = dict(re.findall(r"(\w+):\s+(\d+) kB", MEMORY.read_text()))
    total, free = (1024 * int(fields[name]) for name in ("MemTotal", "MemAvailable"))
    text = f"{size_text(free)} free of {size_text(total)}"
    if free >= MIN_MEMORY:
        return [cores, MachineCheck("memory", "ok", text)]
    remedy = "end other programs, or choose --workers 1"
    return [cores, MachineCheck("memory", "problem", text, remedy)]


def _caches() -> list[MachineCheck]:
    """Look up the folders of compiled code and of cached results."""
    kernels = compilation.kernel_folder()
    if kernels is None:
        first = MachineCheck(
            "compiled engine",
            "problem",
            "no folder is writable: every process compiles again",
            "set NUMBA_CACHE_DIR to a folder that is writable",
        )
    else:
        package = Path(__file__).parents[1]
        root = package if kernels.is_relative_to(package) else kernels.parent
        first = MachineCheck("compiled engine", "ok", _content(root, "*.nb[ci]"))
    folder = cache_folder()
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    if not os.access(there, os.W_OK):
        remedy = f"make it writable, or set {CACHE_VARIABLE} to another folder"
        return [first, MachineCheck("cache", "problem", f"{folder} is not writable", remedy)]
    free = f"{size_text(shutil.disk_usage(there).free)} free on its disk"
    return [first, MachineCheck("cache", "ok", f"{_content(folder, '*.npz')}; {free}")]


def _content(folder: Path, pattern: str) -> str:
    """Describe the files in a folder."""
    sizes = [file.stat().st_size for file in folder.rglob(pattern)] if folder.is_dir() else []
    return f"{folder}: {len(sizes)} files, {size_text(sum(sizes))}"


def _egl() -> MachineCheck:
    problem = egl_problem()
    if problem is None:
        return MachineCheck("EGL", "ok", "draws pictures")
    if importlib.util.find_spec("pybullet") is None:
        remedy = "pip install 'packit-sim[physics]'"
    else:
        remedy = "apt install libegl1 libgl1-mesa-dri"
    return MachineCheck("EGL", "missing", f"{problem}; pictures are drawn in software", remedy)


def _browser() -> MachineCheck:
    for name in BROWSERS:
        if path := shutil.which(name):
            ended, output = _run([path, "--version"])
            version = output.strip()
            if version:
                return MachineCheck("Chromium", "ok", version)
            return MachineCheck(
                "Chromium", "problem", f"{path} --version {ended}", "install it again"
            )
    return MachineCheck(
        "Chromium", "missing", "for tests of pages, and to print them", "apt install chromium"
    )


def size_text(count: float) -> str:
    """Format a number of bytes, with a unit."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"
