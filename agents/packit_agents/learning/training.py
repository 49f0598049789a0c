"""Training of PackNN with PPO (paper, section 5), reproducible and resumable after any kill."""

from __future__ import annotations

import hashlib
import json
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
from packit_agents.learning.checkpoints import (
    CheckpointState,
    ReplayableEnv,
    read_checkpoint,
    write_checkpoint,
)
from packit_agents.learning.dagger_dataset import DaggerDataset
from packit_agents.learning.imitation import LABEL, ImitationPPO, LabellingEnv
from packit_agents.learning.learned_policies import FIELDS, SHAPE_FIELDS, log_probabilities
from packit_agents.learning.loggers import open_loggers, require_loggers
from packit_agents.learning.mixing import Mixture
from packit_agents.learning.remote_envs import RemoteEnvs
from packit_agents.learning.run_folder import RunFolder
from packit_agents.learning.training_settings import TrainingSettings
from packit_sim.core.confidence import Estimate
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.silence import quiet_threads
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import LibraryRef, Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.observations import Observation
from packit_sim.game.envs.task_source import FRESH, TaskMaker
from packit_sim.game.envs.vector import PackItVectorEnv
from packit_sim.game.evaluation.evaluation import evaluate_batched
from packit_sim.game.evaluation.learning_curves import CurvePoint
from packit_sim.libraries.library import ShapeLibrary

_log = plain_logger(__name__)

RECENT = 200
"""Number of episodes whose mean return is reported."""

VALIDATION_ENVS = 16
"""Number of environments in validation."""

CHECKPOINT_SECONDS = 30.0
"""Seconds between two checkpoints. A kill loses this much work, and one update."""


@dataclass(frozen=True)
class Progress:
    """The progress of a training.

    Attributes
    ----------
    steps : int
        Steps so far.
    reward : float, optional
        Mean return of the latest training episodes, None before one has ended.
    best : CurvePoint, optional
        The best point of the learning curve so far.
    """

    steps: int
    reward: float | None
    best: CurvePoint | None


