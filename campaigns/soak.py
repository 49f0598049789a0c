"""Play thousands of episodes with pictures, and look for what grows.

    .venv/bin/python -m campaigns.soak --episodes 9000    (about 75 minutes of one core)
    .venv/bin/python -m campaigns.soak --table

Each renderer has a separate process, which plays so many episodes. It opens and closes an
environment for every 100 episodes: the 550 tasks of `everyday-v1` with shapes or all choices
drawn at random, and fresh tasks; each episode ends with a picture of 64 x 64 pixels. A sample is
taken whenever everything is closed. Three caches that fill slowly have smaller budgets. A run is
repeated as a whole; it can't be resumed. Writes `campaigns/results/soak.json`, and a plot; --table
also writes the table of the page.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import SUPPRESS
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import linregress, t

from benchmarks.common import PICTURES, machine, markdown_table, resident_memory, write_json
from campaigns.common import argument_parser, read_results, write_into_page
from packit_sim import ShapeLibrary
from packit_sim.core import caches
from packit_sim.core.choices import SPLITS
from packit_sim.core.silence import quiet
from packit_sim.core.version import __version__
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.task_source import FRESH
from packit_sim.render import plots
from packit_sim.render.renderers import RENDERER_VARIABLE
from packit_sim.scene import Scene

with quiet():  # it prints its build time
    import pybullet

RENDERERS = "software", "egl"

INTERVAL = 100
"""Episodes between two samples."""

SIDE = 64
"""Pixels of a picture's side; the last of each interval is drawn by `render()`, in 512."""

WARM_UP = 1 / 3
"""Share of the samples before the fit: caches fill up to their budgets."""

BLOCKS = 10
"""Runs of consecutive samples whose means are fitted: single samples are not independent."""

MEMORY_BAR = 0.05
"""Memory is flat if 10,000 episodes add less than this share of it, at the upper end of the 95%
interval."""

COUNTS = ("descriptors", "threads", "clients", "temporary files")
"""Counts are flat if the second half of the samples after the warm-up never exceeds the first."""

RESIDENT = "resident memory, MB"

IN_USE = "memory in use, MB"
"""What was allocated and not freed: the allocator keeps more, because what is free is scattered."""

MEMORIES = (RESIDENT, IN_USE)

MALLINFO2 = (
    *("arena", "chunks", "small chunks", "mapped regions", "mapped", "unused", "free small"),
    *("used", "free", "top"),
)
"""The fields of glibc's `struct mallinfo2`, all of type size_t."""

BUDGETS = {"collisions": 2_000, "pairs that met": 500, "item features": 4 << 20}
"""Budgets of the caches that fill slowly: less than their own, so that all are full after the
warm-up."""

CONTENTS: tuple[dict[str, Any], ...] = (
    *[{"rotation": "aligned", "location": "blbf"}] * 7,
    *[{}] * 2,
    {"tasks": FRESH, "rotation": "aligned", "location": "blbf"},
)
"""The settings of environments, in turn."""

Sample = Mapping[str, float]


class _MemoryInUse(ctypes.Structure):
    """What glibc says of its allocator: struct mallinfo2."""

    _fields_ = tuple((name, ctypes.c_size_t) for name in MALLINFO2)


def memory_in_use() -> int:
    """Measure the memory that is allocated and can still be reached, in bytes."""
    gc.collect()
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = _MemoryInUse
    found = mallinfo2()
    return int(found.used + found.mapped)


def sample(episode: int) -> Sample:
    """Measure what this process holds."""
    process = Path("/proc/self")
    return {
        "episode": episode,
        RESIDENT: round(resident_memory() / 1e6, 1),
        IN_USE: round(memory_in_use() / 1e6, 1),
        "descriptors": len(os.listdir(process / "fd")) - 1,  # that of the listing
        "threads": len(os.listdir(process / "task")),
        "clients": sum(map(pybullet.isConnected, range(1024))),
        "temporary files": len(os.listdir(tempfile.gettempdir())),
        "core-seconds": round(time.process_time(), 1),
    }


def play(
    tasks: Sequence[Task],
    seed: int,
    interval: int = INTERVAL,
    on_episode: Callable[[], object] = lambda: None,
) -> Iterator[Sample]:
    """Play episodes with pictures without end, and yield a sample after each interval.

    Parameters
    ----------
    tasks : Sequence[Task]
        The tasks; every tenth environment has fresh ones.
    seed : int
        The seed of tasks and actions.
    interval : int
        The episodes of each environment.
    on_episode : Callable[[], object]
        Called after each episode.

    Yields
    ------
    Sample
        What the process holds, with all environments and scenes closed.
    """
    rng = np.random.default_rng(seed)
    for number in count():
        settings = {"tasks": tasks, **CONTENTS[number % len(CONTENTS)]}
        env = PackItEnv(**settings, render_mode="rgb_array")
        env.reset(seed=int(rng.integers(2**32)))
        with Scene(env.episode.box) as scene:
            for _ in range(interval):
                _, info = env.reset()
                over = not info["action_mask"].any()
                while not over:
                    action = int(rng.choice(np.flatnonzero(info["action_mask"])))
                    _, _, over, _, info = env.step(action)
                scene.update(env.episode.box)
                scene.snapshot(SIDE, SIDE)
                on_episode()
            scene.penetrations()
        env.render()
        env.close()
        yield sample((number + 1) * interval)


