"""Several boxes: they stand side by side along x, and no item is in two of them."""

import json
from itertools import product

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common import env_checker

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core.debugging import checking
from packit_sim.core.errors import ArgumentError, InfeasibleError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.results import read_results
from packit_sim.rules import Rules
from tests.test_online import blockout, sequence
from tests.zoo import ZOO, cube_of, fill, random_item

TWO = Rules(boxes=2)


def test_masks_are_those_of_boxes_of_their_own() -> None:
    rng = np.random.default_rng(0)
    both = Box((64, 32, 32), boxes=2)
    alone = [Box((32, 32, 32)) for _ in range(2)]
    fill(both, [random_item(ZOO, 0.5, rng) for _ in range(8)], rng)
    for one in both.placed:
        i, j, k = one.location
        alone[i // 8].place(one.item, (i % 8, j, k))
    assert all(box.placed for box in alone)
    for _ in range(4):
        item = random_item(ZOO, 0.3, rng)
        mask = np.concatenate([box.feasible(item) for box in alone])
        assert np.array_equal(both.feasible(item), mask)
        assert both.blbf(item) == placement.first(mask)
        for at in product(range(0, 16, 3), (0, 2), (0, 1)):
            assert both.is_feasible(item, at) == mask[at] == (not both.why_not(item, at))


def test_an_item_in_two_boxes_is_refused() -> None:
    box = Box((80, 40, 40), boxes=2)
    assert box.why_not(cube_of(20), (6, 0, 0)).walls == ("right",)
    with pytest.raises(InfeasibleError, match=r"at \(6, 0, 0\) would be in two of the 2 boxes"):
        box.place(cube_of(20), (6, 0, 0))
    with pytest.raises(ArgumentError, match="can't be divided into 3 boxes"):
        Box((80, 40, 40), boxes=3)


def test_a_task_is_packed_into_several_boxes() -> None:
    task = Task.of([cube_of(20)] * 3, (20, 20, 20))
    agent = Agent.from_name("largest-first/aligned/blbf")
    for boxes in (1, 2, 3):
        episode = Episode(task, Rules(boxes=boxes))
        with checking():
            agent.play(episode, np.random.default_rng(0))
        assert episode.total == pytest.approx(boxes / 3)
        assert episode.box.cells == (20 * boxes, 20, 20)
        assert episode.box.density == pytest.approx(1)
    assert Rules(boxes=2, cells=(40, 20, 20)).new_box((20, 20, 20)).cells == (80, 20, 20)


def test_environments_have_locations_in_all_boxes() -> None:
    tasks = [sequence(0, 9, 16)]
    settings = {"tasks": tasks, "boxes": 2, "support": 0.5, "observation": "features"}
    env = gymnasium.make("PackIt-v0", max_shapes=10, **settings)
    check_env(env.unwrapped, skip_render_check=True)
    for policies in ({"rotation": "aligned", "location": "blbf"}, {"location": "blbf"}):
        env_checker.check_env(PackItEnv(**settings | policies | {"observation": "none"}))
    assert env.unwrapped.cells == (32, 16, 16) and env.action_space.n == 8 * 4 * 4


def test_results_are_verified(tmp_path) -> None:
    file = tmp_path / "r.jsonl"
    evaluate(["largest-first/lowest/blbf"], [sequence(0, 14, 12)], 0, rules=TWO, file=file)
    assert verify_dataset(file, blockout()).is_valid
    (rollout,) = read_results(file)
    assert rollout.rules == TWO and rollout.pack.cells == (24, 12, 12)
    assert {one.location[0] // 3 for one in rollout.pack.items} == {0, 1}

    def forged(**changes) -> str:
        line = json.loads(file.read_text())
        line["provenance"]["rules"]["boxes"] = changes.pop("boxes", 2)
        line.update(changes)
        (tmp_path / "forged.jsonl").write_text(json.dumps(line) + "\n")
        report = verify_dataset(tmp_path / "forged.jsonl", blockout())
        return " ".join(map(str, report.problems))

    assert "are not those of task" in forged(boxes=1)
    assert "cells are not those of 4 boxes" in forged(boxes=4)
    items = json.loads(file.read_text())["items"]
    wide = next(n for n, one in enumerate(rollout.pack.items) if one.location[0] == 3)
    items[wide]["location"][0] = 2
    assert "is in two of its 2 boxes" in forged(items=items)


@pytest.mark.parametrize("boxes", [0, -1, 1.5, True, "2"])
def test_boxes_are_a_positive_integer(boxes) -> None:
    with pytest.raises(ArgumentError, match=r"boxes .* is not possible"):
        Rules(boxes=boxes)


def test_boxes_that_are_too_long_together_are_refused() -> None:
    with pytest.raises(ArgumentError, match="6 boxes of 100 cells along x are not possible"):
        Rules(boxes=6).new_box((100, 100, 100))
    with pytest.raises(ArgumentError, match="need items that stay on the grid"):
        Rules(boxes=2).changed(physics=True)
