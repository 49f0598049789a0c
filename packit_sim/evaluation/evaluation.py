"""Agents play tasks: rollouts, and tables of them with intervals (paper, section 5)."""

from __future__ import annotations

import logging
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.datasets.packs import Task
from packit_sim.envs.observations import Observation
from packit_sim.evaluation.results import ResultsError, Rollout, check_same, opened
from packit_sim.game.agents import Agent
from packit_sim.game.episode import Episode
from packit_sim.rules import PACKIT, Rules

if TYPE_CHECKING:
    from packit_sim.core.parallel import Workers
    from packit_sim.envs.env import PackItEnv
    from packit_sim.envs.vector import PackItVectorEnv

_log = logging.getLogger(__name__)

SUCCESS_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""The x of Success@x."""

SLACK = 1e-9
"""How far a return may be below x and still count, or two differ and be equal: rounding of sums."""


@dataclass(frozen=True)
class Score:
    """An agent's row of the paper's table 1.

    tasks: how many. reward: Average Reward. success: Success@x in percent, for each x. density: of
    the boxes as they were left. seconds: the median for a task.
    """

    agent: str
    tasks: int
    reward: Estimate
    success: dict[float, Estimate]
    density: Estimate
    seconds: float

    @classmethod
    def of(cls, agent: str, rollouts: Iterable[Rollout]) -> Score:
        """The score over an agent's rollouts, which are one a task."""
        own = [rollout for rollout in rollouts if rollout.agent == agent]
        totals = np.array([rollout.total for rollout in own])
        return cls(
            agent,
            len(own),
            Estimate.of(totals),
            {x: Estimate.of(100.0 * (totals >= x - SLACK)) for x in SUCCESS_LEVELS},
            Estimate.of([rollout.pack.density for rollout in own]),
            float(np.median([rollout.seconds for rollout in own])),
        )


def compare(first: Iterable[Rollout], second: Iterable[Rollout]) -> Comparison:
    """The returns of one agent against those of another, on the tasks that both have played.

    Raises ValueError where there is none.
    """
    ours, theirs = ({rollout.task_digest: rollout.total for rollout in r} for r in (first, second))
    shared = [digest for digest in ours if digest in theirs]
    if not shared:
        raise ArgumentError("there is no task that both have played")
    return Comparison.of([ours[d] for d in shared], [theirs[d] for d in shared], SLACK)


def play(task: Task, agent: Agent, rng: np.random.Generator, *, rules: Rules = PACKIT) -> Episode:
    """Plays a task to its end."""
    episode = Episode(task, rules)
    agent.play(episode, rng)
    return episode


def evaluate(
    agents: Sequence[Agent],
    tasks: Sequence[Task],
    seed: int,
    on_rollout: Callable[[Rollout], None] = lambda rollout: None,
    *,
    rules: Rules = PACKIT,
    workers: Workers | None = None,
    file: Path | None = None,
) -> list[Rollout]:
    """Each agent plays each task once.

    A rollout's random numbers follow from the seed, the agent's name and the task's number alone,
    so that it is the same whatever else is evaluated beside it, on however many workers. file: for
    the results, which are written as they come; what stands there already is not played again, and
    results of other agents stay. Raises ResultsError where it holds results of something else, or
    weights are others than at the start, and BusyError where another process is at work on it.
    """
    weights = {agent.name: agent.weights for agent in agents}
    with opened(file, list(weights)) as store:
        if file is not None:
            check_same(file, store.rollouts, weights, tasks, seed, rules)
        jobs = []
        for number, task in enumerate(tasks):
            missing = [agent for agent in agents if (agent.name, number) not in store]
            if missing:
                jobs.append((missing, task, number, seed, rules))
        playing = sum(len(missing) for missing, *_ in jobs)
        known = len(agents) * len(tasks) - playing
        _log.info(
            "%d agents, %d tasks: %d results exist, %d to play",
            len(agents),
            len(tasks),
            known,
            playing,
        )
        started = time.monotonic()
        played = starmap(_played, jobs) if workers is None else workers.as_done(_played, jobs)
        for rollouts in played:
            for rollout in rollouts:
                if rollout.weights != weights[rollout.agent]:
                    raise ResultsError(
                        f"weights of {rollout.agent} were written anew while it played: "
                        f"{rollout.weights}, not {weights[rollout.agent]}"
                    )
                _log.debug("task %d, %s: return %.3f", rollout.task, rollout.agent, rollout.total)
                on_rollout(rollout)
            store.add(rollouts)
        _log.info("%d results in %.1f s", playing, time.monotonic() - started)
        return [store[agent.name, number] for agent in agents for number in range(len(tasks))]


def _played(
    agents: Sequence[Agent], task: Task, number: int, seed: int, rules: Rules
) -> list[Rollout]:
    """A task by several agents."""
    rollouts = []
    for agent in agents:
        started = time.perf_counter()
        episode = play(task, agent, _stream(agent.name, seed, number), rules=rules)
        seconds = time.perf_counter() - started
        rollouts.append(Rollout.of(episode, agent.name, number, seed, seconds, agent.weights))
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
    however many environments there are, as far as `act` is; their seconds are 0.
    """
    waiting = iter(range(len(envs.tasks)))
    playing: dict[PackItEnv, tuple[int, Observation]] = {}
    rollouts: list[Rollout] = []

    def go_on(env: PackItEnv) -> None:
        """Lets an environment play the next task that leaves something to choose."""
        playing.pop(env, None)
        for number in waiting:
            stream = int(_stream(name, seed, number).integers(2**32))
            seen, _ = env.reset(seed=stream, options={"task": number})
            if env.episode.end is None:
                playing[env] = number, seen
                return
            finish(env, number)

    def finish(env: PackItEnv, number: int) -> None:
        rollouts.append(Rollout.of(env.episode, name, number, seed, 0.0))
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


def _stream(agent: str, seed: int, task: int) -> np.random.Generator:
    """The random numbers of a rollout."""
    return np.random.default_rng((seed, zlib.crc32(agent.encode()), task))
