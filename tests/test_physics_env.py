"""Boxes with settling items, and their environment: scenes with known outcomes."""

from __future__ import annotations

import math
import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from msgspec import structs
from trimesh import creation, transformations

from packit_sim import Agent
from packit_sim.core import caches
from packit_sim.core.errors import ArgumentError, InfeasibleError, PackFormatError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import write_packs
from packit_sim.game.datasets.packs import ItemRecord, LibraryRef, Pack, Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.results import ResultsError, Rollout, read_results, write_results
from packit_sim.game.reports.examples import gallery
from packit_sim.game.reports.runs import Runs
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.convex import decomposition, disk_cache
from packit_sim.physics.convex.decomposition import decompose
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import SettledItem
from packit_sim.physics.settling_box import SettlingBox
from packit_sim.placement import PosedItem, first, oracle
from packit_sim.rules import End, Rules
from packit_sim.web.viewer import Viewer
from tests.runs import packit
from tests.zoo import BALL, BOWL, CUBE, PLATE, TILTED, ZOO, cube_of

SETTINGS = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))
CELLS: Triple = (40, 40, 40)


@pytest.fixture(autouse=True, scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Pieces are computed once for this module, in a temporary cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path_factory.mktemp("kept")))
        yield


def block(x: float, y: float, z: float) -> Item:
    """A block of so many cells."""
    shape = Shape.from_mesh(creation.box((x, y, z)), f"block-{x}-{y}-{z}")
    return Item(shape, (math.hypot(x, y, z) / 100) ** 3)


def task_of(*items: Item, cells: Triple = CELLS) -> Task:
    return Task(items, Pack(LibraryRef("none", "1", ""), cells, (), 0.0), ())


def env_of(*items: Item, **settings: object) -> PackItEnv:
    usual = {"observation": "none", "physics": SETTINGS, "max_shapes": 6}
    return PackItEnv([task_of(*items)], **usual | settings)


def number(i: int, j: int, k: int) -> int:
    """Of a location in the small box."""
    return int(np.ravel_multi_index((i, j, k), (10, 10, 10)))


