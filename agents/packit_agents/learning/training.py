"""PackNN trained with PPO (paper, section 5): repeatable, and to be gone on with after any kill."""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.wrappers import FilterObservation
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from packit_agents.learning.actor_critic import ActorCritic, on_device
from packit_agents.learning.augmentation import AugmentedEnv
from packit_agents.learning.checkpoints import ReplayableEnv, read_checkpoint, write_checkpoint
from packit_agents.learning.dagger_dataset import DaggerDataset
from packit_agents.learning.imitation import LESSON, ImitationPPO, LabellingEnv
from packit_agents.learning.learned_policies import FIELDS, SHAPE_FIELDS, log_probabilities
from packit_agents.learning.mixing import Mixture
from packit_agents.learning.remote_envs import RemoteEnvs
from packit_agents.learning.training_settings import TrainingSettings
from packit_agents.learning.weights import write_weights
from packit_sim._version import __version__
from packit_sim.core.confidence import Estimate
from packit_sim.core.errors import PackItError
from packit_sim.core.files import claimed, replace_text
from packit_sim.datasets.packs import LibraryRef, Task, load_tasks
from packit_sim.envs.env import FRESH, PackItEnv, TaskMaker
from packit_sim.envs.observations import Observation
from packit_sim.envs.vector import PackItVectorEnv
from packit_sim.evaluation.evaluation import evaluate_batched
from packit_sim.evaluation.learning_curves import CURVE_FILE, SETTINGS_FILE, Point
from packit_sim.libraries.library import ShapeLibrary

_log = logging.getLogger(__name__)

RECENT = 200
"""Episodes whose mean return is told."""

VALIDATION_ENVS = 16
"""Tasks that are played side by side in validation."""

CHECKPOINT = "checkpoint.pt"

CHECKPOINT_SECONDS = 30.0
"""Work that a kill can lose, and the time of an update."""


_ADAM = {"eps": 1e-5, "fused": True}
"""stable-baselines3's own, and as one kernel."""


class TrainingError(PackItError, ValueError):
    """A training that can't be done, or gone on with, as it was asked for."""


@dataclass(frozen=True)
class Progress:
    """Where a training stands. reward: as of `Point`. best: of the points so far."""

    steps: int
    reward: float | None
    best: Point | None


