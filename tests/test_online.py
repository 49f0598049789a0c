"""The online game: items arrive one by one, and only a buffer of them is visible."""

import itertools
import json
from collections import Counter
from dataclasses import replace
from functools import cache

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from benchmarks import online
from benchmarks.common import RESULTS
from packit_agents import OldestFirst
from packit_agents.heuristics.best_fit import resting
from packit_sim import placement
from packit_sim.box import Box
from packit_sim.cli import evaluations
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.pack_files import load_tasks, read_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.datasets.result_checks import result_problems
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.observations import OBSERVERS
from packit_sim.game.episodes.agents import GROUND_TRUTH, Agent
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.results import Rollout, read_results
from packit_sim.game.generation.sequences import ItemSampler, SequenceSampler
from packit_sim.geometry.polycubes import polycube
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import End, Rules
from scripts.build_blockout import CELL_CM, SHAPES
from tests.doc_pages import DOCS
from tests.runs import packit

ONLINE = Rules(kinematic=True, buffer=3, rotations="yaw")
HOOK = ((0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0), (2, 2, 0), (1, 2, 0), (0, 2, 0))
STEPS = np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
CUBES = 5
"""Cubes along each axis of BlockOut's box."""


@cache
def blockout() -> ShapeLibrary:
    return ShapeLibrary.open("blockout")


@cache
def sequence(seed: int = 0, items: int = 30, side: int = 20) -> Task:
    return SequenceSampler(blockout(), (side,) * 3, CELL_CM, items).pack(seed).task(blockout())


def cubes_of(item: Item) -> set[tuple[int, ...]]:
    """The cubes of a polycube in its rotation, from the shapes' definition alone."""
    turned = np.array(SHAPES[item.shape.id]) @ item.linear.round(9).T
    turned = np.rint(turned / np.abs(item.linear).max()).astype(int)
    return set(map(tuple, (turned - turned.min(axis=0)).tolist()))


def heights_by_cubes(box: Box) -> np.ndarray:
    """The heightmap of a box of polycubes, in cubes, from the shapes' definition alone."""
    heights = np.zeros((CUBES, CUBES))
    for placed in box.placed:
        for x, y, z in np.add(sorted(cubes_of(placed.item)), placed.location):
            heights[x, y] = max(heights[x, y], z + 1)
    return heights


def play_at_random(episode: Episode, rng: np.random.Generator, steps: int) -> None:
    for _ in range(steps):
        if episode.end is None:
            episode.step(rng.choice(np.flatnonzero(episode.action_mask())))


# Rules


@pytest.mark.parametrize("buffer", [0, -1, 1.5, "3", True])
def test_a_buffer_that_is_no_positive_integer_is_refused(buffer) -> None:
    with pytest.raises(ArgumentError, match="buffer"):
        Rules(buffer=buffer)


def test_unknown_rotations_are_refused() -> None:
    with pytest.raises(
        ArgumentError, match="rotations 'pitch' are not known: choose from all, yaw"
    ):
        Rules(rotations="pitch")


# Polycubes, their library, and sequences of them


@pytest.mark.parametrize(
    "cells",
    [
        *SHAPES.values(),
        ((0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0), (2, 2, 0), (1, 2, 0), (0, 2, 0)),
    ],
)
def test_a_polycube_is_drawn_in_on_all_sides(cells) -> None:
    mesh = polycube(cells, 0.2)
    assert mesh.is_watertight and mesh.is_winding_consistent
    blocks = np.argwhere(np.ones((20, 20, 10))) / 5 + 0.1
    around = [blocks + np.array(move) / 5 for move in itertools.product((-1, 1), repeat=3)]
    solid = [[tuple(cell) in cells for cell in at.tolist()] for at in np.floor(around).astype(int)]
    assert mesh.volume == pytest.approx(np.all(solid, axis=0).sum() / 5**3)
    low, high = np.min(cells, axis=0) + 0.2, np.max(cells, axis=0) + 0.8
    assert mesh.bounds == pytest.approx(np.array([low, high]))


def test_cubes_that_share_an_edge_alone_are_not_joined() -> None:
    apart = polycube([(0, 0, 0), (1, 1, 0)], 0.1)
    assert apart.is_watertight and apart.body_count == 2
    assert apart.volume == pytest.approx(2 * 0.8**3)


@pytest.mark.parametrize(("cells", "inset"), [((), 0.1), (((0, 0, 0),), 0), (((0, 0, 0),), 0.5)])
def test_polycubes_that_are_not_possible_are_refused(cells, inset) -> None:
    with pytest.raises(ArgumentError, match=r"at least one cell|inset 0.* is not possible"):
        polycube(cells, inset)