@pytest.fixture(scope="module")
def settled() -> SettlingBox:
    """Items that tilt, roll and lie across others, released one after the other."""
    box = SettlingBox(CELLS, SETTINGS)
    for item in (Item(TILTED, 0.01), Item(BALL, 0.006), Item(PLATE, 0.02, 3), cube_of(10)):
        locations = np.argwhere(box.feasible(item))
        box.place(item, locations[len(locations) // 2])
    return box


@pytest.mark.parametrize("item", [cube_of(7), Item(BALL, 0.003), Item(TILTED, 0.004, 9)])
def test_masks_are_exact_among_what_settled(settled: SettlingBox, item: Item) -> None:
    turned = [one for one in settled.placed if not np.allclose(one.matrix, one.landed.matrix)]
    assert len({tuple(np.round(one.center / 0.04, 3) % 1) for one in settled.placed}) > 1
    assert all(one.inside for one in settled.placed) and len(turned) < 4
    mask = settled.feasible(item)
    assert 0 < mask.sum() < mask.size
    assert np.array_equal(mask, oracle(settled, item))
    assert settled.blbf(item) == first(mask)
    assert np.array_equal(settled.feasible_rotations(item)[item.rotation], mask)
    assert settled.rotations_at(item, (0, 0, 9)).tolist() == [
        settled.is_feasible(item.turned(n), (0, 0, 9)) for n in range(24)
    ]


def test_a_ball_in_a_bowl_ends_at_the_bottom_and_is_in_the_way_there() -> None:
    bowl, ball = Item(BOWL, 0.04), Item(BALL, 0.001)
    box = SettlingBox(CELLS, SETTINGS)
    box.place(bowl, (2, 2, 0))
    middle = box.placed[0].center
    centers = np.argwhere(box.feasible(ball)) * (STEP / 100) + ball.extents / 2
    away = np.linalg.norm(centers[:, :2] - middle[:2], axis=1)
    above = centers[:, 2] > middle[2]
    slope = np.argwhere(box.feasible(ball))[(away > 0.03) & (away < 0.06) & above][0]
    bottom = np.round((middle - ball.extents / 2) * 100 / STEP).astype(int)
    bottom = (*bottom[:2].tolist(), 1)
    assert box.is_feasible(ball, bottom)
    box.place(ball, slope)
    basin, rolled = box.placed
    assert np.linalg.norm((rolled.center - basin.center)[:2]) < 0.02
    lowest = basin.vertices[:, 2].min()
    assert rolled.vertices[:, 2].min() == pytest.approx(lowest, abs=0.01)
    assert rolled.counts and rolled.drift == 0.0
    assert not box.is_feasible(ball, bottom)
    assert np.array_equal(box.feasible(ball), oracle(box, ball))


def test_an_item_falls_as_far_as_it_can() -> None:
    box = SettlingBox(CELLS, SETTINGS)
    box.place(cube_of(8), (3, 3, 8))
    (cube,) = box.placed
    assert cube.vertices[:, 2].min() == pytest.approx(0, abs=0.002)
    assert box.density == pytest.approx(0.08**3 / 0.4**3)
    assert not box.is_feasible(cube_of(8), (3, 3, 0)) and box.is_feasible(cube_of(8), (3, 3, 3))
    assert box.outer[:, :, 10:].sum() == 0


def test_the_reward_is_of_what_is_inside_and_stable_at_the_end() -> None:
    """A load on the end of a plank tips it: its volume counts no more, and no less than that."""
    base, plank, load = block(4, 20, 8), block(28, 12, 4), cube_of(10)
    env = env_of(base, plank, load)
    env.reset(seed=0)
    rewards = []
    for shape, at in ((0, (4, 3, 0)), (1, (1, 4, 2)), (2, (5, 4, 4))):
        env.step(shape)
        env.step(0)
        _, reward, _, _, info = env.step(number(*at))
        rewards.append(reward)
    whole = base.volume + plank.volume + load.volume
    kept = [one.counts for one in env.episode.box.placed]
    assert kept == [True, False, True]
    assert rewards[:2] == pytest.approx([base.volume / whole, plank.volume / whole])
    assert rewards[2] == pytest.approx((load.volume - plank.volume) / whole)
    assert env.episode.total == pytest.approx((base.volume + load.volume) / whole)
    assert env.episode.end is End.COMPLETE
    assert info["placed_volume"] == pytest.approx(base.volume + load.volume)
    assert len(env.episode.box.placed) == 3
    env.close()


def test_what_counts() -> None:
    cube = cube_of(10)
    here, there = np.eye(4), np.eye(4)
    there[2, 3] = 0.06
    landed, elsewhere = PosedItem(cube, here), PosedItem(cube, there)

    def item(inside: bool, landed: PosedItem | None) -> SettledItem:
        return SettledItem(PosedItem(cube, here), (), Motion(), (), (), inside, landed)

    assert item(True, landed).counts
    assert not item(True, elsewhere).counts
    assert item(True, elsewhere).drift == pytest.approx(0.06)
    assert not item(False, landed).counts
    assert not item(True, None).counts


def test_what_does_not_come_to_rest_does_not_count_until_it_does() -> None:
    box = SettlingBox(CELLS, replace(SETTINGS, time_limit=0.1))
    settled = box.place(cube_of(8), (3, 3, 8))
    assert not settled.at_rest and box.density == 0.0 and box.placed[0].landed is None
    assert box.put(cube_of(4), (9, 9, 0)) == 0.0
    patient = SettlingBox(CELLS, SETTINGS)
    patient.restore(box.snapshot())
    assert patient.put(cube_of(4), (0, 0, 0)) == pytest.approx(0.08**3 + 2 * 0.04**3)


def test_a_placement_that_topples_is_foreseen() -> None:
    box = SettlingBox(CELLS, SETTINGS)
    box.place(cube_of(8), (0, 0, 0))
    before, slab = box.snapshot(), block(24, 8, 4)
    assert box.disturbance(slab, (0, 0, 2)).own > 1
    assert box.disturbance(slab, (0, 2, 0)).own < 0.1
    assert box.snapshot() == before


def test_the_pieces_of_items_stay_as_they_are() -> None:
    """An item far away is placed: it does not change how a ball rests in a bowl."""
    box = SettlingBox(CELLS, SETTINGS)
    box.place(Item(BOWL, 0.04), (2, 2, 0))
    ball = Item(BALL, 0.001)
    middle = np.round((box.placed[0].center - ball.extents / 2) * 100 / STEP).astype(int)
    box.place(ball, (*middle[:2].tolist(), 4))

    def volumes() -> list[float]:
        return [piece.volume for one in box.placed[:2] for piece, _ in one.parts]

    before = volumes()
    box.place(cube_of(4), (9, 9, 0))
    assert volumes() == pytest.approx(before, rel=1e-6)


def test_the_future_follows_from_the_state() -> None:
    """A box that continues, and one restored to the same state, end the same, bit for bit."""
    first_box, other = SettlingBox(CELLS, SETTINGS), SettlingBox(CELLS, SETTINGS)
    first_box.place(Item(TILTED, 0.01), (2, 2, 1))
    state = pickle.loads(pickle.dumps(first_box.snapshot()))
    first_box.place(cube_of(8), (3, 3, 5))
    ends = [one.matrix for one in first_box.placed]
    other.restore(state)
    other.place(cube_of(8), (3, 3, 5))
    assert [one.matrix.tobytes() for one in other.placed] == [end.tobytes() for end in ends]
    other.restore(state)
    assert other.placed == state.placed and len(other.placed) == 1
    assert np.array_equal(other.feasible(cube_of(8)), oracle(state, cube_of(8)))
    with pytest.raises(ValueError, match="can't be restored"):
        SettlingBox((20, 20, 20), SETTINGS).restore(state)


def test_what_is_not_feasible_changes_nothing() -> None:
    box = SettlingBox(CELLS, SETTINGS)
    box.place(cube_of(10), (3, 3, 0))
    before = box.snapshot()
    for at, said in (((3, 3, 1), "in conflict"), ((9, 9, 9), "outside"), ((0, 0, 10), "grid")):
        with pytest.raises(InfeasibleError, match=said):
            box.place(cube_of(10), at)
    assert box.snapshot() == before
    assert repr(box) == "SettlingBox((40, 40, 40), 1 items, density 0.016)"


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
@pytest.mark.usefixtures("software")
def test_gymnasiums_checker_is_content(render_mode: str | None) -> None:
    """Warnings are errors."""
    env = gym.make(
        "PackItPhysics-v0",
        tasks=[task_of(cube_of(8), Item(TILTED, 0.01))],
        physics=SETTINGS,
        observation="voxels" if render_mode else "features",
        max_shapes=3,
        render_mode=render_mode,
    )
    check_env(env.unwrapped, skip_render_check=render_mode is None)
    env.close()


def test_the_same_seed_is_the_same_episode() -> None:
    def played() -> list[object]:
        env = env_of(Item(TILTED, 0.01), Item(BALL, 0.006), cube_of(10), rotation="random")
        rng = np.random.default_rng(5)
        env.reset(seed=4)
        trace: list[object] = []
        while env.episode.end is None:
            action = int(rng.choice(np.flatnonzero(env.action_masks())))
            seen, reward, *_ = env.step(action)
            trace += [action, reward, seen["action_mask"].tobytes()]
        return [*trace, *(one.matrix.tobytes() for one in env.episode.box.placed)]

    assert played() == played()


def test_a_state_is_gone_back_to() -> None:
    env = env_of(Item(TILTED, 0.01), cube_of(10), rotation="aligned", location="blbf")
    env.reset(seed=0)
    env.step(0)
    state = pickle.loads(pickle.dumps(env.get_state()))
    ends = []
    for _ in range(2):
        env.step(1)
        ends.append([one.matrix.tobytes() for one in env.episode.box.placed])
        env.set_state(state)
        assert len(env.episode.box.placed) == 1
    assert ends[0] == ends[1]


def test_a_state_of_another_world_is_refused() -> None:
    items = Item(TILTED, 0.01), cube_of(10)
    env = env_of(*items)
    env.reset(seed=0)
    state = env.get_state()
    softer = replace(env.rules.physics, friction=0.9)
    for settings in ({"physics": softer}, {"physics": None}):
        other = env_of(*items, **settings)
        with pytest.raises(ArgumentError, match=r"a state of the rules .PackIt, physics"):
            other.set_state(state)
        other.reset(seed=0)
        with pytest.raises(ArgumentError, match="can't be restored under the rules"):
            env.set_state(other.get_state())


@pytest.mark.parametrize(
    "name", ["largest-first/aligned/blbf", "smallest-first/lowest/dblf+beam=2"]
)
def test_heuristics_and_searches_play_as_ever(name: str) -> None:
    task = task_of(Item(CUBE, 0.008), Item(TILTED, 0.004), Item(BALL, 0.004))
    episode = Episode(task, Rules(physics=SETTINGS))
    Agent.from_name(name).play(episode, np.random.default_rng(0))
    assert episode.end is End.COMPLETE and len(episode.box.placed) == 3
    counted = sum(one.item.volume for one in episode.box.placed if one.counts)
    assert episode.total == pytest.approx(counted / task.volume)


def test_easy_has_physics_too() -> None:
    env = env_of(cube_of(10), Item(BALL, 0.004), easy=True)
    env.reset(seed=0)
    env.step(0)
    env.step(number(2, 2, 3))
    env.step(5)
    seen, *_ = env.step(1)
    ball = env.episode.task.items[1]
    expected = oracle(env.episode.box, ball)
    assert np.array_equal(seen["locations"], expected)  # all rotations of a ball are nearly one
    env.close()


def test_a_picture_shows_where_items_lie() -> None:
    env = env_of(cube_of(12), render_mode="rgb_array")
    env.reset(seed=0)
    empty = env.render()
    env.step(0)
    env.step(0)
    env.step(number(3, 3, 6))
    low, (height, *_) = env.render(), empty.shape
    changed = np.argwhere((low != empty).any(axis=2))
    assert changed[:, 0].mean() > height / 2  # on the floor, though it was placed high up
    env.close()


def test_the_page_shows_where_items_lie(settled: SettlingBox) -> None:
    pytest.importorskip("viser")
    with Viewer(settled) as viewer:
        for shown, lying in zip(viewer.items, settled.placed, strict=True):
            assert np.allclose(shown.position, lying.center)
            turn = transformations.quaternion_matrix(shown.wxyz)[:3, :3]
            assert np.allclose(turn * np.cbrt(lying.item.scale), lying.matrix[:3, :3], atol=1e-6)


def test_many_play_side_by_side() -> None:
    envs = gym.make_vec(
        "PackItPhysics-v0",
        2,
        tasks=[task_of(cube_of(8), cube_of(6))],
        physics=SETTINGS,
        rotation="aligned",
        location="blbf",
        observation="placement-features",
        max_shapes=2,
    )
    seen, _ = envs.reset(seed=0)
    assert seen["placement_features"].shape == (2, 2, 8) and seen["action_mask"].all()
    seen, rewards, *_ = envs.step(np.array((0, 1)))
    assert rewards == pytest.approx(np.array((8**3, 6**3)) / (8**3 + 6**3))
    assert seen["action_mask"].tolist() == [[0, 1], [1, 0]]
    envs.close()


def test_the_code_of_the_page_on_physics_runs() -> None:
    page = Path(__file__).parents[1] / "docs" / "guides" / "physics.md"
    example = re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), flags=re.DOTALL)[-1]
    names: dict[str, object] = {}
    exec(compile(example, "physics.md", "exec"), names)
    assert 0 < names["reward"] < 1
    names["env"].close()


