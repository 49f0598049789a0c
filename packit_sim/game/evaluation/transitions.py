"""Transitions: every placement of many episodes as arrays, to learn a model of the environment.

They are in shards, compressed files of NumPy, each of which depends only on its number, the seed,
the agents and the tasks. So a recording can be stopped, resumed and extended, by any number of
workers.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct, structs

from packit_sim.core import typed_json
from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError, PackItError, located
from packit_sim.core.files import claimed, digest_of, lock_path, read_whole, replace_text, replacing
from packit_sim.core.version import __version__
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.geometry.bits import Words
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.voxels import unpack
from packit_sim.placement import Mask

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

FORMAT = "packit-transitions"

VERSION = 1

MANIFEST = "manifest.json"


class TransitionsError(PackItError, ValueError):
    """A folder that holds no transitions, other ones, or damaged ones."""


@dataclass(frozen=True)
class Transitions:
    """The n steps of a shard, in the order in which they were played; a step places one item.

    Attributes
    ----------
    task, agent : ndarray
        int32 (episodes,), the number of each episode's task in the dataset, and of its agent.
    first : ndarray
        int32 (episodes + 1,), the number of each episode's first step, and n.
    shapes : ndarray
        The ids of all placed shapes.
    shape : ndarray
        int32 (n,), the index of the placed item's shape in `shapes`.
    scale, reward : ndarray
        float64 (n,), the item's scale, and the reward.
    rotation : ndarray
        uint8 (n,), 0 to 23.
    location : ndarray
        int16 (n, 3), the grid node.
    mask : ndarray
        uint8 (n, bytes), the feasible locations of the item in this rotation, see `feasible`.
    occupancy : ndarray
        uint64 (n + episodes, nx, ny, nz), the outer cells of the box in each state, as words.
    heights : ndarray
        int16 (n + episodes, cells x, cells y), the cells from the floor to the top of the highest
        one that is filled. An episode of m steps has m + 1 states, one after the other.
    """

    task: npt.NDArray[np.int32]
    agent: npt.NDArray[np.int32]
    first: npt.NDArray[np.int32]
    shapes: npt.NDArray[np.str_]
    shape: npt.NDArray[np.int32]
    scale: npt.NDArray[np.float64]
    reward: npt.NDArray[np.float64]
    rotation: npt.NDArray[np.uint8]
    location: npt.NDArray[np.int16]
    mask: npt.NDArray[np.uint8]
    occupancy: Words
    heights: npt.NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.scale)

    def episode(self, step: int) -> int:
        """Return the number of a step's episode."""
        return int(np.searchsorted(self.first, step, "right")) - 1

    def state(self, step: int) -> int:
        """Return the index of the state before a step; the one after it is the next."""
        return step + self.episode(step)

    def feasible(self, step: int) -> Mask:
        """Return the exact mask of a step's item: bool over the grid nodes, [x, y, z]."""
        nodes = self.occupancy.shape[1:]
        return np.unpackbits(self.mask[step], count=math.prod(nodes)).astype(bool).reshape(nodes)

    def filled(self, state: int) -> npt.NDArray[np.bool_]:
        """Return the outer cells of the box in a state: bool over its cells."""
        return unpack(self.occupancy[state])


class Shard(Struct, frozen=True):
    """The entry of a shard in the manifest.

    Attributes
    ----------
    number : int
        Its number, which seeds it.
    sha256 : str
        The SHA-256 of the file, in hex.
    """

    number: int
    file: str
    sha256: str
    steps: int


class TransitionsManifest(Struct, frozen=True):
    """The record of the transitions in a folder.

    Attributes
    ----------
    packit : str
        The version of PackIt-Sim that began it.
    tasks : str
        The SHA-256 of the digests of the tasks, in hex.
    shards : tuple of Shard
        Those that are complete, by their numbers.
    """

    format: str
    version: int
    packit: str
    cells: Triple
    tasks: str
    agents: tuple[str, ...]
    seed: int
    episodes: int
    shards: tuple[Shard, ...] = ()

    @property
    def steps(self) -> int:
        """The number of steps in all shards."""
        return sum(shard.steps for shard in self.shards)

    @classmethod
    def read(cls, folder: Path) -> TransitionsManifest:
        """Read the manifest of a folder.

        Returns
        -------
        TransitionsManifest
            The record.

        Raises
        ------
        TransitionsError
            If there is none, or it is damaged or of another version.
        """
        path = folder / MANIFEST
        try:
            data = read_whole(path)
        except OSError as error:
            raise TransitionsError(f"{folder} holds no transitions: {error.strerror}") from None
        with located(str(path), TransitionsError):
            found = typed_json.decode(data, cls, TransitionsError, "a manifest")
        if (found.format, found.version) != (FORMAT, VERSION):
            raise TransitionsError(
                f"{path} is of format {found.format!r}, version {found.version}: "
                f"this one reads {FORMAT!r}, version {VERSION}"
            )
        return found


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
        If there is no task or agent, an agent has a search, or the boxes differ.
    TransitionsError
        If the folder holds transitions of other tasks, agents or another seed.
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
        done = {shard.number for shard in manifest.shards}
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
            complete = sorted([*manifest.shards, shard], key=lambda each: each.number)
            manifest = structs.replace(manifest, shards=tuple(complete))
            replace_text(
                folder / MANIFEST, json.dumps(typed_json.builtins(manifest), indent=1) + "\n"
            )
            on_shard(shard)
    return manifest


def read_transitions(folder: Path | str) -> Iterator[Transitions]:
    """Read the transitions in a folder, shard by shard.

    Yields
    ------
    Transitions
        A shard.

    Raises
    ------
    TransitionsError
        If the folder holds no transitions, or a file is missing, damaged or not the recorded one.
    """
    folder = Path(folder)
    for shard in TransitionsManifest.read(folder).shards:
        path = folder / shard.file
        try:
            data = read_whole(path)
        except OSError as error:
            raise TransitionsError(f"{path} can't be read: {error.strerror}") from None
        if hashlib.sha256(data).hexdigest() != shard.sha256:
            raise TransitionsError(
                f"{path} is not the file that the manifest records: its digest differs"
            )
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            yield Transitions(**arrays)


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
    check_range("episodes", episodes, (episodes >= 1, "at least 1"))
    names = tuple(agent.name for agent in agents)
    return TransitionsManifest(
        FORMAT, VERSION, __version__, cells.pop(), tasks_digest(tasks), names, seed, episodes
    )


def _check_same(folder: Path, found: TransitionsManifest, expected: TransitionsManifest) -> None:
    for field in ("agents", "seed", "tasks", "cells", "episodes"):
        ours, theirs = getattr(expected, field), getattr(found, field)
        if ours != theirs:
            raise TransitionsError(
                f"{folder} holds transitions of other {field}: {theirs}, not {ours}; "
                "choose another folder"
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
    path = folder / f"{number:06d}.npz"
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
