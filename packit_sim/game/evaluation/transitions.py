"""Transitions: every placement of many episodes as arrays, to learn a model of the environment.

They are in shards, compressed files of NumPy, each of which depends only on its number, the seed,
the agents and the tasks. So a recording can be stopped, resumed and extended, by any number of
workers.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import structs

from packit_sim.core import typed_json
from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import (
    claimed,
    digest_of,
    lock_path,
    replace_text,
    replacing,
    require_free,
)
from packit_sim.core.version import __version__
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.evaluation import transition_files
from packit_sim.game.evaluation.transition_files import (
    FORMAT,
    MANIFEST,
    VERSION,
    Shard,
    Transitions,
    TransitionsError,
    TransitionsManifest,
    read_transitions,
)
from packit_sim.geometry.bits import Words
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import grid_nodes
from packit_sim.geometry.voxels import unpack

if TYPE_CHECKING:
    from packit_sim.core.parallel import Workers

__all__ = [
    "Shard",
    "Transitions",
    "TransitionsError",
    "TransitionsManifest",
    "read_transitions",
    "record_transitions",
]


def record_transitions(
    folder: Path | str,
    tasks: Sequence[Task],
    agents: Sequence[Agent],
    shards: int,
    *,
    episodes: int = 100,
    seed: int = 0,
    workers: Workers | None = None,
    on_shard: Callable[[Shard], None] = lambda shard: None,
) -> TransitionsManifest:
    """Let agents play tasks that are drawn at random, and record every placement.

    Parameters
    ----------
    folder : Path | str
        The folder. Shards that it contains are kept: the same call resumes a recording that was
        stopped, and one with more shards extends it.
    agents : Sequence[Agent]
        The agents, which take turns, without searches.
    shards : int
        Number of shards.
    episodes : int
        Episodes in a shard.
    workers : Workers | None
        The processes that play; by default this process plays.
    on_shard : Callable[[Shard], None]
        Called after each shard that is written.

    Returns
    -------
    TransitionsManifest
        The record of the folder.

    Raises
    ------
    ArgumentError
        If there is no task or agent, an agent has a search, the boxes differ, or files of others
        would be replaced.
    TransitionsError
        If the folder holds transitions of other tasks, agents or another seed, or a shard that was
        changed.
    BusyError
        If another process writes to the folder.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> from packit_sim import Agent, load_tasks
    >>> from packit_sim.game.evaluation.transitions import read_transitions, record_transitions
    >>> agent = Agent.from_name("largest-first/aligned/blbf")
    >>> folder = Path(mkdtemp()) / "transitions"
    >>> tasks = load_tasks("starter")[:1]
    >>> record_transitions(folder, tasks, [agent], shards=1, episodes=1).steps
    20
    >>> (shard,) = read_transitions(folder)
    >>> shard.location[:2].tolist(), int(shard.feasible(1).sum())
    ([[0, 0, 0], [0, 10, 0]], 1836)
    """
    folder = Path(folder)
    expected = _manifest(tasks, agents, episodes, seed)
    folder.mkdir(parents=True, exist_ok=True)
    with claimed(lock_path(folder), folder):
        manifest = expected
        if (folder / MANIFEST).exists():
            manifest = TransitionsManifest.read(folder)
            _check_same(folder, manifest, expected)
        else:
            require_free(folder, map(transition_files.file_name, range(shards)))
            _write_manifest(folder, manifest)
        done = {shard.number for shard in manifest.shards if _is_there(folder, shard)}
        jobs = [
            (folder, tuple(tasks), tuple(agents), episodes, seed, number)
            for number in range(shards)
            if number not in done
        ]
        played = (
            starmap(_record_shard, jobs)
            if workers is None
            else workers.as_done(_record_shard, jobs)
        )
        for shard in played:
            others = [each for each in manifest.shards if each.number != shard.number]
            complete = sorted([*others, shard], key=lambda each: each.number)
            manifest = structs.replace(manifest, shards=tuple(complete))
            _write_manifest(folder, manifest)
            on_shard(shard)
    return manifest


def tasks_digest(tasks: Sequence[Task]) -> str:
    """Return the SHA-256 of the digests of tasks, in hex."""
    return hashlib.sha256(" ".join(task.digest for task in tasks).encode()).hexdigest()


def _manifest(
    tasks: Sequence[Task], agents: Sequence[Agent], episodes: int, seed: int
) -> TransitionsManifest:
    if not tasks or not agents:
        raise ArgumentError("transitions need at least one task and one agent")
    for agent in agents:
        if agent.search is not None:
            raise ArgumentError(f"agent {agent.name!r} can't be recorded: leave out its search")
    cells = {task.cells for task in tasks}
    if len(cells) > 1:
        raise ArgumentError(f"the boxes of the tasks differ: {', '.join(map(str, sorted(cells)))}")
    x, y, z = grid_nodes(next(iter(cells)))
    state = x * y * (z * 8 + 2 * 16) + math.ceil(x * y * z / 8)  # words, heights, mask
    most = transition_files.MAX_BYTES // 2 // (state * (1 + max(len(task.items) for task in tasks)))
    check_range("episodes", episodes, (1 <= episodes <= most, f"1 to {most} of these tasks"))
    names = tuple(agent.name for agent in agents)
    return TransitionsManifest(
        FORMAT,
        VERSION,
        __version__,
        cells.pop(),
        tasks_digest(tasks),
        names,
        seed,
        episodes,
    )


def _check_same(folder: Path, found: TransitionsManifest, expected: TransitionsManifest) -> None:
    for field in ("agents", "seed", "tasks", "cells", "episodes"):
        ours, theirs = getattr(expected, field), getattr(found, field)
        if ours != theirs:
            raise TransitionsError(
                f"{folder} holds transitions of other {field}: {theirs}, not {ours}; "
                "choose another folder"
            )


def _is_there(folder: Path, shard: Shard) -> bool:
    """Return whether the file of a shard is there, or raise if it is another one."""
    path = folder / shard.file
    if not path.exists():
        return False
    if not path.is_file() or digest_of(path) != shard.sha256:
        raise transition_files.changed(path)
    return True


def _write_manifest(folder: Path, manifest: TransitionsManifest) -> None:
    replace_text(
        folder / MANIFEST,
        json.dumps(typed_json.builtins(manifest), indent=1) + "\n",
    )


def _record_shard(
    folder: Path,
    tasks: Sequence[Task],
    agents: Sequence[Agent],
    episodes: int,
    seed: int,
    number: int,
) -> Shard:
    """Play the episodes of a shard, and write it."""
    rng = np.random.default_rng((seed, number))
    steps: list[_Step] = []
    states: list[Words] = []
    numbers, first = [], [0]
    for n in range(number * episodes, (number + 1) * episodes):
        task, agent = int(rng.integers(len(tasks))), n % len(agents)
        _play(tasks[task], agents[agent], rng, steps, states)
        numbers.append((task, agent))
        first.append(len(steps))
    shapes, shape = np.unique([step.placed.item.shape.id for step in steps], return_inverse=True)
    drawn, occupancy = np.array(numbers, dtype=np.int32), np.stack(states)
    transitions = Transitions(
        drawn[:, 0],
        drawn[:, 1],
        np.array(first, dtype=np.int32),
        shapes,
        shape.astype(np.int32),
        np.array([step.placed.item.scale for step in steps]),
        np.array([step.reward for step in steps]),
        np.array([step.placed.item.rotation for step in steps], dtype=np.uint8),
        np.array([step.placed.location for step in steps], dtype=np.int16),
        np.packbits(np.stack([step.mask for step in steps]), axis=1),
        occupancy,
        np.stack([_heights(unpack(words)) for words in occupancy]),
    )
    path = folder / transition_files.file_name(number)
    with replacing(path) as file:
        arrays = {field.name: getattr(transitions, field.name) for field in fields(transitions)}
        np.savez_compressed(file, allow_pickle=False, **arrays)
    return Shard(number, path.name, digest_of(path), len(steps))


class _Step(NamedTuple):
    """A placement, its reward, and the flat mask from which its location was chosen."""

    placed: PlacedItem
    reward: float
    mask: npt.NDArray[np.bool_]


def _play(
    task: Task, agent: Agent, rng: np.random.Generator, steps: list[_Step], states: list[Words]
) -> None:
    """Play an episode, and append its placements and its states."""
    episode = Episode(task)
    states.append(episode.box.outer_words.copy())
    while episode.end is None:
        is_last = episode.stage is Stage.LOCATION
        mask = episode.action_mask() if is_last else None
        reward = episode.step(agent.act(episode, rng))
        if mask is not None and reward:
            steps.append(_Step(episode.box.placed[-1], reward, mask))
            states.append(episode.box.outer_words.copy())


def _heights(filled: npt.NDArray[np.bool_]) -> npt.NDArray[np.int16]:
    """Return the cells from the floor to the top of the highest filled one, (x, y)."""
    from_top = filled[:, :, ::-1].argmax(axis=2)
    return np.where(filled.any(axis=2), filled.shape[2] - from_top, 0).astype(np.int16)