def test_what_is_not_possible_is_said() -> None:
    with pytest.raises(ValueError, match="kinematic or has physics, not both"):
        env_of(cube_of(10), kinematic=True)
    with pytest.raises(ValueError, match="friction -1 is not possible"):
        gym.make("PackItPhysics-v0", physics=PhysicsSettings(friction=-1))


def test_what_settled_is_recorded_with_its_poses(tmp_path) -> None:
    path = tmp_path / "zoo"
    stored.write(path, "zoo", "1", [stored.entry(shape) for shape in ZOO])
    library = ShapeLibrary.open(path)
    items = (
        Item(library["ball"], 0.05),
        Item(library["cube"], 0.02, 5),
        Item(library["ring"], 0.05),
    )
    truth = Pack(LibraryRef.of(library), CELLS, (), 0.0)
    episode = Episode(Task(items, truth, ()), Rules(physics=SETTINGS))
    Agent.from_name("largest-first/aligned/blbf").play(episode, np.random.default_rng(0))
    rollout = Rollout.of(episode, "someone", 0, 0, 0.0)
    write_results(tmp_path / "results.jsonl", [rollout])
    (read,) = read_results(tmp_path / "results.jsonl")
    assert read == rollout and not read.pack.is_on_grid
    assert read.end is episode.end
    assert read.pack.density == episode.box.density
    for before, after in zip(episode.box.placed, read.pack.placed(library), strict=True):
        assert after.item == before.item
        assert after.matrix == pytest.approx(before.matrix, abs=1e-12)
    report = verify_dataset(tmp_path / "results.jsonl", library)
    assert report.is_valid and report.settled == len(items)
    assert "3 items that settled" in report.not_judged
    with pytest.raises(PackFormatError, match="3 of the pack's 3 items settled off the grid"):
        read.pack.replay(library)
    assert read.pack.task(library).solution == ()
    ball = read.pack.items[0]
    width = read.pack.cells[0] * CELL
    for beyond in ((0.2, 0.2, -0.1), (width, 0.2, 0.2)):
        moved = structs.replace(ball, pose=structs.replace(ball.pose, position=beyond))
        broken = replace(read.pack, items=(moved, *read.pack.items[1:]))
        assert "item 0 ('ball') is not inside the box" in verify(broken, library)[0]
    assert "density is recorded" in verify(replace(read.pack, density=0.5), library)[0]


