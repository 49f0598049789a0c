"""Imitation of a teacher, before learning from rewards.

The network plays, and each state is labelled with the choice of a teacher (DAgger: Ross, Gordon and
Bagnell, 2011). So the states are those that the network's own play leads to. A label can also be
the cost of each choice (AggreVaTe: Ross and Bagnell, 2014): a network that does not observe whether
a shape fits must learn that a smaller shape is the lesser risk.
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
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.observations import Observation
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode

LABEL = "label"
"""The observation field that holds the label of a state."""

SMALLER = 0.15
"""Cost of a shape of volume 0 that fits; the cost of one that does not fit is 1."""

IMPOSSIBLE = 2.0
"""Cost of an action that is not valid."""


class LabellingEnv(gym.Wrapper[Observation, Any, Observation, Any]):
    """An environment whose observations hold a teacher's label.

    The field "label" is int64 (1,), the action that the teacher chooses. With `costs`, if only
    shapes are chosen, it is float32 (actions,): 0 for the teacher's choice, 1 for a shape that does
    not fit (see `Episode.heuristic_placement`), and in between for smaller shapes. It is 0 once
    the episode is over, and while the attribute `labelling` is false, since labels cost time.

    Parameters
    ----------
    env : gymnasium.Env
        The environment to wrap.
    teacher : str
        Name of an agent; its policies are queried, not its search, always with the same seed.
    costs : bool
        Whether the label holds the cost of each shape.
    """

    def __init__(
        self, env: gym.Env[Observation, Any], teacher: str, *, costs: bool = False
    ) -> None:
        super().__init__(env)
        self._teacher = Agent.from_name(teacher)
        self._costs = costs
        self.labelling = True
        assert isinstance(env.observation_space, spaces.Dict)
        assert isinstance(env.action_space, spaces.Discrete)
        actions = int(env.action_space.n)
        label = (
            spaces.Box(0, IMPOSSIBLE, (actions,), np.float32)
            if costs
            else spaces.Box(0, actions - 1, (1,), np.int64)
        )
        self.observation_space = spaces.Dict({**env.observation_space.spaces, LABEL: label})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        return self._labelled(observation), info

    def step(self, action: Any) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._labelled(observation), reward, terminated, truncated, info

    def _labelled(self, observation: Observation) -> Observation:
        env = self.env.unwrapped
        assert isinstance(env, PackItEnv)
        episode, choice = env.episode, 0
        labelling = self.labelling and episode.end is None
        if labelling:
            choice = self._teacher.act(episode, np.random.default_rng(0))
        if not self._costs:
            return {**observation, LABEL: np.array([choice])}
        shapes = len(observation["outside"])
        costs = _costs(episode, choice, shapes) if labelling else np.zeros(shapes, np.float32)
        return {**observation, LABEL: costs}


def _costs(episode: Episode, best: int, shapes: int) -> npt.NDArray[np.float32]:
    """(shapes,) costs; `best` is the teacher's choice."""
    items = episode.task.items
    costs = np.full(shapes, IMPOSSIBLE, dtype=np.float32)
    for n in np.flatnonzero(episode.visible).tolist():
        smaller = SMALLER * max(1 - items[n].volume / items[best].volume, 0.0)
        costs[n] = smaller if episode.heuristic_placement(n) else 1.0
    costs[best] = 0
    return costs


class ImitationPPO(MaskablePPO):
    """MaskablePPO that imitates the labels of its observations during its first steps.

    After each rollout the policy is trained on minibatches drawn from the DAgger dataset. With
    costs as labels the loss is the cross entropy of the cheapest choice at first, and gradually
    the expected cost. The value network learns the returns throughout.

    Attributes
    ----------
    dataset : DaggerDataset
        All labelled states so far.
    imitation : int
        Number of first steps during which labels are imitated.
    imitation_epochs : int
        Minibatches drawn after each rollout, as a multiple of those that the rollout holds.
    """

    dataset: DaggerDataset
    imitation = 0
    imitation_epochs = 4

    def train(self) -> None:
        """Update the networks after a rollout."""
        if self.num_timesteps > self.imitation:
            super().train()
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        buffer = cast(MaskableDictRolloutBuffer, self.rollout_buffer)
        size = cast(int, self.batch_size)
        self.dataset.add(self.num_timesteps, buffer)
        minibatches = self.imitation_epochs * -(-self.n_steps * self.n_envs // size)
        losses = [self._imitate(size) for _ in range(minibatches)]
        for _ in range(self.n_epochs):
            for data in buffer.get(size):
                values = self.policy.predict_values(data.observations).flatten()
                self._descend(functional.mse_loss(values, data.returns))
        self._n_updates += self.n_epochs
        self.logger.record("train/imitation_loss", float(np.mean(losses)))

    def _imitate(self, size: int) -> float:
        """Train the policy on one minibatch, and return its loss."""
        observations, masks = self.dataset.sample(size)
        observations = {name: field.to(self.device) for name, field in observations.items()}
        distribution = self.policy.get_distribution(observations, masks.numpy())
        loss = self.imitation_loss(distribution, observations[LABEL])
        self._descend(loss)
        return float(loss.item())

    def _descend(self, loss: Tensor) -> None:
        """Take one step of the optimizer."""
        self.policy.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()

    def imitation_loss(self, distribution: Any, labels: Tensor) -> Tensor:
        """Compute the policy's loss for labels (b, 1) of choices or (b, actions) of costs."""
        are_costs = labels.shape[1] > 1
        choices = labels.argmin(1) if are_costs else labels.long().flatten()
        cross_entropy: Tensor = -distribution.log_prob(choices).mean()
        if not are_costs:
            return cross_entropy
        expected = (distribution.distribution.probs * labels).sum(1).mean()
        share = min(self.num_timesteps / self.imitation, 1.0)
        return (1 - share) * cross_entropy + share * expected