class Training:
    """A training in a folder of its own, of which the same settings make the same weights.

    settings.json: what was asked for, and of which tasks. checkpoint.pt: all it takes to go on.
    lessons: what a teacher told, until it is learned. curve.json: the learning curve.
    best.safetensors: the weights that did best in validation, the first of equal ones;
    last.safetensors: those at the end. tensorboard/: PPO's own numbers.

    folder: new, or of a training with the same settings, which goes on. device: "cpu", "cuda" or
    "auto". workers: processes of a Ray cluster that hold the environments, none for this one;
    address: of its head. They change nothing of what is learned. Raises TrainingError where the
    folder is of another training, and as loading tasks does.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        folder: Path,
        device: str = "auto",
        workers: int = 0,
        address: str | None = None,
    ) -> None:
        self.settings = settings
        self.folder = folder
        library = ShapeLibrary.open(settings.library)
        self._tasks: str | tuple[Task, ...] = FRESH
        self._library = library
        if settings.packs != FRESH:
            self._tasks = load_tasks(settings.packs, library, settings.split)
        elif settings.split:
            self._library = library.split(settings.split)
        held_out = settings.validation_packs or settings.packs
        tasks = load_tasks(held_out, library, settings.validation)
        self._validation = tasks[: settings.validation_tasks]
        self._check_folder()
        self._device = on_device(device)
        made = partial(
            _env, self._tasks, self._library, self._env_settings(), settings, self._fields
        )
        makers = [made] * settings.envs
        self._envs: VecEnv = (
            RemoteEnvs(makers, workers, address) if workers else DummyVecEnv(list(makers))
        )
        self._model = self._new_model()
        self.curve: list[Point] = []
        self._returns: deque[float] = deque(maxlen=RECENT)
        self._running = np.zeros(settings.envs)
        self._restore()

    @property
    def steps(self) -> int:
        """Made so far."""
        return int(self._model.num_timesteps)

    @property
    def reward(self) -> float | None:
        """Mean return of the last `RECENT` training episodes."""
        return float(np.mean(self._returns)) if self._returns else None

    @property
    def best(self) -> Point | None:
        """The point of the curve with the highest validation reward."""
        return max(self.curve, key=lambda point: point.validation.mean, default=None)

    @property
    def policy(self) -> ActorCritic:
        """The networks as they are."""
        assert isinstance(self._model.policy, ActorCritic)
        return self._model.policy

    def run(self, on_progress: Callable[[Progress], None] = lambda progress: None) -> None:
        """Trains to the end; on_progress is called before each update, and at the end.

        Raises BusyError where another process is at work in the folder.
        """
        with claimed(self.folder / ".lock", self.folder):
            if not self.is_over:
                left = self.settings.steps - self.steps
                begins = "resumes" if self.steps else "starts"
                _log.info(
                    "%s: %s at step %d of %d", self.folder, begins, self.steps, self.settings.steps
                )
                started = time.monotonic()
                watch = _Watch(self, on_progress)
                self._model.learn(left, watch, reset_num_timesteps=self.steps == 0)
                self._model.lessons.clear()
                self.look()
                _log.info("%s: finished in %.1f s", self.folder, time.monotonic() - started)
        on_progress(Progress(self.steps, self.reward, self.best))

    def close(self) -> None:
        """Lets go of the environments, and of the cluster."""
        self._envs.close()

    @property
    def is_over(self) -> bool:
        return self.steps >= self.settings.steps and bool(self.curve)

    def look(self) -> None:
        """Validates if that is due, and writes a checkpoint if there was one, or it is time."""
        if self.settings.teacher is not None and self.steps >= self.settings.imitation:
            self._envs.env_method("set_wrapper_attr", "taught", False)
        due = self.steps // self.settings.validate_every + 1
        over = self.steps >= self.settings.steps
        if len(self.curve) < due or (over and self.curve[-1].steps < self.steps):
            self._validate()
            self._write()
        elif time.monotonic() - self._written > CHECKPOINT_SECONDS:
            self._write()

    def count(self, rewards: npt.NDArray[np.float32], over: npt.NDArray[np.bool_]) -> None:
        """Counts the rewards of a step in all environments."""
        self._running += rewards
        self._returns.extend(self._running[over].tolist())
        self._running[over] = 0

    @property
    def _fields(self) -> tuple[str, ...]:
        """What the network looks at."""
        fields = FIELDS if self.settings.network.policies == "all" else SHAPE_FIELDS
        observed = self.settings.observation == "placement-features"
        return tuple(name for name in fields if observed or name != "placement_features")

    def _env_settings(self) -> dict[str, Any]:
        """The settings of the environments, for training and for validation."""
        settings = self.settings
        fixed = {"rotation": "aligned", "location": "blbf"}
        return {
            "rules": settings.rules,
            "observation": settings.observation,
            **(fixed if settings.network.policies == "shape" else {}),
        }

    def _new_model(self) -> ImitationPPO:
        settings = self.settings
        model = ImitationPPO(
            ActorCritic,
            self._envs,
            learning_rate=settings.rate,
            n_steps=settings.rollout_steps,
            batch_size=settings.minibatch,
            n_epochs=settings.epochs,
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip,
            ent_coef=settings.entropy,
            vf_coef=settings.value,
            policy_kwargs={"settings": settings.network, "optimizer_kwargs": _ADAM},
            seed=settings.seed,
            device=self._device,
        )
        model.imitation = settings.imitation
        model.imitation_epochs = settings.imitation_epochs
        logs = self.folder / "tensorboard"
        model.set_logger(Logger(None, [TensorBoardOutputFormat(str(logs))]))
        return model

    def _validate(self) -> None:
        """Plays the validation tasks; keeps the weights where they are the best so far."""
        envs = PackItVectorEnv(VALIDATION_ENVS, tasks=self._validation, **self._env_settings())
        rollouts = evaluate_batched("validation", self._act, envs, seed=0)
        before = self.best
        point = Point(self.steps, self.reward, Estimate.of([r.total for r in rollouts]))
        self.curve.append(point)
        _log.info("step %d: validation reward %.3f", point.steps, point.validation.mean)
        if before is None or point.validation.mean > before.validation.mean:
            self._write_weights("best", point)
        self._write_weights("last", point)
        told = [each.to_json() for each in self.curve]
        replace_text(self.folder / CURVE_FILE, json.dumps(told, indent=1) + "\n")

    def _act(self, seen: Observation) -> npt.NDArray[np.int64]:
        fields = {name: seen[name] for name in self._fields}
        valid = seen["action_mask"].astype(bool)
        return log_probabilities(self.policy.actor, fields, valid).argmax(1)

    def _write_weights(self, name: str, point: Point) -> None:
        made = {"version": __version__, **self._told(), "point": point.to_json()}
        file = self.folder / f"{name}.safetensors"
        policy = self.policy
        write_weights(file, policy.actor, self.settings.network, policy.placement_features, made)

    def _told(self) -> dict[str, Any]:
        """What was asked for, and the digests of the tasks."""
        told: dict[str, Any] = {"settings": asdict(self.settings)}
        for name, tasks in (("tasks", self._tasks), ("validation", self._validation)):
            told[name] = tasks if isinstance(tasks, str) else _digest(tasks)
        told["library"] = asdict(LibraryRef.of(self._library))
        return json.loads(json.dumps(told))

    def _check_folder(self) -> None:
        file = self.folder / SETTINGS_FILE
        told = self._told()
        if not file.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            replace_text(file, json.dumps(told, indent=1) + "\n")
            return
        try:
            before = json.loads(file.read_text())
        except ValueError as error:
            raise TrainingError(f"{file} can't be read: {error}") from None
        if before != told:
            names = [
                f"{part}.{name}" if isinstance(told[part], dict) else part
                for part in told
                for name in (told[part] if isinstance(told[part], dict) else [part])
                if _at(before, part, name) != _at(told, part, name)
            ]
            raise TrainingError(
                f"{self.folder} holds a training with another {', '.join(names)}: "
                "choose another folder"
            )

    def _write(self) -> None:
        """Writes the checkpoint, whole or not at all."""
        policy, model = self.policy, self._model
        write_checkpoint(
            self.folder / CHECKPOINT,
            {"policy": policy.state_dict(), "optimizer": policy.optimizer.state_dict()},
            {
                "steps": self.steps,
                "updates": model._n_updates,
                "progress": model._current_progress_remaining,
                "starts": np.asarray(model._last_episode_starts).tolist(),
                "envs": self._envs.env_method("to_json"),
                "returns": list(self._returns),
                "running": self._running.tolist(),
                "curve": [point.to_json() for point in self.curve],
            },
        )
        self._written = time.monotonic()

    def _restore(self) -> None:
        """Goes on from the checkpoint, if there is one."""
        self._written = time.monotonic()
        found = read_checkpoint(self.folder / CHECKPOINT, self._device)
        assert isinstance(self._envs.action_space, spaces.Discrete)
        self._model.lessons = DaggerDataset(
            self.folder / "lessons",
            int(self._envs.action_space.n),
            0 if found is None else found[1]["steps"],
        )
        if found is None:
            return
        tensors, told = found
        model = self._model
        self.policy.load_state_dict(tensors["policy"])
        self.policy.optimizer.load_state_dict(tensors["optimizer"])
        model.num_timesteps, model._n_updates = told["steps"], told["updates"]
        model._current_progress_remaining = told["progress"]
        seen = [
            self._envs.env_method("restore", state, indices=[n])[0]
            for n, state in enumerate(told["envs"])
        ]
        model._last_obs = {name: np.stack([each[name] for each in seen]) for name in seen[0]}
        model._last_episode_starts = np.array(told["starts"], dtype=bool)
        self._returns.extend(told["returns"])
        self._running[:] = told["running"]
        self.curve = [Point.from_json(point) for point in told["curve"]]


class _Watch(BaseCallback):
    """Looks after a training between PPO's updates."""

    def __init__(self, training: Training, on_progress: Callable[[Progress], None]) -> None:
        super().__init__()
        self._training = training
        self._on_progress = on_progress

    def _on_rollout_start(self) -> None:
        self._training.look()
        training = self._training
        self._on_progress(Progress(training.steps, training.reward, training.best))

    def _on_step(self) -> bool:
        self._training.count(self.locals["rewards"], self.locals["dones"])
        return True

    def _on_rollout_end(self) -> None:
        if self._training.reward is not None:
            self.logger.record("rollout/return", self._training.reward)


def _env(
    tasks: str | tuple[Task, ...],
    library: ShapeLibrary,
    env_settings: dict[str, Any],
    settings: TrainingSettings,
    fields: tuple[str, ...],
) -> ReplayableEnv:
    """An environment of a training, which tells what is among the fields."""
    source: str | Sequence[Task] | TaskMaker = tasks
    if settings.mixed and not isinstance(tasks, str):
        source = Mixture(tasks, library, settings.mixed)
    env: gym.Env[Any, Any] = PackItEnv(source, library, **env_settings)
    if settings.teacher is not None:
        env = LabellingEnv(env, settings.teacher, regrets=settings.regrets)
    if settings.augmented:
        env = AugmentedEnv(env)
    assert isinstance(env.observation_space, spaces.Dict)
    seen = env.observation_space.spaces
    return ReplayableEnv(FilterObservation(env, [n for n in (*fields, LESSON) if n in seen]))


def _digest(tasks: Sequence[Task]) -> str:
    """Of all tasks, in their order."""
    return hashlib.sha256("".join(task.digest for task in tasks).encode()).hexdigest()


def _at(told: dict[str, Any], part: str, name: str) -> Any:
    found = told.get(part)
    return found.get(name) if isinstance(found, dict) else found
