"""Learning from a teacher before learning from rewards.

The network plays, and at each state is told what the teacher would choose there (DAgger: Ross,
Gordon and Bagnell, 2011): it sees the states that its own play leads to, not the teacher's alone.
Or it is told what it would regret to choose (AggreVaTe: Ross and Bagnell, 2014): a network that
can't tell whether a shape has room must learn that a smaller one is the lesser evil.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from torch import Tensor, nn
from torch.nn import functional

from packit_sim.envs.env import PackItEnv
from packit_sim.envs.observations import Observation
from packit_sim.envs.policies import Agent

LESSON = "lesson"
"""The field of an observation that tells what the teacher would choose."""

SMALLER = 0.15
"""The regret of a shape of no volume that has room; of one that has none it is 1."""

IMPOSSIBLE = 2.0
"""Told for what may not be chosen."""


class TaughtEnv(gym.Wrapper[Observation, Any, Observation, Any]):
    """An environment whose observations tell what a teacher would choose.

    teacher: the name of an agent, whose policies are asked, not its search; what they do by chance
    is always the same chance. lesson: int64 (1,), the action. With `regrets`, where shapes alone
    are chosen and prospects observed, float32 (actions,) instead: 0 for the teacher's choice, 1 for
    what has no room, between them what is smaller. All 0 when the episode is over, and while
    `taught` is false: asking may take time.
    """

    def __init__(
        self, env: gym.Env[Observation, Any], teacher: str, *, regrets: bool = False
    ) -> None:
        super().__init__(env)
        self._teacher = Agent.from_name(teacher)
        self._regrets = regrets
        self.taught = True
        assert isinstance(env.observation_space, spaces.Dict)
        assert isinstance(env.action_space, spaces.Discrete)
        actions = int(env.action_space.n)
        lesson = (
            spaces.Box(0, IMPOSSIBLE, (actions,), np.float32)
            if regrets
            else spaces.Box(0, actions - 1, (1,), np.int64)
        )
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
        told = self.taught and episode.end is None
        if told:
            lesson = self._teacher.act(episode, np.random.default_rng(0))
        if not self._regrets:
            return {**seen, LESSON: np.array([lesson])}
        costs = _regrets(seen, lesson) if told else np.zeros(len(seen["outside"]), np.float32)
        return {**seen, LESSON: costs}


def _regrets(seen: Observation, best: int) -> npt.NDArray[np.float32]:
    """(n,) of each shape, as `TaughtEnv` tells them. best: the teacher's choice."""
    room, volumes = seen["prospects"][:, 0] > 0, seen["prospects"][:, 7]
    smaller = SMALLER * np.clip(1 - volumes / volumes[best], 0, 1)
    costs = np.where(seen["outside"], np.where(room, smaller, 1.0), IMPOSSIBLE)
    costs[best] = 0
    return costs.astype(np.float32)


class TaughtPPO(MaskablePPO):
    """MaskablePPO that for its first `imitation` steps imitates what its observations tell.

    It goes over what it has seen in a rollout `imitation_epochs` times: lessons are true wherever
    the policy goes meanwhile, other than advantages, and to ask for more of them costs more.

    Where they tell regrets, it is the choice of least regret at first, and less and less of it;
    what is to be expected of regret takes its place. Meanwhile the value network learns the
    returns, as always.
    """

    imitation = 0
    imitation_epochs = 4

    def train(self) -> None:
        if self.num_timesteps > self.imitation:
            super().train()
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        losses = [
            self._imitate(data)
            for _ in range(self.imitation_epochs)
            for data in self.rollout_buffer.get(self.batch_size)
        ]
        self._n_updates += self.imitation_epochs
        self.logger.record("train/imitation_loss", float(np.mean(losses)))

    def _imitate(self, data: Any) -> float:
        """A step on a minibatch; returns the loss of the actor."""
        seen = data.observations
        lessons: Tensor = seen[LESSON]
        distribution = self.policy.get_distribution(seen, data.action_masks)
        loss = self._loss(distribution, lessons)
        error = functional.mse_loss(self.policy.predict_values(seen).flatten(), data.returns)
        self.policy.optimizer.zero_grad()
        (loss + self.vf_coef * error).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()
        return float(loss.item())

    def _loss(self, distribution: Any, lessons: Tensor) -> Tensor:
        """Of the actor. lessons: (b, 1) choices, or (b, actions) regrets."""
        regrets = lessons.shape[1] > 1
        choices = lessons.argmin(1) if regrets else lessons.long().flatten()
        cross_entropy: Tensor = -distribution.log_prob(choices).mean()
        if not regrets:
            return cross_entropy
        expected = (distribution.distribution.probs * lessons).sum(1).mean()
        share = min(self.num_timesteps / self.imitation, 1.0)
        return (1 - share) * cross_entropy + share * expected
