"""Learning from a teacher before learning from rewards.

The network plays, and at each state is told what the teacher would choose there (DAgger: Ross,
Gordon and Bagnell, 2011): it sees the states that its own play leads to, not the teacher's alone.
Or it is told what it would regret to choose (AggreVaTe: Ross and Bagnell, 2014): a network that
can't tell whether a shape has room must learn that a smaller one is the lesser evil.
"""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.buffers import MaskableDictRolloutBuffer
from torch import Tensor, nn
from torch.nn import functional

from packit_agents.learning.dagger_dataset import DaggerDataset
from packit_sim.envs.env import PackItEnv
from packit_sim.envs.observations import Observation
from packit_sim.game.agents import Agent
from packit_sim.game.episode import Episode

LESSON = "lesson"
"""The field of an observation that tells what the teacher would choose."""

SMALLER = 0.15
"""The regret of a shape of no volume that has room; of one that has none it is 1."""

IMPOSSIBLE = 2.0
"""Told for what may not be chosen."""


class LabellingEnv(gym.Wrapper[Observation, Any, Observation, Any]):
    """An environment whose observations tell what a teacher would choose.

    teacher: the name of an agent, whose policies are asked, not its search; what they do by chance
    is always the same chance. lesson: int64 (1,), the action. With `regrets`, where shapes alone
    are chosen, float32 (actions,) instead: 0 for the teacher's choice, 1 for what does not fit (see
    `Episode.heuristic_placement`), between them what is smaller. All 0 when the episode is over,
    and while `taught` is false: asking may take time.
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
        shapes = len(seen["outside"])
        costs = _regrets(episode, lesson, shapes) if told else np.zeros(shapes, np.float32)
        return {**seen, LESSON: costs}


def _regrets(episode: Episode, best: int, shapes: int) -> npt.NDArray[np.float32]:
    """(shapes,), as `LabellingEnv` tells them. best: the teacher's choice."""
    items = episode.task.items
    costs = np.full(shapes, IMPOSSIBLE, dtype=np.float32)
    for n in np.flatnonzero(episode.outside).tolist():
        smaller = SMALLER * max(1 - items[n].volume / items[best].volume, 0.0)
        costs[n] = smaller if episode.heuristic_placement(n) else 1.0
    costs[best] = 0
    return costs


class ImitationPPO(MaskablePPO):
    """MaskablePPO that for its first `imitation` steps imitates what its observations tell.

    It goes over all that it was told so far, `lessons`, in minibatches that are drawn by chance,
    after each rollout `imitation_epochs` times as many as the rollout has.

    Where they tell regrets, it is the choice of least regret at first, and less and less of it;
    what is to be expected of regret takes its place. Meanwhile the value network learns the
    returns, as always.
    """

    lessons: DaggerDataset
    imitation = 0
    imitation_epochs = 4

    def train(self) -> None:
        if self.num_timesteps > self.imitation:
            self.lessons.clear()
            super().train()
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        buffer = cast(MaskableDictRolloutBuffer, self.rollout_buffer)
        size = cast(int, self.batch_size)
        self.lessons.add(self.num_timesteps, buffer)
        minibatches = self.imitation_epochs * -(-self.n_steps * self.n_envs // size)
        losses = [self._imitate(size) for _ in range(minibatches)]
        for _ in range(self.n_epochs):
            for data in buffer.get(size):
                values = self.policy.predict_values(data.observations).flatten()
                self._descend(functional.mse_loss(values, data.returns))
        self._n_updates += self.n_epochs
        self.logger.record("train/imitation_loss", float(np.mean(losses)))

    def _imitate(self, size: int) -> float:
        """A step of the actor on so many lessons; returns its loss."""
        seen, masks = self.lessons.draw(size)
        seen = {name: field.to(self.device) for name, field in seen.items()}
        loss = self._loss(self.policy.get_distribution(seen, masks.numpy()), seen[LESSON])
        self._descend(loss)
        return float(loss.item())

    def _descend(self, loss: Tensor) -> None:
        """A step of the optimizer, of what the loss hangs on alone."""
        self.policy.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()

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
