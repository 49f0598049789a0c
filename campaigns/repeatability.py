"""Repeatability: the same seed gives the same bytes, however a command is run.

Runs `packit generate`, `evaluate`, `shapes import` and `train` with other numbers of workers, other
backends, other seeds of Python's hashes, and other versions of Python and NumPy, and compares what
they write. Each Python is a command of an environment in which PackIt-Sim is installed.

    python -m campaigns.repeatability --seed 1 --python "/tmp/a/bin/python" "/tmp/b/bin/python"
    python -m campaigns.repeatability --table   # write the table in docs/trust/repeatability.md
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import trimesh

from benchmarks.common import machine, markdown_table, write_json
from campaigns.common import argument_parser, read_results, write_into_page
from packit_sim.core.version import __version__

NAME = "repeatability"

COMMANDS = {
    "generate": "generate --packs 2 --pool 20 --population 60 --generations 3 --seed {seed}"
    " --workers {workers} --backend {backend} --out {out}/packs",
    "evaluate": "evaluate starter --tasks 6 --agent random/random/random"
    " --agent largest-first/aligned/blbf+mcts=4 --seed {seed} --workers {workers}"
    " --backend {backend} --out {out}/results.jsonl",
    "import": "shapes import folder:{meshes} --all --seed {seed} --workers {workers}"
    " --out {out}/library",
    "train": "train --set steps=512 --set seed={seed} --device cpu --out {out}/training",
}
"""What is run, by the name in the table."""

VERSIONS = "import platform, numpy; print(platform.python_version(), numpy.__version__)"

TIMES = ("seconds", "wall_seconds")
"""Fields of files that are times, and therefore not compared."""


_COLUMNS = ("command", "seed", "python", "numpy", "workers", "backend", "hashes")

Record = dict[str, Any]


@dataclass(frozen=True)
class Way:
    """How a command is run.

    Parameters
    ----------
    python : str
        The command that starts Python.
    workers : int
        Number of processes.
    backend : str
        "loky" for processes of this machine, or "ray".
    hashes : str
        PYTHONHASHSEED.
    """

    python: str
    workers: int = 1
    backend: str = "loky"
    hashes: str = "0"


def ways(pythons: Sequence[str], ray: str | None) -> Iterator[Way]:
    """List how each command is run; the first is the one with which the others are compared."""
    first, *others = pythons
    yield Way(first)
    yield Way(first, workers=2)
    yield Way(first, workers=3, hashes="1")
    yield Way(first, hashes="random")
    if ray is not None:
        yield Way(ray, workers=2, backend="ray")
    for python in others:
        yield Way(python, workers=2)


def run(command: str, way: Way, seed: int, meshes: Path) -> str:
    """Run a command in an empty folder; return the digest of what it wrote, or its error."""
    with TemporaryDirectory(prefix="repeatability-", dir=meshes.parent) as out:
        arguments = COMMANDS[command].format(
            seed=seed, workers=way.workers, backend=way.backend, out=out, meshes=meshes
        )
        done = subprocess.run(
            [*shlex.split(way.python), "-m", "packit_sim", *arguments.split()],
            env={**_environment(), "PYTHONHASHSEED": way.hashes},
            cwd=meshes.parent,
            capture_output=True,
            text=True,
        )
        return digest(Path(out)) if done.returncode == 0 else f"failed: {done.stderr[-300:]}"


def _environment() -> dict[str, str]:
    """Return the environment variables of the commands, which use the installed PackIt-Sim."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def digest(folder: Path) -> str:
    """Return a digest of the files in a folder; of JSON, without times; of weights, the tensors."""
    sha = hashlib.sha256()
    for file in sorted(folder.rglob("*")):
        if file.is_file() and _is_compared(file):
            sha.update(f"{file.relative_to(folder)}\n".encode())
            sha.update(_content(file))
    return sha.hexdigest()[:16]


def _is_compared(file: Path) -> bool:
    return file.suffix in (".jsonl", ".npz", ".safetensors") or file.name in _LIBRARY


_LIBRARY = ("library.json", "splits.json")


def _content(file: Path) -> bytes:
    if file.suffix == ".jsonl":
        lines = [_without_times(json.loads(line)) for line in file.read_text().splitlines()]
        return json.dumps(lines).encode()
    if file.suffix == ".safetensors":
        content = file.read_bytes()
        return content[8 + int.from_bytes(content[:8], "little") :]
    return file.read_bytes()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        known = {name: _without_times(v) for name, v in value.items() if name not in TIMES}
        if "improvements" in known:
            known["improvements"] = [total for _, total in known["improvements"]]
        return known
    return [_without_times(each) for each in value] if isinstance(value, list) else value


