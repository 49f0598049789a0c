"""Evaluation: agents play tasks, and get scores with intervals (paper, section 5)."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import check_range
from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.core.plain_text import plain_logger
from packit_sim.game.datasets.execution_checks import trajectories_folder
from packit_sim.game.datasets.packs import Task
from packit_sim.game.datasets.provenance import RETURN_SLACK, Improvement
from packit_sim.game.envs.observations import Observation
from packit_sim.game.episodes.agents import Agent, OnProgress
from packit_sim.game.episodes.episode import Episode, check_task
from packit_sim.game.evaluation.executed import executed
from packit_sim.game.evaluation.results import ResultsError, Rollout
from packit_sim.game.evaluation.results_store import check_evaluation, opened
from packit_sim.rules import PACKIT, Rules

if TYPE_CHECKING:
    from packit_sim.core.parallel import Workers
    from packit_sim.game.envs.env import PackItEnv
    from packit_sim.game.envs.vector import PackItVectorEnv

_log = plain_logger(__name__)

SUCCESS_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""The x of Success@x."""


@dataclass(frozen=True)
class Score:
    """An agent's row of the paper's table 1.

    Attributes
    ----------
    reward : Estimate
        Average Reward.
    success : dict[float, Estimate]
        Success@x in percent, by x.
    density : Estimate
        The mean density of the boxes at the end.
    seconds : float
        The median processor seconds of a task.

    Examples
    --------
    >>> from packit_sim import Score, evaluate, load_tasks
    >>> name = "largest-first/aligned/blbf"
    >>> score = Score.of(name, evaluate([name], load_tasks("starter")[:4], seed=0))
    >>> round(score.reward.mean, 3)
    0.838
    >>> score.success[0.5].mean  # percent
    100.0
    """

    agent: str
    tasks: int
    reward: Estimate
    success: dict[float, Estimate]
    density: Estimate
    seconds: float

    @classmethod
    def of(cls, agent: str, rollouts: Iterable[Rollout]) -> Score:
        """Score an agent's rollouts, one for each task."""
        own = [rollout for rollout in rollouts if rollout.agent == agent]
        totals = np.array([rollout.total for rollout in own])
        return cls(
            agent,
            len(own),
            Estimate.of(totals),
            {x: Estimate.of(100.0 * (totals >= x - RETURN_SLACK)) for x in SUCCESS_LEVELS},
            Estimate.of([rollout.pack.density for rollout in own]),
            float(np.median([rollout.seconds for rollout in own])),
        )


def compare(
    first: Iterable[Rollout], second: Iterable[Rollout], seconds: float | None = None
) -> Comparison:
    """Compare the returns of two agents on the tasks that both have played.

    Parameters
    ----------
    first : Iterable[Rollout]
        The results of one agent.
    second : Iterable[Rollout]
        The results of the other.
    seconds : float, optional
        Compare their returns after this number of processor seconds (`Rollout.return_after`), not
        what they reached at the end.

    Returns
    -------
    Comparison
        The first compared with the second.

    Raises
    ------
    ArgumentError
        If there is no such task.

    Examples
    --------
    >>> from packit_sim import compare, evaluate, load_tasks
    >>> tasks = load_tasks("starter")[:4]
    >>> largest = evaluate(["largest-first/aligned/blbf"], tasks, seed=0)
    >>> random = evaluate(["random/aligned/blbf"], tasks, seed=0)
    >>> comparison = compare(largest, random)
    >>> comparison.wins, comparison.losses
    (4, 0)
    >>> round(comparison.difference.mean, 3)
    0.196
    """
    ours, theirs = (
        {
            each.task_digest: each.total if seconds is None else each.return_after(seconds)
            for each in rollouts
        }
        for rollouts in (first, second)
    )
    shared = [digest for digest in ours if digest in theirs]
    if not shared:
        raise ArgumentError("there is no task that both have played")
    return Comparison.of([ours[d] for d in shared], [theirs[d] for d in shared], RETURN_SLACK)


def play(
    task: Task,
    agent: Agent,
    rng: np.random.Generator,
    *,
    rules: Rules = PACKIT,
    on_progress: OnProgress = lambda rollouts, best: None,
) -> Episode:
    """Let an agent play a task to its end.

    Parameters
    ----------
    on_progress : OnProgress
        Called by the agent's search, if it has one.

    Returns
    -------
    Episode
        The episode, which is over.

    Examples
    --------
    >>> import numpy as np
    >>> from packit_sim import Agent, load_tasks, play
    >>> agent = Agent.from_name("largest-first/aligned/blbf")
    >>> episode = play(load_tasks("starter")[0], agent, np.random.default_rng(0))
    >>> round(episode.total, 3), str(episode.end)
    (0.995, 'no room')
    """
    episode = Episode(task, rules)
    agent.play(episode, rng, on_progress)
    return episode