@pytest.mark.slow
def test_evaluations_with_physics_are_stored_resumed_and_drawn(tmp_path) -> None:
    zoo, packs, out = (tmp_path / name for name in ("zoo", "packs.jsonl", "results.jsonl"))
    stored.write(zoo, "zoo", "1", [stored.entry(shape) for shape in ZOO])
    outside = (ItemRecord("ball", 0.05), ItemRecord("cube", 0.02), ItemRecord("ring", 0.05))
    library = LibraryRef.of(ShapeLibrary.open(zoo))
    write_packs(packs, [Pack(library, CELLS, (), 0.0, outside=outside)] * 2)
    common = ("evaluate", packs, "--library", zoo, "--out", out, "--decomposition", "bisection")
    agents = ("largest-first/aligned/blbf", "smallest-first/aligned/blbf")
    packit(*common, "--physics", "--agent", agents[0], "--tasks", 1)
    first = read_results(out)
    output = packit(*common, "--physics", "--agent", agents[0], "--agent", agents[1])
    assert "rules: PackIt, physics" in output
    played = read_results(out)
    assert len(played) == 4 and played[0].seconds == first[0].seconds
    assert {one.rules for one in played} == {Rules(physics=SETTINGS)}
    assert not any(one.pack.is_on_grid for one in played)
    packit("render", out, "--library", zoo, "--out", tmp_path / "settled.png", "--size", 64)
    assert (tmp_path / "settled.png").stat().st_size > 0
    examples = gallery(Runs.read([out]), ShapeLibrary.open(zoo), 1)
    assert {len(box["items"]) for box in examples.models.to_json()["boxes"]} == {3}
    with pytest.raises(ResultsError, match="rules PackIt, physics method='bisection', not PackIt:"):
        packit(*common, "--agent", agents[0])
    with pytest.raises(ArgumentError, match="--scores and --physics exclude each other"):
        packit(*common, "--physics", "--scores")