class Training:
    """A training in its own folder; the same settings give the same weights.

    Parameters
    ----------
    folder : Path
        A new folder, or that of a training with the same settings, which resumes.
    device : str
        "cpu", "cuda" or "auto".
    workers : int
        Processes of a Ray cluster for the environments; 0 keeps them in this process. The
        weights do not depend on it.
    address : str, optional
        Address of the cluster's head.
    loggers : sequence of str
        Names of loggers, besides TensorBoard's (see `loggers`). The weights do not depend on them.

    Raises
    ------
    TrainingError
        If the folder holds a training with other settings.

    Notes
    -----
    The folder holds `settings.json` (settings and digests of the tasks), `checkpoint.pt`,
    `dagger_dataset` (labelled states while a teacher is imitated), `curve.json` (the learning
    curve), `best.safetensors` (the weights with the highest validation reward, the first of equal
    ones), `last.safetensors` and `tensorboard`.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        folder: Path,
        device: str = "auto",
        workers: int = 0,
        address: str | None = None,
        loggers: Sequence[str] = (),
    ) -> None:
        require_loggers(loggers)
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
        self._run = RunFolder(folder, self._provenance())
        self._device = on_device(device)
        record = json.loads(json.dumps(asdict(settings)))
        self._loggers = open_loggers(loggers, folder, record)
        maker = partial(
            _env, self._tasks, self._library, self._env_settings(), settings, self._fields
        )
        makers = [maker] * settings.envs
        self._envs: VecEnv = (
            RemoteEnvs(makers, workers, address) if workers else DummyVecEnv(list(makers))
        )
        self._model = self._new_model()
        self.curve: list[CurvePoint] = []
        self._returns: deque[float] = deque(maxlen=RECENT)
        self._running = np.zeros(settings.envs)
        self._restore()

    @property
    def steps(self) -> int:
        """Number of steps so far."""
        return int(self._model.num_timesteps)

    @property
    def reward(self) -> float | None:
        """Mean return of the last `RECENT` training episodes."""
        return float(np.mean(self._returns)) if self._returns else None

    @property
    def best(self) -> CurvePoint | None:
        """The point of the curve with the highest validation reward."""
        return max(self.curve, key=lambda point: point.validation.mean, default=None)

    @property
    def policy(self) -> ActorCritic:
        """The current networks."""
        assert isinstance(self._model.policy, ActorCritic)
        return self._model.policy

    def run(self, on_progress: Callable[[Progress], None] = lambda progress: None) -> None:
        """Train to the end.

        Parameters
        ----------
        on_progress : callable
            Called before each update and at the end.

        Raises
        ------
        BusyError
            If another process works in the folder.
        """
        with self._run.claim(), quiet_threads(OSError):  # TensorBoard's writer has a thread
            if not self.is_over:
                left = self.settings.steps - self.steps
                begins = "resumes" if self.steps else "starts"
                _log.info(
                    "%s: %s at step %d of %d", self.folder, begins, self.steps, self.settings.steps
                )
                started = time.monotonic()
                callback = _Callback(self, on_progress)
                self._model.learn(left, callback, reset_num_timesteps=self.steps == 0)
                self.checkpoint()
                self._model.logger.dump(self.steps)
                _log.info("%s: finished in %.1f s", self.folder, time.monotonic() - started)
            self._model.dataset.clear()
        on_progress(Progress(self.steps, self.reward, self.best))

    def close(self) -> None:
        """Close the environments and the loggers, and disconnect from the cluster."""
        self._envs.close()
        for logger in self._loggers:
            logger.close()

    @property
    def is_over(self) -> bool:
        return self.steps >= self.settings.steps and bool(self.curve)

    def checkpoint(self) -> None:
        """Validate if it is due, and write a checkpoint after that or if it is time."""
        if self.settings.teacher is not None and self.steps >= self.settings.imitation:
            self._envs.env_method("set_wrapper_attr", "labelling", False)
        due = self.steps // self.settings.validate_every + 1
        over = self.steps >= self.settings.steps
        if len(self.curve) < due or (over and self.curve[-1].steps < self.steps):
            self._validate()
            self.write()
        elif time.monotonic() - self._written > CHECKPOINT_SECONDS:
            self.write()

    def count(self, rewards: npt.NDArray[np.float32], over: npt.NDArray[np.bool_]) -> None:
        """Add the rewards of a step to the returns.

        Parameters
        ----------
        rewards : ndarray
            float32 (envs,).
        over : ndarray
            bool (envs,), whether the episode has ended.
        """
        self._running += rewards
        self._returns.extend(self._running[over].tolist())
        self._running[over] = 0

    @property
    def _fields(self) -> tuple[str, ...]:
        """The observation fields of the network."""
        fields = FIELDS if self.settings.network.policies == "all" else SHAPE_FIELDS
        observed = self.settings.observation == "placement-features"
        return tuple(name for name in fields if observed or name != "placement_features")

    def _env_settings(self) -> dict[str, Any]:
        """Return the settings of the environments, for training and for validation."""
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
            policy_kwargs={"settings": settings.network},
            seed=settings.seed,
            device=self._device,
        )
        model.imitation = settings.imitation
        model.imitation_epochs = settings.imitation_epochs
        board = TensorBoardOutputFormat(str(self._run.logs))
        model.set_logger(Logger(None, [board, *self._loggers]))
        return model

    def _validate(self) -> None:
        """Play the validation tasks, and store the weights if they are the best so far."""
        envs = PackItVectorEnv(VALIDATION_ENVS, tasks=self._validation, **self._env_settings())
        rollouts = evaluate_batched("validation", self._act, envs, seed=0)
        before = self.best
        point = CurvePoint(self.steps, self.reward, Estimate.of([r.total for r in rollouts]))
        self.curve.append(point)
        self._model.logger.record("validation/return", point.validation.mean)
        _log.info("step %d: validation reward %.3f", point.steps, point.validation.mean)
        if before is None or point.validation.mean > before.validation.mean:
            self._run.write_weights("best", self.policy, point)
        self._run.write_weights("last", self.policy, point)
        self._run.write_curve(self.curve)

    def _act(self, observations: Observation) -> npt.NDArray[np.int64]:
        fields = {name: observations[name] for name in self._fields}
        valid = observations["action_mask"].astype(bool)
        return log_probabilities(self.policy.actor, fields, valid).argmax(1)

    def _provenance(self) -> dict[str, Any]:
        """Return the settings, and the digests of the tasks and the library."""
        record: dict[str, Any] = {"settings": asdict(self.settings)}
        for name, tasks in (("tasks", self._tasks), ("validation", self._validation)):
            record[name] = tasks if isinstance(tasks, str) else _digest(tasks)
        record["library"] = LibraryRef.of(self._library).facts()
        return json.loads(json.dumps(record))

    def write(self) -> None:
        """Write the checkpoint atomically, then delete the files that only earlier ones need."""
        policy, model = self.policy, self._model
        write_checkpoint(
            self._run.checkpoint,
            {"policy": policy.state_dict(), "optimizer": policy.optimizer.state_dict()},
            CheckpointState(
                steps=self.steps,
                updates=model._n_updates,
                progress=model._current_progress_remaining,
                starts=np.asarray(model._last_episode_starts).tolist(),
                envs=self._envs.env_method("replay"),
                returns=list(self._returns),
                running=self._running.tolist(),
                curve=self.curve,
            ),
        )
        self._written = time.monotonic()
        if self.steps > self.settings.imitation:
            model.dataset.clear()

    def _restore(self) -> None:
        """Resume from the checkpoint, if there is one."""
        self._written = time.monotonic()
        found = read_checkpoint(self._run.checkpoint, self._device)
        assert isinstance(self._envs.action_space, spaces.Discrete)
        self._model.dataset = DaggerDataset(
            self._run.dagger_dataset,
            int(self._envs.action_space.n),
            0 if found is None else found[1].steps,
        )
        if found is None:
            return
        tensors, state = found
        model = self._model
        self.policy.load_state_dict(tensors["policy"])
        self.policy.optimizer.load_state_dict(tensors["optimizer"])
        model.num_timesteps, model._n_updates = state.steps, state.updates
        model._current_progress_remaining = state.progress
        last = [
            self._envs.env_method("restore", env, indices=[n])[0]
            for n, env in enumerate(state.envs)
        ]
        model._last_obs = {name: np.stack([each[name] for each in last]) for name in last[0]}
        model._last_episode_starts = np.array(state.starts, dtype=bool)
        self._returns.extend(state.returns)
        self._running[:] = state.running
        self.curve = state.curve


class _Callback(BaseCallback):
    """Validates, writes checkpoints and reports progress between the updates of PPO."""

    def __init__(self, training: Training, on_progress: Callable[[Progress], None]) -> None:
        super().__init__()
        self._training = training
        self._on_progress = on_progress

    def _on_rollout_start(self) -> None:
        self._training.checkpoint()
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
    """Make an environment whose observations hold the given fields and the label."""
    source: str | Sequence[Task] | TaskMaker = tasks
    if settings.mixed and not isinstance(tasks, str):
        source = Mixture(tasks, library, settings.mixed)
    env: gym.Env[Any, Any] = PackItEnv(source, library, **env_settings)
    if settings.teacher is not None:
        env = LabellingEnv(env, settings.teacher, costs=settings.costs)
    if settings.augmented:
        env = AugmentedEnv(env)
    assert isinstance(env.observation_space, spaces.Dict)
    known = env.observation_space.spaces
    return ReplayableEnv(FilterObservation(env, [n for n in (*fields, LABEL) if n in known]))


def _digest(tasks: Sequence[Task]) -> str:
    """Compute the digest of all tasks, in their order."""
    return hashlib.sha256("".join(task.digest for task in tasks).encode()).hexdigest()