def evaluate(
    agents: Sequence[Agent | str],
    tasks: Sequence[Task],
    seed: int,
    on_rollout: Callable[[Rollout], None] = lambda rollout: None,
    *,
    rules: Rules = PACKIT,
    workers: Workers | int | None = None,
    file: Path | str | None = None,
    numbers: Sequence[int] | None = None,
) -> list[Rollout]:
    """Let each agent play each task once.

    Parameters
    ----------
    agents : Sequence[Agent | str]
        The agents, or their names, such as "largest-first/aligned/blbf".
    seed : int
        The seed of the evaluation.
    on_rollout : Callable[[Rollout], None]
        Called after each rollout.
    rules : Rules
        The rules to play by.
    workers : Workers | int | None
        The processes that play, or their number (0: one per core); by default this process plays.
    file : Path | str | None
        The file of results, which are written while they are played. Those that it contains are not
        played again, and results of other agents are kept.
    numbers : Sequence[int] | None
        The numbers of the tasks in their dataset; by default 0, 1, 2 and so on.

    Returns
    -------
    list[Rollout]
        The rollouts, by agent, then by task.

    Raises
    ------
    ArgumentError
        If an agent is not one, or there are not as many numbers as tasks.
    UnknownPolicyError
        If an agent's name is not known.
    ResultsError
        If the file contains results of another evaluation, or weights changed since the start.
    BusyError
        If another process works on the file.

    Notes
    -----
    The random numbers of a rollout depend only on the seed, the agent's name and the task's
    number. So it is the same with any other agents and tasks, on any number of workers.

    Examples
    --------
    >>> from packit_sim import evaluate, load_tasks
    >>> tasks = load_tasks("starter")[:2]
    >>> rollouts = evaluate(["largest-first/aligned/blbf", "random/aligned/blbf"], tasks, seed=0)
    >>> for rollout in rollouts:
    ...     print(rollout.agent, rollout.task, round(rollout.total, 3))
    largest-first/aligned/blbf 0 0.995
    largest-first/aligned/blbf 1 0.507
    random/aligned/blbf 0 0.709
    random/aligned/blbf 1 0.473
    """
    if isinstance(workers, int):
        from packit_sim.core.parallel import Workers

        with Workers(workers) as processes:
            return evaluate(
                agents,
                tasks,
                seed,
                on_rollout,
                rules=rules,
                workers=processes,
                file=file,
                numbers=numbers,
            )
    players = [_player(agent) for agent in ([agents] if isinstance(agents, str) else agents)]
    file = None if file is None else Path(file)
    numbers = range(len(tasks)) if numbers is None else numbers
    check_range(
        "numbers", numbers, (len(numbers) == len(tasks), f"one for each of the {len(tasks)} tasks")
    )
    numbered = dict(zip(numbers, tasks, strict=True))
    weights = {agent.name: agent.weights for agent in players}
    with opened(file, list(weights)) as store:
        if file is not None:
            known = {agent.name: agent.known_weights for agent in players}
            check_evaluation(file, store.rollouts, known, numbered, seed, rules)
        for agent in players:
            agent.check_rules(rules)
        for task in tasks:
            check_task(task, rules)
        folder = None if file is None else trajectories_folder(file)
        jobs = []
        for number, task in numbered.items():
            missing = [agent for agent in players if (agent.name, number) not in store]
            if missing:
                jobs.append((missing, task, number, seed, rules, folder))
        playing = sum(len(missing) for missing, *_ in jobs)
        counts = len(players), len(tasks), len(players) * len(tasks) - playing, playing
        _log.info("%d agents, %d tasks: %d results exist, %d to play", *counts)
        started = time.monotonic()
        played = starmap(_played, jobs) if workers is None else workers.as_done(_played, jobs)
        for rollouts in played:
            for rollout in rollouts:
                if rollout.weights != weights[rollout.agent]:
                    raise ResultsError(
                        f"the weights of {rollout.agent} changed during the evaluation: "
                        f"{rollout.weights}, not {weights[rollout.agent]}"
                    )
                _log.debug("task %d, %s: return %.3f", rollout.task, rollout.agent, rollout.total)
                on_rollout(rollout)
            store.add(rollouts)
        _log.info("%d results in %.1f s", playing, time.monotonic() - started)
        return [store[agent.name, number] for agent in players for number in numbered]