def test_rewards_add_up_to_what_counts() -> None:
    env = env_of(cube_of(10), Item(TILTED, 0.01), cube_of(6), rotation="aligned", location="blbf")
    env.reset(seed=0)
    totals = [0.0]
    while env.episode.end is None:
        env.step(int(np.flatnonzero(env.action_masks())[0]))
        totals.append(env.episode.total)
    assert all(b >= a for a, b in pairwise(totals))
    assert totals[-1] * env.episode.task.volume == pytest.approx(env.episode.box.counted)


def test_prepare_decomposes_the_shapes_of_a_dataset_once(tmp_path, monkeypatch, caplog) -> None:
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    stored.write(tmp_path / "zoo", "zoo", "1", [stored.entry(shape) for shape in (CUBE, PLATE)])
    library = ShapeLibrary.open(tmp_path / "zoo")
    packs = [Task.of([Item(library[id], 0.01)], library=library).pack for id in library.ids]
    write_packs(tmp_path / "tasks.jsonl", packs)
    caches.clear()
    command = ("prepare", tmp_path / "tasks.jsonl", "--decomposition", "bisection")
    assert "2 shapes are prepared, 2 of them now" in packit(*command, "--physics")
    assert "2 shapes are prepared, 0 of them now" in packit(*command, "--physics")
    assert "are decomposed into convex pieces" not in caplog.text
    with pytest.raises(ArgumentError, match="nothing to prepare: give --physics"):
        packit(*command)


def test_a_simulation_says_once_why_it_takes_long(tmp_path, monkeypatch, caplog) -> None:
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path))
    decomposition._announce.cache_clear()
    for shape in (CUBE, CUBE, PLATE):
        caches.clear()
        decompose(shape, SETTINGS.decomposition)
    assert caplog.text.count("`packit prepare DATASET --physics` does it beforehand") == 1
