"""Values of items: the return counts them instead of volumes, and records keep them."""

import json

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from msgspec import structs
from stable_baselines3.common import env_checker

from packit_sim.core.debugging import checking
from packit_sim.core.errors import ArgumentError, PackFormatError, PackItError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.pack_files import load_tasks, write_packs
from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.results import check_results, read_results
from packit_sim.game.explorer.collection import PackCollection
from packit_sim.geometry.shapes import Item
from packit_sim.rules import Rules
from tests.test_online import blockout, sequence
from tests.zoo import cube_of

VALUES = Rules(values=True)
AGENT = "largest-first/aligned/blbf"


def by_volume(item: Item) -> float:
    """A value that grows faster than the volume."""
    return float(round(1e5 * item.volume) ** 2)


def valued(seed: int = 0, items: int = 9) -> Task:
    return sequence(seed, items, 16).valued(by_volume)


def test_the_reward_is_the_share_of_the_value() -> None:
    task = Task.of([cube_of(20), cube_of(8), cube_of(8)], (40, 40, 40))
    task = task.valued(lambda item: 6 if item.cells[0] == 20 else 2)
    assert task.values == (2, 2, 6)
    with checking():
        episode = Episode(task, VALUES)
        rewards = [episode.step(action) for action in (2, 0, 0, 0, 0, 8)]
    assert rewards == pytest.approx([0, 0, 0.6, 0, 0, 0.2])
    state = episode.state()
    for action in (1, 0, 500):
        episode.step(action)
    assert episode.total == pytest.approx(1)
    episode.restore(state)
    assert episode.total == pytest.approx(0.8)


def test_values_make_another_task_and_volumes_are_the_default() -> None:
    plain, task = sequence(0, 9, 16), valued()
    assert plain.values == () and len(task.values) == len(task.items)
    assert task.digest != plain.digest and task.valued(lambda item: 1.0).digest != task.digest
    assert task.pack.valued({}) == plain.pack
    (one,), (other,) = (evaluate([AGENT], [each], seed=0) for each in (plain, task))
    assert one.total == other.total


@pytest.mark.parametrize("value", [0, -1.0, 1e13, float("nan"), float("inf"), "5"])
def test_a_value_is_a_positive_number(value) -> None:
    with pytest.raises(ArgumentError, match=r"'cube' .* not possible: above 0, at most 1e\+12"):
        Task.of([cube_of(8)], (40, 40, 40)).valued(lambda item: value)


def test_a_task_without_values_is_refused_before_anything_is_played() -> None:
    for play in (
        lambda: Episode(sequence(), VALUES),
        lambda: PackItEnv([sequence()], values=True, observation="none"),
        lambda: evaluate([AGENT], [sequence()], 0, rules=VALUES),
    ):
        with pytest.raises(ArgumentError, match="have no values, which the rules PackIt, values"):
            play()


def test_values_are_the_same_after_a_way_through_files(tmp_path) -> None:
    task = valued()
    write_packs(tmp_path / "packs.jsonl", [task.pack])
    (loaded,) = load_tasks(tmp_path / "packs.jsonl", blockout())
    assert (loaded.values, loaded.digest) == (task.values, task.digest)
    assert verify_dataset(tmp_path / "packs.jsonl", blockout()).is_valid
    line = json.loads(task.pack.to_json())
    assert set(line["outside"][0]) == {"shape", "scale", "value"}
    assert "value" not in sequence().pack.to_json()


@pytest.mark.parametrize("change", [{"value": 77.0}, {"value": None}])
def test_equal_items_have_equal_values(change) -> None:
    pack = valued(items=30).pack
    kinds = [one.kind for one in pack.outside]
    n = next(n for n, kind in enumerate(kinds) if kinds.count(kind) > 1)
    changed = [*pack.outside]
    changed[n] = structs.replace(changed[n], **change)
    line = json.loads(pack.to_json())
    line["outside"] = [json.loads(json.dumps(structs.asdict(one))) for one in changed]
    with pytest.raises(PackFormatError, match="either all items have values, equal ones the same"):
        Pack.from_json(json.dumps(line))