def growth(samples: Sequence[Sample], name: str) -> tuple[float, float, float]:
    """Fit the growth of a measure per 10,000 episodes after the warm-up: slope, 95% interval."""
    steady = samples[round(len(samples) * WARM_UP) :]
    count = min(BLOCKS, len(steady))
    blocks = np.array_split(np.array([[one["episode"], one[name]] for one in steady]), count)
    means = np.array([block.mean(axis=0) for block in blocks])
    fit = linregress(means[:, 0], means[:, 1])
    half = float(t.ppf(0.975, count - 2) * fit.stderr)
    slope = float(fit.slope)
    return slope * 1e4, (slope - half) * 1e4, (slope + half) * 1e4


def is_flat(samples: Sequence[Sample], name: str) -> bool:
    """Whether a measure meets its bar, `MEMORY_BAR` or that of `COUNTS`."""
    steady = [one[name] for one in samples[round(len(samples) * WARM_UP) :]]
    if name in MEMORIES:
        return growth(samples, name)[2] < MEMORY_BAR * float(np.median(steady))
    half = len(steady) // 2
    return max(steady[half:]) <= max(steady[:half])


def table(results: Mapping[str, Any]) -> str:
    """Tabulate results in Markdown."""
    rows = []
    for renderer, samples in results["samples"].items():
        first = samples[round(len(samples) * WARM_UP)]
        for name in (*MEMORIES, *COUNTS):
            change = "none"
            if len({one[name] for one in samples[round(len(samples) * WARM_UP) :]}) > 1:
                change = "{:+.1f} ({:+.1f} to {:+.1f})".format(*growth(samples, name))
            verdict = "yes" if is_flat(samples, name) else "**no**"
            cells = (f"{first[name]:g}", f"{samples[-1][name]:g}", change, verdict)
            rows.append((renderer, f"{samples[-1]['episode']:,}", name, *cells))
    head = ("renderer", "episodes", "measure", "after the warm-up", "at the end")
    return markdown_table((*head, "change per 10,000 episodes (95% interval)", "flat"), rows)


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw memory by episodes."""
    with plots.drawn(path, [["memory"]], 6, 3) as (_, axes):
        ax = axes["memory"]
        for color, (renderer, samples) in zip(
            plots.COLORS, results["samples"].items(), strict=False
        ):
            at = [one["episode"] for one in samples]
            for name, style in zip(MEMORIES, ("-", ":"), strict=True):
                label = f"{renderer}, {name.removesuffix(', MB')}"
                ax.plot(at, [one[name] for one in samples], style, color=color, label=label)
        ax.set(xlabel="episodes", ylabel="MB", title="Memory of one process")
        ax.set_ylim(bottom=0)
        ax.legend()


def samples_of(renderer: str, episodes: int, seed: int) -> Iterator[Sample]:
    """Play in a separate process, and yield its samples."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "campaigns.soak", "--renderer", renderer]
        command += ["--episodes", str(episodes), "--seed", str(seed)]
        env = {**os.environ, RENDERER_VARIABLE: renderer, "TMPDIR": folder}
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as process:
            assert process.stdout is not None
            yield from map(json.loads, process.stdout)
    assert process.returncode == 0, f"{renderer}: exit code {process.returncode}"


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--episodes", type=int, default=9000, help="of each renderer")
    parser.add_argument("--renderer", choices=RENDERERS, help=SUPPRESS)
    arguments = parser.parse_args()
    if arguments.renderer:
        for name, budget in BUDGETS.items():
            caches.limit(name, budget)
        library = ShapeLibrary.open("everyday")
        tasks = [task for split in SPLITS for task in load_tasks("everyday-v1", library, split)]
        for one in islice(play(tasks, arguments.seed), arguments.episodes // INTERVAL):
            print(json.dumps(one), flush=True)
        return
    if not arguments.table:
        run(arguments.episodes, arguments.seed, arguments.out)
    results = read_results("soak", arguments.out)
    print(table(results))
    if arguments.table:
        write_into_page("soak", table(results))
        draw(results, PICTURES / "soak.png")


def run(episodes: int, seed: int, out: Path) -> None:
    """Play with each renderer in turn, and write the results after each sample."""
    results: dict[str, Any] = {
        "command": f"python -m campaigns.soak --episodes {episodes} --seed {seed}",
        "version": __version__,
        "machine": machine(),
        "samples": {},
    }
    for number, renderer in enumerate(RENDERERS):
        samples = results["samples"][renderer] = []
        for one in samples_of(renderer, episodes, seed + number):
            samples.append(one)
            write_json(out / "soak.json", results)


if __name__ == "__main__":
    main()
