"""Learning from a teacher before learning from rewards.

The network plays, and at each state is told what the teacher would choose there (DAgger: Ross,
Gordon and Bagnell, 2011): it sees the states that its own play leads to, not the teacher's alone.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from torch import Tensor, nn
from torch.nn import functional

from packit_sim.envs.env import PackItEnv
from packit_sim.envs.observations import Observation
from packit_sim.envs.policies import Agent

LESSON = "lesson"
"""The field of an observation that tells what the teacher would choose."""


class TaughtEnv(gym.Wrapper[Observation, Any, Observation, Any]):
    """An environment whose observations tell what a teacher would choose.

    teacher: the name of an agent, whose policies are asked, not its search; what they do by chance
    is always the same chance. lesson: int64 (1,), the action; 0 when the episode is over, and while
    `taught` is false: asking may take time.
    """

    def __init__(self, env: gym.Env[Observation, Any], teacher: str) -> None:
        super().__init__(env)
        self._teacher = Agent.from_name(teacher)
        self.taught = True
        assert isinstance(env.observation_space, spaces.Dict)
        assert isinstance(env.action_space, spaces.Discrete)
        lesson = spaces.Box(0, int(env.action_space.n) - 1, (1,), np.int64)
        self.observation_space = spaces.Dict({**env.observation_space.spaces, LESSON: lesson})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        seen, info = self.env.reset(seed=seed, options=options)
        return self._with_lesson(seen), info

    def step(self, action: Any) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        seen, reward, terminated, truncated, info = self.env.step(action)
        return self._with_lesson(seen), reward, terminated, truncated, info

    def _with_lesson(self, seen: Observation) -> Observation:
        env = self.env.unwrapped
        assert isinstance(env, PackItEnv)
        episode, lesson = env.episode, 0
        if self.taught and episode.end is None:
            lesson = self._teacher.act(episode, np.random.default_rng(0))
        return {**seen, LESSON: np.array([lesson])}


class TaughtPPO(MaskablePPO):
    """MaskablePPO that for its first `imitation` steps imitates what its observations tell.

    Meanwhile the value network learns the returns, as always.
    """

    imitation = 0

    def train(self) -> None:
        if self.num_timesteps > self.imitation:
            super().train()
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        losses = [
            self._imitate(data)
            for _ in range(self.n_epochs)
            for data in self.rollout_buffer.get(self.batch_size)
        ]
        self._n_updates += self.n_epochs
        self.logger.record("train/imitation_loss", float(np.mean(losses)))

    def _imitate(self, data: Any) -> float:
        """A step on a minibatch; returns the cross-entropy with the teacher."""
        seen = data.observations
        lessons: Tensor = seen[LESSON].long().flatten()  # (b,)
        distribution = self.policy.get_distribution(seen, data.action_masks)
        cross_entropy = -distribution.log_prob(lessons).mean()
        error = functional.mse_loss(self.policy.predict_values(seen).flatten(), data.returns)
        self.policy.optimizer.zero_grad()
        (cross_entropy + self.vf_coef * error).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()
        return float(cross_entropy.item())