def test_the_library_has_eight_different_polycubes_of_four_cubes() -> None:
    turned = {
        id: {frozenset(cubes_of(Item(blockout()[id], 1.0, n))) for n in range(24)}
        for id in blockout()
    }
    assert len(turned) == 8
    assert sum(map(len, turned.values())) == len(set().union(*turned.values()))
    assert all(len(SHAPES[id]) == 4 for id in turned)


def test_shapes_fill_whole_steps_of_the_grid() -> None:
    for item in sequence().items:
        extents = np.ptp(sorted(cubes_of(item)), axis=0) + 1
        assert item.cells == tuple(4 * extents)
        assert 0.99 * 4 * 0.04**3 < item.volume < 4 * 0.04**3


def test_two_tripods_interlock_without_a_gap() -> None:
    tripod = next(item for item in sequence().items if item.shape.id == "tripod")
    masks = [placement.feasible(Box((8, 8, 8)).snapshot(), tripod.turned(n)) for n in range(24)]
    assert all(mask.sum() == 1 for mask in masks)
    box = Box((8, 8, 8))
    box.place(tripod, (0, 0, 0))
    others = [n for n in range(24) if not cubes_of(tripod) & cubes_of(tripod.turned(n))]
    fitting = [n for n in range(24) if box.is_feasible(tripod.turned(n), (0, 0, 0))]
    assert fitting == others and fitting


def test_sequences_follow_from_their_seed_alone(tmp_path) -> None:
    files = [tmp_path / name / "packs.jsonl" for name in ("one", "two")]
    for file in files:
        printed = packit("datasets", "sequences", "--sequences", 3, "--out", file.parent)
        assert "3 sequences" in printed
    assert files[0].read_bytes() == files[1].read_bytes()
    packs = read_packs(files[0])
    assert [pack.task(blockout()).digest for pack in packs] == [
        sequence(seed, items=50).digest for seed in range(3)
    ]
    assert verify_dataset(files[0].parent, blockout()).is_valid


def test_items_of_a_dataset_make_sequences_in_the_same_split(tmp_path) -> None:
    options = ("--items-of", "everyday-v1", "--split", "validation", "--sequences", 2, "--seed", 5)
    packit("datasets", "sequences", *options, "--items", 30, "--out", tmp_path)
    library = ShapeLibrary.open("everyday")
    tasks = load_tasks("everyday-v1", library, "validation")
    sampler = ItemSampler(library, tasks, 30)
    found = load_tasks(tmp_path, library, "validation")
    assert [task.digest for task in found] == [
        sampler.pack(seed).task(library).digest for seed in (5, 6)
    ]
    given = {item.key for task in tasks for item in task.items}
    drawn = [item.key for task in found for item in task.items]
    assert len(drawn) == 60 and set(drawn) <= given and len(set(drawn)) > 40
    assert sampler(np.random.default_rng(5)).digest == found[0].digest
    with pytest.raises(ArgumentError, match="0 different boxes"):
        ItemSampler(library, ())
    with pytest.raises(ArgumentError, match="2 different boxes"):
        ItemSampler(library, (*tasks, sequence()))
    with pytest.raises(ArgumentError, match="items 0 is not possible"):
        ItemSampler(library, tasks, 0)


def test_shapes_of_unknown_size_make_no_sequence() -> None:
    class Unsized(ShapeLibrary):
        def info(self, id):
            return replace(super().info(id), size_cm=None)

    with pytest.raises(ArgumentError, match="real size of shape 'i' is not known"):
        SequenceSampler(Unsized(blockout().source), (20, 20, 20), CELL_CM)


# Arrival


def test_the_order_of_arrival_is_a_permutation_that_does_not_depend_on_the_order_given() -> None:
    task = sequence()
    arriving = task.arriving
    assert Counter(item.key for item in arriving.items) == Counter(i.key for i in task.items)
    assert [item.shape.id for item in arriving.items] != [item.shape.id for item in task.items]
    assert arriving.digest == task.digest and arriving.arriving is arriving
    mixed = replace(task, items=task.items[::-1])
    assert mixed.arriving.items == arriving.items


def test_each_shape_is_as_likely_at_each_place_of_the_sequence() -> None:
    first = Counter(sequence(seed, 9).arriving.items[0].shape.id for seed in range(400))
    assert sorted(first) == sorted(blockout().ids) and max(first.values()) < 80


