"""Recordings of what was played, for imitation: folders in Minari's format, read by sub-task.

Minari comes with `pip install packit-sim[record]`; this module does without until it is used.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from packit_sim.core.errors import PackItError, StateError
from packit_sim.datasets.packs import Task
from packit_sim.envs.observations import Observation
from packit_sim.game.agents import GROUND_TRUTH, Agent
from packit_sim.game.episode import Stage

__all__ = [
    "MissingMinariError",
    "Recorder",
    "RecordingError",
    "record",
    "stage_steps",
]

CUT_SHORT = "cut short"
"""The end of an episode that was left before it was over."""

BLOCK_BYTES = 64_000_000
"""Observations are written in blocks of about so many bytes, so that voxels take no more memory."""

CHUNK_BYTES = 1_000_000
"""About how much of an array is compressed at a time, or one step of it where that is more."""

GZIP_LEVEL = 4
"""Level 1 makes features 40% larger for a fifth less time, 9 an eighth smaller for 2.5 times."""


class RecordingError(PackItError, ValueError):
    """A recording that can't be written where or as it was asked for, or doesn't replay."""


class MissingMinariError(PackItError, ImportError):
    """Minari or h5py is not installed."""


@dataclass
class _Played:
    """An episode as far as it was played. options: {"task": its number}, if that was asked for."""

    seed: int
    options: dict[str, int] | None
    task: int
    observations: list[Any]
    densities: list[float]
    actions: list[np.int64] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminations: list[bool] = field(default_factory=list)
    truncations: list[bool] = field(default_factory=list)
    end: str = CUT_SHORT


class Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """Plays like the PackIt environment that it wraps, and `close()` leaves a recording at `path`.

    Each episode is kept with its seed, observations, actions, rewards and info["density"], bit for
    bit; its metadata tells "task" (the number), "end" and "return". An episode that a reset or
    `close()` cuts short is kept as truncated, and its end is "cut short". A reset without a seed
    draws one from the environment's generator, so that each episode can be played again by itself.

    The folder appears as a whole or not at all: nothing is written where nothing was played, or
    where a `with` block ends in an exception. Until then all is in a hidden folder beside it, which
    goes if the recorder is never closed. Boolean observations are MultiBinary in the recording's
    observation space, whose file would otherwise list two bounds for each cell. A step of voxels
    takes tens of megabytes of memory each time an episode is read: record observation="none" and
    give `stage_steps` an environment that observes voxels.

    dataset_id: "namespace/name-v0"; `minari.load_dataset` finds it by that where path is
    "<Minari's folder>/<dataset_id>/data". description, algorithm: for those who read it. Raises
    RecordingError where path exists, MissingMinariError without the extra `record`, and warns where
    the environment's settings can't be written as JSON: then `recover_environment` does not work,
    everything else does.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        path: str | Path,
        *,
        dataset_id: str = "packit/recording-v0",
        description: str = "",
        algorithm: str = "",
    ) -> None:
        super().__init__(env)
        self._minari = _Minari()
        self.path = Path(path).absolute()
        if self.path.exists():
            raise RecordingError(f"{self.path} exists: a recording needs a path that is free")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._played: _Played | None = None
        self._count = 0
        self._staging: tempfile.TemporaryDirectory[str] | None = tempfile.TemporaryDirectory(
            prefix=f".{self.path.name}.", dir=self.path.parent
        )
        self._folder = Path(self._staging.name) / "new"
        self._storage = self._minari.storage.new(
            self._folder,
            observation_space=_stored(env.observation_space),
            action_space=env.action_space,
            env_spec=_spec(env),
            jpeg_encoding=False,
        )
        self._storage.update_metadata(
            {
                "dataset_id": dataset_id,
                "minari_version": self._minari.version,
                "description": description,
                "algorithm_name": algorithm,
                "requirements": [f"packit-sim=={version('packit-sim')}"],
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Raises RecordingError for a task that is given as an object: a number can be recorded."""
        task = (options or {}).get("task")
        if isinstance(task, Task):
            raise RecordingError(
                "a task that only the reset was given can't be recorded: give it to the "
                "environment as one of its tasks, and its number to the reset"
            )
        self._finish()
        if seed is None:
            seed = int(self.unwrapped.np_random.integers(2**31))
        observation, info = self.env.reset(seed=seed, options=options)
        self._played = _Played(
            seed,
            None if task is None else {"task": int(task)},
            info["task"],
            [observation],
            [info["density"]],
        )
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._played is None:
            raise StateError("no episode is being played: call reset()")
        observation, reward, terminated, truncated, info = self.env.step(action)
        played = self._played
        played.observations.append(observation)
        played.densities.append(info["density"])
        played.actions.append(np.int64(action))
        played.rewards.append(float(reward))
        played.terminations.append(terminated)
        played.truncations.append(truncated)
        if terminated or truncated:
            played.end = info.get("end", CUT_SHORT)
            self._finish()
        return observation, float(reward), terminated, truncated, info

    def close(self) -> None:
        """Writes the recording and closes the environment."""
        staging, self._staging = self._staging, None
        try:
            if staging is not None:
                with staging:
                    self._finish()
                    if self._count:
                        self._folder.rename(self.path)
        finally:
            super().close()

    def __exit__(self, *raised: Any) -> bool:
        if raised[0] is not None and self._staging is not None:
            self._staging.cleanup()
            self._staging = None
        return super().__exit__(*raised)

    def _finish(self) -> None:
        """Adds the episode that was played, if it has a step, to the recording."""
        played, self._played = self._played, None
        if played is None or not played.actions:
            return
        if not played.terminations[-1]:
            played.truncations[-1] = True
        steps = len(played.actions)
        self._minari.make_room(self._folder, self._count, played.observations[0], steps + 1)
        block = max(1, BLOCK_BYTES // max(1, _bytes(played.observations[0])))
        for start in range(0, steps, block):
            seen = slice(start + (start > 0), start + block + 1)
            done = slice(start, start + block)
            buffer = self._minari.buffer(
                id=self._count,
                seed=None if start else played.seed,
                options=None if start else played.options,
                observations=_columns(played.observations[seen]),
                actions=played.actions[done],
                rewards=played.rewards[done],
                terminations=played.terminations[done],
                truncations=played.truncations[done],
                infos={"density": played.densities[seen]},
            )
            self._storage.update_episodes([buffer])
        metadata = {
            "total_steps": steps,
            "task": played.task,
            "end": played.end,
            "return": sum(played.rewards),
        }
        self._storage.update_episode_metadata([metadata], [self._count])
        self._count += 1


def record(
    env: gym.Env[Any, Any],
    path: str | Path,
    agent: Agent = GROUND_TRUTH,
    *,
    episodes: int | None = None,
    seed: int = 0,
    description: str = "",
) -> Any:
    """Records an agent that plays each task of the environment once, or so many episodes.

    Returns the recording, a minari.MinariDataset, and leaves the environment closed. Raises as
    `Recorder` does, and RecordingError where the tasks are made on the fly and episodes is None.
    """
    tasks: Sequence[Task] = env.get_wrapper_attr("tasks")
    if episodes is None and not tasks:
        raise RecordingError("say how many episodes: the tasks are made on the fly, without end")
    recorder = Recorder(env, path, description=description, algorithm=agent.name)
    with recorder:
        for number in range(len(tasks) if episodes is None else episodes):
            rng = np.random.default_rng((seed, number))
            recorder.reset(
                seed=None if number else seed,
                options={"task": number} if episodes is None else None,
            )
            over = False
            while not over:
                action = agent.act(env.get_wrapper_attr("episode"), rng)
                _, _, terminated, truncated, _ = recorder.step(action)
                over = terminated or truncated
    return _Minari().dataset(recorder.path)


def stage_steps(
    recording: Any, stage: Stage, env: gym.Env[Any, Any] | None = None
) -> Iterator[tuple[Observation, int]]:
    """The observations at which a sub-task was an agent's to answer, each with the action taken.

    recording: its path, or a minari.MinariDataset, which may hold some of its episodes. env: where
    given, the episodes are played again in it, and the observations are its own; it may differ from
    what was recorded in what it observes and draws. Actions that were not valid are left out.
    Raises RecordingError where the observations don't tell "stage" and "action_mask", or where the
    environment gives another reward.
    """
    dataset = _Minari().dataset(recording) if isinstance(recording, str | Path) else recording
    space = dataset.observation_space if env is None else env.observation_space
    if not (isinstance(space, spaces.Dict) and {"stage", "action_mask"} <= space.keys()):
        raise RecordingError("the observations tell no 'stage' or no 'action_mask'")
    for episode in dataset.iterate_episodes():
        seen = _rows(episode) if env is None else _played_again(dataset, episode, env)
        for observation, action in zip(seen, episode.actions.tolist(), strict=True):
            if observation["stage"] == stage and observation["action_mask"][action]:
                yield observation, action


def _rows(episode: Any) -> Iterator[Observation]:
    for step in range(len(episode)):
        yield {key: column[step] for key, column in episode.observations.items()}


def _played_again(dataset: Any, episode: Any, env: gym.Env[Any, Any]) -> Iterator[Observation]:
    """The observations at each step of an episode, played in an environment."""
    (metadata,) = dataset.storage.get_episode_metadata([episode.id])
    seed, task = metadata["seed"], int(metadata["task"])
    observation, info = env.reset(seed=seed, options=metadata.get("options"))
    if info["task"] != task:  # those that come in turn follow from no seed
        observation, info = env.reset(seed=seed, options={"task": task})
    for step, (action, recorded) in enumerate(
        zip(episode.actions.tolist(), episode.rewards.tolist(), strict=True)
    ):
        yield observation
        observation, reward, _, _, _ = env.step(action)
        if reward != recorded:
            raise RecordingError(
                f"episode {episode.id} does not replay: step {step} gives reward {reward}, not the "
                f"recorded {recorded}: has the environment other tasks or settings?"
            )


class _Minari:
    """What is used of Minari and h5py. Raises MissingMinariError where one is not installed."""

    def __init__(self) -> None:
        try:
            import h5py
            import minari
            from minari.data_collector.episode_buffer import EpisodeBuffer
            from minari.dataset.minari_storage import MinariStorage
        except ImportError as error:
            raise MissingMinariError(
                f"recordings need Minari: pip install packit-sim[record] ({error})"
            ) from error
        self.version: str = minari.__version__
        self.dataset = minari.MinariDataset
        self.buffer = EpisodeBuffer
        self.storage = MinariStorage
        self._h5py = h5py

    def make_room(self, folder: Path, episode: int, observation: Any, count: int) -> None:
        """Makes the arrays for so many observations, compressed ones, which Minari appends to."""
        (path,) = folder.glob("*.hdf5")
        with self._h5py.File(path, "a", track_order=True) as file:
            self._make(file.create_group(f"episode_{episode}"), "observations", observation, count)

    def _make(self, group: Any, name: str, part: Any, count: int) -> None:
        if isinstance(part, dict):
            inside = group.create_group(name)
            for key, value in part.items():
                self._make(inside, key, value, count)
            return
        array = np.asarray(part)
        group.create_dataset(
            name,
            shape=(0, *array.shape),
            maxshape=(None, *array.shape),
            dtype=array.dtype,
            chunks=(min(max(1, CHUNK_BYTES // max(1, array.nbytes)), count), *array.shape),
            compression="gzip",
            compression_opts=GZIP_LEVEL,
            shuffle=True,
        )


def _stored(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """The space as it is written."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({key: _stored(part) for key, part in space.items()})
    if isinstance(space, spaces.Box) and space.dtype == np.bool_:
        return spaces.MultiBinary(space.shape)
    return space


def _spec(env: gym.Env[Any, Any]) -> EnvSpec | None:
    """What makes the environment again; None, and a warning, where JSON can't say it."""
    bare = env.unwrapped.spec
    if bare is None:
        problem = "was not made by gymnasium.make"
    elif objects := [name for name, value in bare.kwargs.items() if not _is_json(value)]:
        problem = f"has settings that are objects: {', '.join(objects)}"
    else:
        spec = env.spec
        assert spec is not None
        lost = [
            w.name for w in spec.additional_wrappers if w.kwargs is None or not _is_json(w.kwargs)
        ]
        if not lost:
            return spec
        problem = f"has wrappers that don't tell their settings: {', '.join(lost)}"
    warnings.warn(
        f"the recording will not make its environment again, which {problem}; all else is recorded",
        stacklevel=3,
    )
    return None


def _is_json(value: Any) -> bool:
    try:
        json.dumps(value)
    except (TypeError, ValueError):
        return False
    return True


def _columns(rows: list[Any]) -> Any:
    """Observations one after the other as Minari wants them: a list for each key."""
    if isinstance(rows[0], dict):
        return {key: _columns([row[key] for row in rows]) for key in rows[0]}
    return rows


def _bytes(observation: Any) -> int:
    if isinstance(observation, dict):
        return sum(map(_bytes, observation.values()))
    return np.asarray(observation).nbytes
