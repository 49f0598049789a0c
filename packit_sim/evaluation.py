"""Agents play tasks: rollouts, and tables of them with intervals (paper, section 5)."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from packit_sim.episode import End, Episode
from packit_sim.observations import Observation
from packit_sim.packs import Pack, Task
from packit_sim.policies import Agent

if TYPE_CHECKING:
    from packit_sim.env import PackItEnv
    from packit_sim.vector import PackItVectorEnv

SUCCESS_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""The x of Success@x."""

SUCCESS_SLACK = 1e-9
"""How far a return may be below x and still count: rounding of sums."""

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Rollout:
    """One episode that was played: by whom, on which task, its return, why it ended, what it left.

    pack: the box as the agent left it, which can be verified and rendered like any pack.
    """

    agent: str
    task: int
    total: float
    end: End
    pack: Pack


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95% bootstrap interval; without an interval where the sample is one task."""

    mean: float
    low: float | None
    high: float | None

    @classmethod
    def of(cls, sample: npt.ArrayLike) -> Estimate:
        values = np.asarray(sample, dtype=float)
        mean = float(values.mean())
        if len(values) < 2:
            return cls(mean, None, None)
        if np.ptp(values) == 0:
            return cls(mean, mean, mean)
        from scipy import stats  # takes half a second to import: not for everyone who plays

        interval = stats.bootstrap(
            (values,),
            np.mean,
            confidence_level=CONFIDENCE,
            n_resamples=RESAMPLES,
            method="percentile",
            rng=np.random.default_rng(0),
        ).confidence_interval
        return cls(mean, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Score:
    """An agent's row of the paper's table 1.

    tasks: how many. reward: Average Reward. success: Success@x in percent, for each x.
    """

    agent: str
    tasks: int
    reward: Estimate
    success: dict[float, Estimate]

    @classmethod
    def of(cls, agent: str, rollouts: Sequence[Rollout]) -> Score:
        """The score over an agent's rollouts, which are one a task."""
        totals = np.array([r.total for r in rollouts if r.agent == agent])
        return cls(
            agent,
            len(totals),
            Estimate.of(totals),
            {x: Estimate.of(100.0 * (totals >= x - SUCCESS_SLACK)) for x in SUCCESS_LEVELS},
        )


def play(task: Task, agent: Agent, rng: np.random.Generator) -> Episode:
    """Plays a task to its end."""
    episode = Episode(task)
    while episode.end is None:
        episode.step(agent.act(episode, rng))
    return episode


def evaluate(
    agents: Sequence[Agent],
    tasks: Sequence[Task],
    seed: int,
    on_rollout: Callable[[Rollout], None] = lambda rollout: None,
) -> list[Rollout]:
    """Each agent plays each task once.

    A rollout's random numbers follow from the seed, the agent's name and the task's number alone,
    so that it is the same whatever else is evaluated beside it.
    """
    rollouts = []
    for agent in agents:
        for number, task in enumerate(tasks):
            rng = np.random.default_rng(_seeds(agent.name, seed, number))
            rollouts.append(_rollout(agent.name, seed, number, play(task, agent, rng)))
            on_rollout(rollouts[-1])
    return rollouts


def evaluate_batched(
    name: str,
    act: Callable[[Observation], npt.NDArray[np.integer[Any]]],
    envs: PackItVectorEnv,
    seed: int,
    on_rollout: Callable[[Rollout], None] = lambda rollout: None,
) -> list[Rollout]:
    """One agent plays each task of environments once, in batches: for networks.

    act: takes the observations of n environments, each field with n for its first axis, and returns
    n actions. Each environment goes on to the next task when it is through with one; so n is at
    most their number, and less at the end. The rollouts are in the order of tasks, and the same
    however many environments there are, as far as `act` is.
    """
    waiting = iter(range(len(envs.tasks)))
    playing: dict[PackItEnv, tuple[int, Observation]] = {}
    rollouts: list[Rollout] = []

    def go_on(env: PackItEnv) -> None:
        """Lets an environment play the next task that leaves something to choose."""
        playing.pop(env, None)
        for number in waiting:
            stream = np.random.SeedSequence(_seeds(name, seed, number))
            seen, _ = env.reset(seed=int(stream.generate_state(1)[0]), options={"task": number})
            if env.episode.end is None:
                playing[env] = number, seen
                return
            finish(env, number)

    def finish(env: PackItEnv, number: int) -> None:
        rollouts.append(_rollout(name, seed, number, env.episode))
        on_rollout(rollouts[-1])

    for env in envs.members:
        go_on(env)
    while playing:
        observed = [seen for _, seen in playing.values()]
        batch = {key: np.stack([seen[key] for seen in observed]) for key in observed[0]}
        actions = act(batch)
        for (env, (number, _)), action in zip(list(playing.items()), actions, strict=True):
            seen, _, over, _, _ = env.step(int(action))
            playing[env] = number, seen
            if over:
                finish(env, number)
                go_on(env)
    return sorted(rollouts, key=lambda rollout: rollout.task)


def _seeds(agent: str, seed: int, task: int) -> tuple[int, int, int]:
    """What the random numbers of a rollout follow from."""
    return seed, zlib.crc32(agent.encode()), task


def _rollout(agent: str, seed: int, number: int, episode: Episode) -> Rollout:
    """The record of an episode that is over."""
    assert episode.end is not None
    made = {"by": agent, "seed": seed, "task": number, "return": episode.total}
    pack = Pack.of(episode.box, episode.task.pack.library, **made)
    return Rollout(agent, number, episode.total, episode.end, pack)