def test_a_solution_follows_its_items() -> None:
    task = load_tasks("starter")[0]
    for (n, *rest), (m, *other) in zip(task.solution, task.arriving.solution, strict=True):
        assert task.items[n] == task.arriving.items[m] and rest == other


@given(buffer=st.integers(1, 12), seed=st.integers(0, 2**32 - 1))
def test_the_first_items_that_are_left_are_visible(buffer, seed) -> None:
    rng = np.random.default_rng(seed)
    episode = Episode(sequence(items=12), Rules(buffer=buffer, rotations="yaw"))
    for _ in range(5):
        left = np.flatnonzero(episode.outside)
        assert np.flatnonzero(episode.visible).tolist() == left[:buffer].tolist()
        play_at_random(episode, rng, 3)


# Masks, compared with the oracle


@given(seed=st.integers(0, 2**32 - 1), easy=st.booleans(), kinematic=st.booleans())
def test_masks_are_those_of_the_oracle_for_what_can_still_be_placed(seed, easy, kinematic) -> None:
    rng = np.random.default_rng(seed)
    rules = Rules(easy=easy, kinematic=kinematic, buffer=2, rotations="yaw")
    episode = Episode(sequence(seed % 5, items=9, side=12), rules)
    play_at_random(episode, rng, int(rng.integers(0, 16)))
    truth: dict[int, np.ndarray] = {}
    for n in np.flatnonzero(episode.outside)[:2].tolist():
        turned = [episode.task.items[n].turned(turn) for turn in range(4)]
        truth[n] = np.stack([true_mask(episode.box, item) for item in turned])
    possible = [n for n, masks in truth.items() if masks.any()]
    if episode.end is not None:
        assert not possible
        return
    mask = episode.action_mask()
    if episode.stage is Stage.SHAPE:
        assert np.flatnonzero(mask).tolist() == possible
        return
    chosen = truth[episode.shape]
    if episode.stage is Stage.ROTATION and not easy:
        expected = chosen.any(axis=(1, 2, 3))
    elif episode.stage is Stage.ROTATION:
        expected = chosen[(slice(None), *episode.location)]
    else:
        expected = chosen.any(axis=0) if easy else chosen[episode.rotation]
    found = mask[:4] if episode.stage is Stage.ROTATION else mask.reshape(expected.shape)
    assert np.array_equal(found, expected) and mask.sum() == expected.sum()


def true_mask(box: Box, item: Item) -> np.ndarray:
    """The oracle's mask; with the kinematic rule, where no cube of the way down is in the way."""
    mask = placement.oracle(box.snapshot(), item)
    if not box.kinematic:
        return mask
    filled = np.zeros(box.nodes, dtype=bool)
    for placed in box.placed:
        for cube in cubes_of(placed.item):
            filled[tuple(np.add(cube, placed.location))] = True
    for at in np.argwhere(mask):
        way = [filled[x, y, z:] for x, y, z in (np.add(at, cube) for cube in cubes_of(item))]
        mask[tuple(at)] = not np.concatenate(way).any()
    return mask


# Choices that are not possible


def test_hidden_items_can_not_be_chosen() -> None:
    env = PackItEnv([sequence()], rules=ONLINE, observation="none")
    _, info = env.reset(seed=0)
    assert np.flatnonzero(info["action_mask"]).tolist() == [0, 1, 2]
    _, reward, terminated, _, info = env.step(3)
    assert terminated and reward == 0 and info["end"] == "invalid action"


def test_other_rotations_can_not_be_chosen() -> None:
    episode = Episode(sequence(), ONLINE)
    episode.step(0)
    episode.step(4)
    assert episode.end is End.INVALID_ACTION


@pytest.mark.parametrize(
    "agent",
    [
        "random/random/random",
        "largest-first/aligned/blbf",
        "largest-fitting-first/lowest/maximal-contact",
        "smallest-first/first-fit/heightmap-minimisation",
        "oldest-first/lowest/least-empty",
        "best-fit/best-fit/best-fit",
    ],
)
@pytest.mark.parametrize("easy", [False, True])
def test_agents_choose_what_is_valid_until_nothing_visible_fits(agent, easy) -> None:
    (rollout,) = evaluate([agent], [sequence(side=12)], 0, rules=replace(ONLINE, easy=easy))
    assert rollout.end is End.NO_LOCATION
    assert not list(result_problems(rollout.pack, rollout.played))