def _player(agent: Agent | str) -> Agent:
    if isinstance(agent, str):
        return Agent.from_name(agent)
    valid = 'an Agent, or a name such as "largest-first/aligned/blbf"'
    check_range("agent", agent, (isinstance(agent, Agent), valid))
    return agent


def _played(
    agents: Sequence[Agent], task: Task, number: int, seed: int, rules: Rules, folder: Path | None
) -> list[Rollout]:
    """Let several agents play a task."""
    return [_rollout(agent, task, number, seed, rules, folder) for agent in agents]


def _rollout(
    agent: Agent, task: Task, number: int, seed: int, rules: Rules, folder: Path | None
) -> Rollout:
    """Let an agent play a task, and record when its search found something better."""
    started = time.process_time()
    improvements: list[Improvement] = []

    def record(rollouts: int, best: float) -> None:
        if not improvements or best > improvements[-1].total:
            seconds = round(time.process_time() - started, 4)
            improvements.append(Improvement(seconds, float(best)))

    rng = _stream(agent.name, seed, number)
    episode = play(task, agent, rng, rules=rules, on_progress=record)
    seconds = time.process_time() - started
    weights = agent.weights
    execution = executed(episode, folder)
    return Rollout.of(episode, agent.name, number, seed, seconds, weights, improvements, execution)


def evaluate_batched(
    name: str,
    act: Callable[[Observation], npt.NDArray[np.integer[Any]]],
    envs: PackItVectorEnv,
    seed: int,
    on_rollout: Callable[[Rollout], None] = lambda rollout: None,
) -> list[Rollout]:
    """Let one agent play each task of environments once, in batches: for networks.

    Parameters
    ----------
    name : str
        The agent's name.
    act : Callable
        Takes the observations of n environments, a dict of arrays with n as first axis, and returns
        n actions. At the end n is less than the number of environments.
    envs : PackItVectorEnv
        The environments. Each starts the next task as soon as it has finished one.
    seed : int
        The seed of the evaluation.
    on_rollout : Callable[[Rollout], None]
        Called after each rollout.

    Returns
    -------
    list[Rollout]
        The rollouts in the order of tasks, with 0 seconds each. They do not depend on the number of
        environments, provided that the actions do not.

    Examples
    --------
    >>> from packit_sim import PackItVectorEnv, evaluate_batched, load_tasks
    >>> settings = {"observation": "none", "rotation": "aligned", "location": "blbf"}
    >>> envs = PackItVectorEnv(2, tasks=load_tasks("starter")[:3], **settings)
    >>> rollouts = evaluate_batched(
    ...     "first shape", lambda seen: seen["action_mask"].argmax(axis=1), envs, seed=0
    ... )
    >>> [round(rollout.total, 3) for rollout in rollouts]
    [0.475, 0.453, 0.569]
    """
    waiting = iter(range(len(envs.tasks)))
    playing: dict[PackItEnv, tuple[int, Observation]] = {}
    rollouts: list[Rollout] = []

    def start_next(env: PackItEnv) -> None:
        """Start the next task in which the agent has something to choose."""
        playing.pop(env, None)
        for number in waiting:
            stream = int(_stream(name, seed, number).integers(2**32))
            observation, _ = env.reset(seed=stream, options={"task": number})
            if env.episode.end is None:
                playing[env] = number, observation
                return
            finish(env, number)

    def finish(env: PackItEnv, number: int) -> None:
        rollouts.append(Rollout.of(env.episode, name, number, seed, 0.0))
        on_rollout(rollouts[-1])

    for env in envs.members:
        start_next(env)
    while playing:
        observed = [observation for _, observation in playing.values()]
        batch = {key: np.stack([each[key] for each in observed]) for key in observed[0]}
        actions = act(batch)
        for (env, (number, _)), action in zip(list(playing.items()), actions, strict=True):
            observation, _, over, _, _ = env.step(int(action))
            playing[env] = number, observation
            if over:
                finish(env, number)
                start_next(env)
    return sorted(rollouts, key=lambda rollout: rollout.task)


def _stream(agent: str, seed: int, task: int) -> np.random.Generator:
    """Return the random numbers of a rollout."""
    return np.random.default_rng((seed, zlib.crc32(agent.encode()), task))