def write_meshes(folder: Path) -> None:
    """Write meshes that need repair, simplification and splits."""
    folder.mkdir(parents=True)
    random = np.random.default_rng(0)
    for n in range(8):
        mesh = trimesh.creation.icosphere(subdivisions=5 if n % 2 else 3)
        mesh.vertices *= 1 + 0.2 * np.sin(4 * mesh.vertices[:, [n % 3]] + n)
        mesh.vertices += random.normal(scale=0.003, size=mesh.vertices.shape)
        mesh.update_faces(random.random(len(mesh.faces)) > 0.001 * n)
        mesh.export(folder / f"ball{n}.stl")


def missing(
    pythons: Sequence[str], ray: str | None, commands: Sequence[str], seed: int, known: list[Record]
) -> Iterator[tuple[str, Way, Record]]:
    """List what is still to run.

    Parameters
    ----------
    pythons : sequence of str
        Commands that start Python.
    ray : str, optional
        The one of them in whose environment Ray is installed.
    commands : sequence of str
        Names of `COMMANDS`.
    seed : int
        The seed of all commands.
    known : list of dict
        The records of former runs.

    Yields
    ------
    command : str
        A name of `COMMANDS`.
    way : Way
        How to run it.
    record : dict
        What is known of the run.
    """
    done = [{name: record[name] for name in _COLUMNS} for record in known]
    for python in dict.fromkeys([*pythons, *([ray] if ray else [])]):
        ask = [*shlex.split(python), "-c", VERSIONS]
        version, numpy_version = subprocess.check_output(ask, text=True).split()
        for command in commands:
            for way in ways(pythons, ray):
                if way.python != python or not _applies(way, command, pythons[0]):
                    continue
                record: Record = {
                    "command": command,
                    "seed": seed,
                    "python": version,
                    "numpy": numpy_version,
                    "workers": way.workers,
                    "backend": way.backend,
                    "hashes": way.hashes,
                }
                if record not in done:
                    yield command, way, record


def _applies(way: Way, command: str, first: str) -> bool:
    """Return whether a command can be run in a way: a training promises less than the others."""
    if command == "train":
        return way.python == first and way.workers == 1
    return way.backend == "loky" or "{backend}" in COMMANDS[command]


def table(records: Sequence[Record]) -> str:
    """Write the table of the page: the runs of each way, by command."""
    reference: dict[tuple[str, int], str] = {}  # the digest of the first run
    rows: dict[tuple[str, ...], dict[str, list[bool]]] = {}
    for record in records:
        expected = reference.setdefault((record["command"], record["seed"]), record["digest"])
        way = tuple(str(record[name]) for name in _COLUMNS[2:])
        same = rows.setdefault(way, {}).setdefault(record["command"], [])
        same.append(record["digest"] == expected)
    head = ["Python", "NumPy", "workers", "backend", "`PYTHONHASHSEED`", *COMMANDS]
    cells = ([*way, *(_cell(own.get(name)) for name in COMMANDS)] for way, own in rows.items())
    return markdown_table(head, cells)


def _cell(same: list[bool] | None) -> str:
    """Say how many runs gave the bytes of the first way."""
    if same is None:
        return ""
    return f"same ({len(same)})" if all(same) else f"**differs** ({same.count(False)})"


def campaign(options: Namespace, work: Path) -> None:
    """Run what is not in the results file yet, in a folder that all Pythons can write."""
    meshes = work / "meshes"
    if not meshes.exists():
        write_meshes(meshes)
    records: list[Record] = read_results(NAME, options.out).get("runs", [])
    left = missing(options.python, options.ray, options.commands, options.seed, list(records))
    for command, way, record in left:
        started = time.perf_counter()
        record["digest"] = run(command, way, options.seed, meshes)
        if record["digest"].startswith("failed"):  # to be run again
            print(*record.values(), flush=True)
            continue
        record["seconds"] = round(time.perf_counter() - started, 1)
        records.append(record)
        result = {"version": __version__, **machine(), "runs": records}
        write_json(options.out / f"{NAME}.json", result)
        print(*record.values(), flush=True)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--python", nargs="+", default=[sys.executable], help="commands of Python")
    parser.add_argument("--ray", help="the command of a Python that has Ray")
    parser.add_argument("--commands", nargs="+", default=list(COMMANDS), choices=COMMANDS)
    parser.add_argument("--work", type=Path, help="folder for what the commands write")
    options = parser.parse_args()
    if not options.table:
        with TemporaryDirectory() as folder:
            campaign(options, options.work or Path(folder))
    write_into_page(NAME, table(read_results(NAME, options.out)["runs"]))


if __name__ == "__main__":
    main()