def test_the_episode_continues_while_anything_visible_fits() -> None:
    """The oldest item does not fit any more, but others do."""
    episode = Episode(sequence(side=16), replace(ONLINE, buffer=10))
    Agent.from_name("oldest-first/lowest/blbf").play(episode, np.random.default_rng(0))
    placed = np.flatnonzero(~episode.outside)
    assert (np.diff(placed) > 1).any() and episode.end is End.NO_LOCATION
    assert not any(
        episode.box.feasible(episode.task.items[n].turned(turn)).any()
        for n in np.flatnonzero(episode.visible)
        for turn in range(4)
    )


def test_the_solution_can_be_played_in_the_order_of_arrival() -> None:
    episode = Episode(load_tasks("starter")[0], Rules(buffer=2))
    GROUND_TRUTH.play(episode, np.random.default_rng(0))
    assert episode.end is End.COMPLETE and episode.total == pytest.approx(1)


def test_the_oldest_is_the_first_to_be_chosen() -> None:
    episode = Episode(sequence(), ONLINE)
    assert OldestFirst()(episode, np.random.default_rng(0)) == 0
    scores = OldestFirst().scores(episode, np.random.default_rng(0))
    assert (np.diff(scores[:3]) < 0).all() and np.isneginf(scores[3:]).all()


@pytest.mark.parametrize("easy", [False, True])
def test_the_best_fit_touches_most_of_all_placements(easy) -> None:
    """Compared with a count of the faces of cubes, over all that rests."""
    episode = Episode(sequence(side=12), replace(ONLINE, easy=easy))
    agent = Agent.from_name("best-fit/best-fit/best-fit")
    while episode.end is None:
        filled = np.pad(np.zeros(episode.box.nodes, dtype=bool), 1, constant_values=True)
        filled[:, :, -1] = False  # the open top
        for placed in episode.box.placed:
            for cube in cubes_of(placed.item):
                filled[tuple(np.add(cube, placed.location) + 1)] = True
        touched = []
        for n in np.flatnonzero(episode.action_mask()).tolist():
            for item in map(episode.task.items[n].turned, range(4)):
                for at in np.argwhere(resting(episode.box.feasible(item))):
                    own = np.add(sorted(cubes_of(item)), at) + 1
                    touched.append(sum(filled[tuple((own + step).T)].sum() for step in STEPS))
        placed = len(episode.box.placed)
        while episode.end is None and len(episode.box.placed) == placed:
            episode.step(agent.act(episode, np.random.default_rng(0)))
        last = episode.box.placed[-1]
        own = np.add(sorted(cubes_of(last.item)), last.location) + 1
        assert sum(filled[tuple((own + step).T)].sum() for step in STEPS) == max(touched)


def test_the_best_fit_of_items_that_do_not_fit_is_the_first() -> None:
    task = sequence(side=12)
    episode = Episode(replace(task, pack=replace(task.pack, cells=(4, 4, 4))))
    agent = Agent.from_name("best-fit/best-fit/best-fit")
    assert agent.act(episode, np.random.default_rng(0)) == 0
    agent.play(episode, np.random.default_rng(0))
    assert episode.end is End.NO_LOCATION
    scores = agent.shape.scores(Episode(sequence(), ONLINE), np.random.default_rng(0))
    assert np.flatnonzero(scores > -np.inf).tolist() == [0, 1, 2]


# Searches


@pytest.mark.parametrize("search", ["lns=3", "mcts=3", "beam=2", "backtrack=2"])
def test_a_search_gets_the_visible_items_alone(search) -> None:
    agent = Agent.from_name(f"largest-first/lowest/blbf+{search}")
    asked = []

    def spy(agent, episode, rng, on_progress):
        asked.append(len(episode.outside))
        assert episode.rules.buffer is None
        Agent.from_name(f"largest-first/lowest/blbf+{search}").search(
            agent, episode, rng, on_progress
        )

    first = Episode(sequence(side=12), ONLINE)
    progress = []
    replace(agent, search=spy).play(
        first, np.random.default_rng(0), lambda count, best: progress.append((count, best))
    )
    assert set(asked) == {3} and len(asked) == len(first.box.placed)
    assert len(progress) == len(first.box.placed) and progress == sorted(progress)
    assert progress[-1][1] == first.total
    again = Episode(sequence(side=12), ONLINE)
    agent.play(again, np.random.default_rng(0))
    assert again.box.placed == first.box.placed