def test_a_value_in_a_file_has_the_same_bounds() -> None:
    line = json.loads(valued().pack.to_json())
    for one in (*line["items"], *line["outside"]):
        one["value"] = 1e308
    with pytest.raises(PackFormatError, match=r"value' is 1e\+308"):
        Pack.from_json(json.dumps(line))


def test_results_have_the_values_and_forged_ones_are_refused(tmp_path) -> None:
    file = tmp_path / "r.jsonl"
    rules = VALUES.changed(buffer=3, rotations="yaw")
    with checking():
        evaluate(
            ["largest-first/lowest/blbf"],
            [valued(n, 20) for n in range(2)],
            0,
            rules=rules,
            file=file,
        )
    rollouts = read_results(file)
    assert verify_dataset(file, blockout()).is_valid
    assert check_results(file, rollouts, blockout()) == 0
    for rollout in rollouts:
        pack = rollout.pack
        total = sum(pack.values[one.kind] for one in (*pack.items, *pack.outside))
        packed = sum(pack.values[one.kind] for one in pack.items)
        assert rollout.total == pytest.approx(packed / total)
    honest = json.loads(file.read_text().splitlines()[0])
    shape = honest["items"][0]["shape"]

    def raised(line: dict) -> None:
        for one in (*line["items"], *line.get("outside", ())):
            one["value"] *= 2 if one["shape"] == shape else 1

    def by_volumes(line: dict) -> None:
        line["provenance"]["rules"]["values"] = False

    def without(line: dict) -> None:
        for one in (*line["items"], *line.get("outside", ())):
            del one["value"]

    for change, problem in (
        (raised, "are not those of task"),
        (without, "are not those of task"),
        (by_volumes, "its return is recorded as"),
    ):
        line = json.loads(json.dumps(honest))
        change(line)
        forged = tmp_path / "forged.jsonl"
        forged.write_text(json.dumps(line) + "\n")
        with pytest.raises(PackItError, match=problem):
            check_results(forged, read_results(forged), blockout())


def test_a_search_plans_for_values_or_says_that_it_does_not(tmp_path) -> None:
    task = valued(2, 8)
    returns = [
        evaluate([f"largest-first/aligned/blbf{search}"], [task], 0, rules=VALUES)[0].total
        for search in ("", "+beam=3")
    ]
    assert returns[1] >= returns[0] > 0
    with pytest.raises(ArgumentError, match="as much volume as it can: no values"):
        evaluate(["champion+ruin-recreate=1"], [task], 0, rules=VALUES)


def test_environments_show_the_values_of_what_has_arrived() -> None:
    tasks = [valued(seed) for seed in range(2)]
    settings = {"tasks": tasks, "values": True, "buffer": 3, "observation": "none"}
    settings |= {"rotation": "aligned", "location": "blbf"}
    env = gymnasium.make("PackIt-v0", max_shapes=12, **settings)
    check_env(env.unwrapped, skip_render_check=True)
    env_checker.check_env(env.unwrapped)
    observation, _ = env.reset(seed=0)
    values = env.unwrapped.episode.task.values
    assert observation["values"].shape == (12,) and not observation["values"][3:].any()
    assert observation["values"][:3] == pytest.approx(np.array(values[:3]) / sum(values))
    assert "values" not in PackItEnv(tasks, observation="none").observation_space.spaces


def test_the_explorer_shows_shares_of_the_value() -> None:
    (rollout,) = evaluate([AGENT], [valued(3, 20)], 0, rules=VALUES)
    view = PackCollection([rollout.pack], blockout(), [])[0]
    shares = [view.reward(n) for n in range(len(view.items))]
    assert sum(shares) == pytest.approx(1)
    assert sum(shares[: len(view.placed)]) == pytest.approx(rollout.total)


def test_values_are_not_for_a_robot() -> None:
    with pytest.raises(ArgumentError, match="measured by volume: leave out values"):
        VALUES.changed(robot=True)


def test_values_of_a_pack_are_not_those_of_others() -> None:
    task = Task.of([cube_of(8)], (40, 40, 40))
    with pytest.raises(ArgumentError, match="other items than its pack"):
        Task((cube_of(20),), task.pack, ()).valued(lambda item: 1)
