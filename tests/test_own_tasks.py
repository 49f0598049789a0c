"""Tasks of one's own: items of a given size, the order of tasks, and makers of tasks."""

import dataclasses
import pickle

import gymnasium as gym
import numpy as np
import pytest
import trimesh

from packit_sim.core.errors import ArgumentError, UnknownShapeError
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import load_tasks, read_packs, write_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.results import read_results, write_results
from packit_sim.game.generation.sequences import SequenceSampler
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from tests.zoo import cube_of

BRICK = Shape.from_mesh(trimesh.creation.box((3, 2, 1)), "brick")
AGENT = "largest-first/aligned/blbf"
COMMON = {"observation": "none", "max_shapes": 40}


@pytest.fixture(scope="module")
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter")[:4]


@pytest.mark.parametrize(
    ("size", "unit"), [(0.3, 1), ((0.3, 0.2, 0.1), 1), (12, 40), ([12.0, 8.0, 4.0], 40.0)]
)
def test_an_item_of_a_size_has_that_size(size, unit) -> None:
    assert Item.of_size(BRICK, size, unit).extents == pytest.approx([0.3, 0.2, 0.1])


@pytest.mark.parametrize(
    ("size", "unit", "message"),
    [
        (0, 1, "size 0.0 is not possible"),
        (float("nan"), 1, "size nan is not possible"),
        ((1, -2, 3), 1, r"size \[1.0, -2.0, 3.0\] is not possible"),
        (1, 0, "unit 0.0 is not possible"),
        ((1, 2, 3), 1, "not that of 'brick': its extents are as 3 x 2 x 1"),
        ((3, 2), 1, "not that of 'brick'"),
    ],
)
def test_a_size_that_cannot_be_is_refused(size, unit, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        Item.of_size(BRICK, size, unit)


def test_items_of_real_size_are_those_of_a_sequence() -> None:
    library = ShapeLibrary.open("blockout")
    drawn = SequenceSampler(library, (20, 20, 40), 5.9, 12)(np.random.default_rng(0))
    unit = 5.9 / 0.04  # a grid step has 0.04 box units
    items = [
        Item.of_size(one.shape, library.info(one.shape.id).size_cm, unit) for one in drawn.items
    ]
    assert [item.cells for item in items] == [item.cells for item in drawn.items]
    given = Task.of(items[::-1], (20, 20, 40), library)
    assert [i.shape.id for i in given.items] == [i.shape.id for i in drawn.items]
    same = dataclasses.replace(drawn, pack=given.pack)
    assert given.volume == pytest.approx(same.volume)


def test_a_task_of_items_is_played_stored_and_verified(tmp_path) -> None:
    library = ShapeLibrary.open("everyday")
    items = [Item.of_size(library[id], 0.4) for id in ("teapot", "coffee-mug", "teapot")]
    task = Task.of(items, (100, 60, 60), library)
    assert [one.shape.id for one in task.items] == ["coffee-mug", "teapot", "teapot"]
    (rollout,) = evaluate([AGENT], [task], seed=0)
    write_results(tmp_path / "results.jsonl", [rollout])
    assert read_results(tmp_path / "results.jsonl")[0].task_digest == task.digest
    assert verify(rollout.pack, library) == []
    write_packs(tmp_path / "tasks.jsonl", [task.pack])
    (read,) = read_packs(tmp_path / "tasks.jsonl")
    assert read.task(library) == task
    assert pickle.loads(pickle.dumps(task)) == task


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_a_task_takes_any_number_of_items_of_any_shapes(count) -> None:
    task = Task.of([cube_of(1 + n % 9) for n in range(count)], (40, 40, 40))
    assert len(task.items) == count and task.pack.library.name == "none"
    assert task.digest != Task.of([cube_of(1)] * count, (40, 40, 40)).digest


def test_items_that_are_no_task_are_refused() -> None:
    library = ShapeLibrary.open("everyday")
    mug = library["coffee-mug"]
    other = Shape(library["teapot"].mesh, "coffee-mug", "")
    for items, given, message in (
        ([], None, "a task needs an item"),
        ([Item.of_size(mug, 0.9)], None, r"needs \(.*\) cells: it fits into no box of \(40, 40"),
        ([Item(mug, 0.01), Item(other, 0.01)], None, "not that of another one of the task"),
        ([Item(other, 0.01)], library, "not that of ShapeLibrary"),
    ):
        with pytest.raises(ArgumentError, match=message):
            Task.of(items, (40, 40, 40), given)
    with pytest.raises(UnknownShapeError, match="no shape 'brick'"):
        Task.of([Item(BRICK, 0.01)], library=library)
    with pytest.raises(ArgumentError, match="a box of 30 x 30 x 30 cells is not possible"):
        Task.of([Item(BRICK, 0.01)], (30, 30, 30))


def drawn(env, count, **options) -> list[int]:
    return [env.reset(**options)[1]["task"] for _ in range(count)]


def test_weights_draw_tasks_in_proportion(tasks) -> None:
    env = PackItEnv(tasks, order=[3, 0, 1, 0], **COMMON)
    env.reset(seed=0)
    counts = np.bincount(drawn(env, 400), minlength=4)
    assert counts[1] == counts[3] == 0 and 250 < counts[0] < 350


def test_a_curriculum_sees_the_number_of_the_episode(tasks) -> None:
    env = PackItEnv(tasks, order=lambda rng, episode: min(episode, 3), **COMMON)
    assert drawn(env, 3) == [0, 1, 2]
    state = env.get_state()
    assert drawn(env, 3) == [3, 3, 3]
    env.set_state(pickle.loads(pickle.dumps(state)))
    assert drawn(env, 1, options={"task": 0}) == [0]
    assert drawn(env, 1) == [3]
    env = PackItEnv(tasks, order=lambda rng: int(rng.integers(2)), **COMMON)
    env.reset(seed=0)
    assert set(drawn(env, 20)) == {0, 1}


def test_a_maker_of_tasks_sees_the_number_of_the_episode_if_it_asks_for_it() -> None:
    def more_and_more(rng, episode) -> Task:
        return Task.of([cube_of(4)] * (1 + episode), (40, 40, 40))

    env = PackItEnv(more_and_more, cells=(40, 40, 40), **COMMON)
    assert [len((env.reset(), env.episode.task.items)[1]) for _ in range(3)] == [1, 2, 3]
    few = PackItEnv(lambda rng, n=2: Task.of([cube_of(4)] * n), **COMMON)
    few.reset()
    few.reset()
    assert len(few.episode.task.items) == 2


@pytest.mark.parametrize(
    "order", ["sorted", [1, 2], [1, -1, 1, 1], [0, 0, 0, 0], [1, 1, 1, np.inf], 5, None, ["a"] * 4]
)
def test_orders_that_cannot_be_are_refused(tasks, order) -> None:
    with pytest.raises(ArgumentError, match="a weight for each of the 4 tasks: 0 or more"):
        PackItEnv(tasks, order=order, **COMMON)


@pytest.mark.parametrize("order", ["cycle", [1.0], np.ones(2), lambda rng: 0])
def test_generated_tasks_have_no_order(order) -> None:
    with pytest.raises(ArgumentError, match="no effect on tasks that are generated"):
        PackItEnv("fresh", order=order, **COMMON)


def test_a_curriculum_that_names_no_task_is_refused_and_changes_nothing(tasks) -> None:
    env = PackItEnv(tasks, order=lambda rng, episode: 4 * episode, **COMMON)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ArgumentError, match="there is no task 4: choose 0 to 3"):
        env.reset()
    assert env.get_state() == before


def test_gymnasium_makes_environments_with_a_curriculum(tasks) -> None:
    env = gym.make("PackIt-v0", tasks=tasks, order=lambda rng, episode: episode % 2, **COMMON)
    assert drawn(env, 4) == [0, 1, 0, 1]