def test_what_is_hidden_has_no_influence_on_a_search() -> None:
    task = sequence(side=16).arriving
    others = sequence(1, side=16).items[: len(task.items) - 6]
    changed = replace(task, items=task.items[:6] + others)
    played = []
    for one in (task, changed):
        episode = Episode(task, ONLINE)
        episode.task = one
        agent = Agent.from_name("oldest-first/lowest/blbf+lns=4")
        agent.play(episode, np.random.default_rng(0))
        played.append(episode.box.placed[:4])
    assert played[0] == played[1] and len(played[0]) == 4


def test_no_search_plans_online_with_physics() -> None:
    agent = Agent.from_name("oldest-first/lowest/blbf+lns=1")
    with pytest.raises(ArgumentError, match="can't plan online with physics"):
        agent.play(Episode(sequence(), Rules().changed(physics=True, buffer=2)), None)


# Environments


@pytest.mark.parametrize("observation", OBSERVERS)
def test_an_observation_shows_nothing_of_items_that_have_not_arrived(observation) -> None:
    """Two tasks that differ in what is hidden give the same observations."""
    task = sequence().arriving
    others = sequence(1).items[: len(task.items) - 5]
    changed = replace(task, items=task.items[:5] + others)
    seen = []
    for one in (task, changed):
        observer = OBSERVERS[observation]((20, 20, 20), 50, 125, (Stage.ROTATION, Stage.LOCATION))
        episode = Episode(task, ONLINE)
        episode.task = one
        for action in (1, 0, 2, 2):
            mask = np.zeros(125, dtype=bool)
            seen.append((observer.observe(episode, mask), observer.space))
            episode.step(action if episode.stage is not Stage.LOCATION else 0)
    half = len(seen) // 2
    for (ours, space), (theirs, _) in zip(seen[:half], seen[half:], strict=True):
        assert ours.keys() == theirs.keys() and ours in space
        assert all(np.array_equal(ours[name], theirs[name]) for name in ours)
        assert ours["outside"].sum() == 3 and not ours["volumes"][4:].any()


def test_the_heightmap_is_that_of_the_cubes_in_the_box() -> None:
    env = gymnasium.make("PackIt-v0", tasks=[sequence()], rules=ONLINE, observation="heightmap")
    observation, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    terminated = False
    while not terminated:
        episode = env.unwrapped.episode
        expected = np.kron(heights_by_cubes(episode.box), np.full((4, 4), 0.04))
        assert observation["heightmap"] == pytest.approx(expected)
        if episode.stage is Stage.LOCATION:
            bottom, top = observation["item"]
            for x, y in np.ndindex(4, 4):
                column = [c[2] for c in cubes_of(episode.chosen_item.item) if c[:2] == (x, y)]
                assert bottom[4 * x + 1, 4 * y] == pytest.approx(0.04 * min(column, default=0))
                assert top[4 * x, 4 * y + 3] == pytest.approx(0.04 * max([-1, *column]) + 0.04)
        action = rng.choice(np.flatnonzero(observation["action_mask"]))
        observation, _, terminated, _, _ = env.step(action)
    assert heights_by_cubes(env.unwrapped.episode.box).max() > 2


def test_the_heights_of_a_real_shape_enclose_its_mesh() -> None:
    task = load_tasks("starter")[0]
    env = PackItEnv([task], observation="heightmap", max_shapes=len(task.items))
    observation, _ = env.reset(seed=0)
    for n, item in enumerate(task.items):
        bottom, top = observation["shapes"][n]
        vertices = item.mesh.vertices + np.array(item.cells) / 200
        x, y = np.minimum(vertices[:, :2] * 100, np.array(item.cells[:2]) - 1e-6).astype(int).T
        assert (bottom[x, y] <= vertices[:, 2] + 1e-4).all()
        assert (top[x, y] >= vertices[:, 2] - 1e-4).all()
        assert top.max() <= item.cells[2] / 100 + 1e-6 and bottom[bottom < top].min() == 0


@pytest.mark.parametrize("tasks", ["given", "made"])
def test_a_state_is_restored_exactly(tasks) -> None:
    made = [sequence()] if tasks == "given" else (lambda rng: sequence(int(rng.integers(100))))
    rules = replace(ONLINE, cells=(20, 20, 20))
    env = PackItEnv(made, rules=rules, observation="heightmap")
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(8):
        env.step(rng.choice(np.flatnonzero(env.action_masks())))
    state = env.get_state()
    episode = env.episode
    before, _ = env.set_state(state)
    actions = []
    for _ in range(6):
        actions.append(rng.choice(np.flatnonzero(env.action_masks())))
        after = env.step(actions[-1])
    again, _ = env.set_state(state)
    assert env.episode is episode
    assert all(np.array_equal(before[name], again[name]) for name in before)
    for action in actions:
        repeated = env.step(action)
    assert all(np.array_equal(after[0][name], repeated[0][name]) for name in before)
    offline = PackItEnv([sequence()], rules=replace(rules, buffer=None), observation="none")
    with pytest.raises(ArgumentError, match="online with a buffer of 3"):
        offline.set_state(state)


