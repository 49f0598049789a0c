"""Measure how fast stable-baselines3 trains on `PackIt-v0`, by policy and features extractor.

    .venv/bin/python -m benchmarks.learning_speed

The environment chooses shapes from features and plays the starter packs, in one process. The cases
take turns in each round, after one episode of each task has filled the engine's caches, so that all
of them see the same load of the machine; steps per CPU second depend little on that load. Prints
medians over the rounds, and writes `benchmarks/results/learning_speed.json`.

    .venv/bin/python -m benchmarks.learning_speed --curve 20480 --cases "ActorCritic, example"

trains on the train split of everyday-v1 instead, and prints the Average Reward on its validation
split after every 5,120 steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import gymnasium
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from sb3_contrib import MaskablePPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from benchmarks.common import argument_parser, machine, write_json
from benchmarks.env import play_random
from packit_agents.learning.actor_critic import ActorCritic
from packit_agents.learning.features_extractor import ShapeSetExtractor
from packit_agents.learning.networks import NetworkSettings
from packit_sim import PackItVectorEnv, ShapeLibrary, evaluate_batched, load_tasks
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.observations import Observation
from packit_sim.game.envs.wrappers import flattened

SETTINGS: dict[str, Any] = {"rotation": "aligned", "location": "blbf", "observation": "features"}

AIM = 150
"""Steps per second with the extractor."""

SMALL = NetworkSettings(width=64, encoder_blocks=1, trunk_blocks=1)

SHARED = {"features_extractor_class": ShapeSetExtractor}

EXAMPLE: dict[str, Any] = {"n_steps": 64, "n_epochs": 4, "gamma": 1.0}
"""Settings of the example in docs/start/train.md, with 8 environments."""

CASES: dict[str, tuple[Any, dict[str, Any], int, bool]] = {
    "MlpPolicy, flattened": ("MlpPolicy", {}, 1, True),
    "MultiInputPolicy": ("MultiInputPolicy", {}, 1, False),
    "MultiInputPolicy, example": ("MultiInputPolicy", {}, 8, False),
    "MultiInputPolicy, ShapeSetExtractor": ("MultiInputPolicy", SHARED, 1, False),
    "MultiInputPolicy, ShapeSetExtractor, example": ("MultiInputPolicy", SHARED, 8, False),
    "ActorCritic, example": (ActorCritic, {}, 8, False),
    "ActorCritic, small, example": (ActorCritic, {"settings": SMALL}, 8, False),
}
"""Policy, its keyword arguments, number of environments, and whether observations are flattened."""

BETWEEN = 5120
"""Steps between two points of a learning curve."""

ROLLOUT = 512
"""Steps of all environments between two updates."""


def steps_a_second(case: str, library: ShapeLibrary, steps: int, seed: int) -> dict[str, float]:
    """Train for some steps; return steps per second, and shares of environments and updates."""
    policy, keywords, count, flat = CASES[case]
    settings = EXAMPLE if count > 1 else {"n_steps": ROLLOUT}
    envs = make_vec_env(
        "packit_sim:PackIt-v0",
        count,
        seed=seed,
        env_kwargs={"library": library, **SETTINGS},
        wrapper_class=flattened if flat else None,
    )
    model = MaskablePPO(policy, envs, policy_kwargs=keywords, seed=seed, device="cpu", **settings)
    spent = {"environments": 0.0, "updates": 0.0}
    with (
        mock.patch.object(VecEnv, "step", _timed(VecEnv.step, "environments", spent)),
        mock.patch.object(MaskablePPO, "train", _timed(MaskablePPO.train, "updates", spent)),
    ):
        started, cpu = time.perf_counter(), time.process_time()
        model.learn(steps)
        seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    shares = {part: each / seconds for part, each in spent.items()}
    parameters = sum(each.numel() for each in model.policy.parameters())
    done = model.num_timesteps
    return {
        "steps/s": done / seconds,
        "steps/CPU s": done / cpu,
        **shares,
        "parameters": parameters,
    }


def learning_curve(case: str, library: ShapeLibrary, steps: int) -> None:
    """Train on everyday-v1, and print the reward on its validation tasks as training goes on."""
    policy, keywords, count, flat = CASES[case]
    assert count > 1 and not flat, "only cases with the settings of the example"
    settings = {"library": library, **SETTINGS}
    train = {"tasks": "everyday-v1", "split": "train", **settings}
    envs = make_vec_env("packit_sim:PackIt-v0", count, seed=0, env_kwargs=train)
    model = MaskablePPO(policy, envs, policy_kwargs=keywords, seed=0, device="cpu", **EXAMPLE)
    tasks = load_tasks("everyday-v1", library, "validation")

    def act(observations: Observation) -> Any:
        masks = observations["action_mask"].astype(bool)
        return model.predict(observations, action_masks=masks, deterministic=True)[0]

    spent = done = 0.0
    while True:
        test = PackItVectorEnv(16, tasks=tasks, **settings)
        rollouts = evaluate_batched("validation", act, test, seed=0)
        reward = format_estimate(Estimate.of([each.total for each in rollouts]), ".3f")
        print(f"{case}: {done:.0f} steps, {spent:.0f} CPU s: {reward}", flush=True)
        if done >= steps:
            return
        started = time.process_time()
        model.learn(BETWEEN, reset_num_timesteps=done == 0)
        spent, done = spent + time.process_time() - started, model.num_timesteps


def _timed(plain: Callable[..., Any], part: str, spent: dict[str, float]) -> Callable[..., Any]:
    def call(*args: Any) -> Any:
        started = time.perf_counter()
        try:
            return plain(*args)
        finally:
            spent[part] += time.perf_counter() - started

    return call


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="times that each case is measured")
    parser.add_argument("--steps", type=int, default=1024, help="steps of each measurement")
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES), metavar="CASE")
    parser.add_argument("--curve", type=int, metavar="STEPS", help="learning curves instead")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    library = ShapeLibrary.open("everyday")
    if arguments.curve is not None:
        for case in arguments.cases:
            learning_curve(case, library, arguments.curve)
        return
    env = PackItEnv(library=library, order="cycle", **SETTINGS)
    for _ in env.tasks:
        play_random(env, np.random.default_rng(0))
    runs: dict[str, list[dict[str, float]]] = {case: [] for case in arguments.cases}
    for number in range(arguments.rounds):
        for case, measured in runs.items():
            measured.append(steps_a_second(case, library, arguments.steps, number))
            print(f"round {number + 1}, {case}: {measured[-1]['steps/s']:.0f} steps/s", flush=True)
    table = Table(
        "policy", "parameters", "steps/s", "least to most", "steps/CPU s", "environments", "updates"
    )
    for case, measured in runs.items():
        rates = [each["steps/s"] for each in measured]
        middle = {part: float(np.median([m[part] for m in measured])) for part in measured[0]}
        table.add_row(
            case,
            f"{middle['parameters']:,.0f}",
            f"{middle['steps/s']:.0f}",
            f"{min(rates):.0f} to {max(rates):.0f}",
            f"{middle['steps/CPU s']:.0f}",
            f"{middle['environments']:.0%}",
            f"{middle['updates']:.0%}",
        )
    Console(width=120).print(table)
    result = {
        "command": f"python -m benchmarks.learning_speed --rounds {arguments.rounds} "
        f"--steps {arguments.steps} --threads {arguments.threads}",
        "machine": machine() | {"torch": torch.__version__, "threads": torch.get_num_threads()},
        "gymnasium": gymnasium.__version__,
        "aim": AIM,
        "runs": runs,
    }
    write_json(arguments.out / "learning_speed.json", result)


if __name__ == "__main__":
    main()