def test_vector_environments_play_online() -> None:
    envs = gymnasium.make_vec(
        "PackIt-v0", 2, tasks=[sequence()], rules=ONLINE, observation="heightmap"
    )
    observations, _ = envs.reset(seed=0)
    assert observations["heightmap"].shape == (2, 20, 20)
    assert (observations["outside"].sum(axis=1) == 3).all()


# Results


def test_results_are_the_same_after_a_way_through_a_file(tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    agents = ["oldest-first/lowest/blbf"]
    tasks = [sequence(side=12), sequence(1, side=12)]
    played = evaluate(agents, tasks, 0, rules=ONLINE, file=file)
    assert read_results(file) == played and played[0].rules == ONLINE
    assert json.loads(file.read_text().splitlines()[0])["provenance"]["rules"]["buffer"] == 3
    assert verify_dataset(file, blockout()).is_valid
    with pytest.raises(ValueError, match="online with a buffer of 3"):
        evaluate(agents, tasks, 0, rules=replace(ONLINE, buffer=5), file=file)


def forged(rollout: Rollout, items: tuple, **rules: object) -> list[str]:
    played = structs.replace(rollout.played, rules=replace(ONLINE, **rules))
    return list(result_problems(replace(rollout.pack, items=items), played))


def test_a_result_that_breaks_the_rules_is_refused() -> None:
    (rollout,) = evaluate(["random/random/blbf"], [sequence(side=12)], 0, rules=ONLINE)
    items = rollout.pack.items
    assert forged(rollout, items) == []
    assert "was not among the 1 visible items" in forged(rollout, items, buffer=1)[0]
    assert "was not among the 3 visible items" in forged(rollout, items[::-1])[0]
    turned = (structs.replace(items[0], rotation=9), *items[1:])
    assert "rotation 9, its rules allow yaw rotations only" in forged(rollout, turned)[0]
    assert forged(rollout, turned, rotations="all") == []


def test_the_command_line_plays_online(tmp_path, monkeypatch) -> None:
    def in_this_process(agents, tasks, seed, rules, *, workers, file, numbers):
        return evaluate(agents, tasks, seed, rules=rules, file=file)

    monkeypatch.setattr(evaluations, "evaluate_shown", in_this_process)
    packit(
        *("datasets", "sequences", "--sequences", 2, "--items", 9, "--cells", 12, 12, 12),
        *("--out", tmp_path),
    )
    printed = packit(
        *("evaluate", tmp_path / "packs.jsonl", "--agent", "oldest-first/lowest/blbf"),
        *("--kinematic", "--buffer", 3, "--rotations", "yaw", "--workers", 1),
        *("--out", tmp_path / "results.jsonl"),
    )
    assert "kinematic, online with a buffer of 3, yaw rotations" in " ".join(printed.split())
    assert {r.rules for r in read_results(tmp_path / "results.jsonl")} == {ONLINE}
    packit("verify", tmp_path / "results.jsonl")


# The benchmark


def test_the_page_shows_the_results_of_the_benchmark() -> None:
    runs = json.loads((RESULTS / "online.json").read_text())
    page = (DOCS / "benchmarks" / "online.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith("|")]
    expected = online.rows(runs)
    for line, row in zip(lines[2:], expected, strict=False):
        assert [cell.strip(" `") for cell in line[1:-1].split("|")] == row
    assert len(expected) > 2


def test_a_game_of_the_benchmark_is_played_once(tmp_path) -> None:
    runs: dict = {}
    file = tmp_path / "online.json"
    online.play(runs, file, "oldest-first/aligned/blbf", 1, 2)
    (packed,) = [run["packed"] for run in runs["oldest-first/aligned/blbf"].values()]
    assert json.loads(file.read_text()) == runs and all(5 < count <= 31 for count in packed)
    online.play(runs, file, "oldest-first/aligned/blbf", 1, 2)
    assert len(packed) == 2 and pytest.approx(82.9, abs=0.05) == 31 * online.SHARE
