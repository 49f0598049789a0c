"""The rule of support: cases with a known answer, the plain definition, and the game by it."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core.debugging import checking
from packit_sim.core.errors import ArgumentError, InfeasibleError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.result_checks import placement_problems
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import PlacedItem, support
from packit_sim.rules import Rules
from tests.examples import examples
from tests.test_online import blockout, cubes_of, play_at_random, sequence
from tests.zoo import BALL, ZOO, cube_of, fill, random_item

CELLS = (40, 40, 40)


def support_at(box: Box, item: Item, at: tuple[int, int, int]) -> float:
    return support(box.cells, box.placed, PlacedItem(item, at))


def test_the_support_of_a_cube_is_its_overlap_with_the_cube_below() -> None:
    box, cube = Box(CELLS), cube_of(20)
    box.place(cube, (0, 0, 0))
    assert [support_at(box, cube, (i, 0, 5)) for i in range(6)] == [1, 0.8, 0.6, 0.4, 0.2, 0]
    assert support_at(box, cube, (2, 1, 5)) == pytest.approx(0.48)
    assert support_at(box, cube, (0, 5, 0)) == 1, "the floor"
    found = placement.supported_mask(CELLS, box.placed, cube, box.feasible(cube), 0.6)
    assert found[2, 0, 5] and not found[3, 0, 5] and not found[1, 2, 5]
    assert np.array_equal(found[:, :, 0], box.feasible(cube)[:, :, 0])


@pytest.mark.parametrize(("side", "supported"), [(19.9, 1), (16.1, 1), (15.9, 0)])
def test_what_is_less_than_a_grid_step_below_supports(side, supported) -> None:
    box = Box(CELLS)
    box.place(cube_of(side), (0, 0, 0))
    assert support_at(box, cube_of(8), (1, 1, 5)) == supported


def test_a_table_rests_on_its_legs_and_a_ball_on_a_spot() -> None:
    parts = [creation.box((24, 24, 2)), *(creation.box((4, 4, 14)) for _ in range(4))]
    for part, (x, y) in zip(parts[1:], [(-10, -10), (-10, 10), (10, -10), (10, 10)], strict=True):
        part.apply_translation((x, y, -7))
    mesh = trimesh.boolean.union(parts)
    shape = Shape.from_mesh(mesh, "table")
    table = Item(shape, (0.24 / shape.extents[0]) ** 3)
    box = Box(CELLS)
    box.place(cube_of(8), (0, 0, 0))
    box.place(cube_of(8), (4, 0, 0))
    assert support_at(box, table, (0, 0, 2)) == pytest.approx(0.5, abs=0.01), "two of four legs"
    ball = Item(BALL, (0.2 / BALL.extents[0]) ** 3)
    on_edge = Box(CELLS)
    on_edge.place(cube_of(20), (0, 0, 0))
    assert support_at(on_edge, ball, (0, 0, 5)) == 1
    assert support_at(on_edge, ball, (4, 0, 5)) == 0, "its middle is next to the cube"


def cubes_by_definition(box: Box, item: Item, at: tuple[int, int, int]) -> float:
    """The share of a polycube's lowest cubes that are on a cube or on the floor."""
    filled = {tuple(np.add(c, p.location).tolist()) for p in box.placed for c in cubes_of(p.item)}
    lowest = [np.add(c, at) for c in cubes_of(item) if c[2] == 0]
    return sum(z == 0 or (x, y, z - 1) in filled for x, y, z in lowest) / len(lowest)


@examples(30)
@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.25, 0.5, 0.6, 1.0]))
def test_masks_of_polycubes_are_those_by_cubes(seed, share) -> None:
    rng = np.random.default_rng(seed)
    episode = Episode(sequence(seed % 5, items=12, side=16), Rules(support=share))
    play_at_random(episode, rng, 3 * int(rng.integers(1, 8)))
    left = episode.task.items[int(rng.choice(np.flatnonzero(episode.outside)))]
    item, box = left.turned(int(rng.integers(24))), episode.box
    free = Box(box.cells)
    free.restore(box.snapshot())
    mask = box.feasible(item)
    for at in np.argwhere(free.feasible(item)).tolist():
        expected = cubes_by_definition(box, item, tuple(at))
        assert support_at(box, item, tuple(at)) == expected
        assert mask[tuple(at)] == (expected >= share)


@examples(12)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.05, 1))
def test_masks_are_those_of_the_plain_definition(seed, share) -> None:
    rng = np.random.default_rng(seed)
    box = Box((32, 32, 36), support=share)
    fill(box, [random_item(ZOO, 0.4, rng) for _ in range(5)], rng)
    item = random_item(ZOO, 0.4, rng)
    free = placement.oracle(box, item)
    mask = box.feasible(item)
    assert not (mask & ~free).any()
    for at in np.argwhere(free).tolist():
        candidate = PlacedItem(item, tuple(at))
        expected = placement.support_oracle(box.placed, candidate) >= share
        assert mask[tuple(at)] == expected == box.is_feasible(item, at)


def test_a_box_with_support_says_what_is_missing() -> None:
    box = Box(CELLS, support=0.6)
    box.place(cube_of(20), (0, 0, 0))
    small = cube_of(8)
    assert box.blbf(small) == (0, 5, 0) and box.feasible(small)[0, 0, 5]
    assert box.why_not(small, (0, 0, 6)) == placement.Blockers((), (), unsupported=True)
    assert not box.why_not(small, (0, 0, 5)) and box.why_not(small, (0, 0, 4)).items == (0,)
    with pytest.raises(InfeasibleError, match=r"at \(4, 0, 5\) has a support of 0.5, the rules"):
        box.place(small, (4, 0, 5))
    assert np.array_equal(box.candidates(small), box.feasible(small))
    assert box.rotations_at(small, (0, 0, 5)).all() and not box.rotations_at(small, (4, 0, 5)).any()


@pytest.mark.parametrize(
    "agent",
    [
        "largest-fitting-first/lowest/blbf",
        "best-fit",
        pytest.param("champion", marks=pytest.mark.slow),
        pytest.param("largest-first/aligned/blbf+beam=2", marks=pytest.mark.slow),
        pytest.param("champion+ruin-recreate=3", marks=pytest.mark.slow),
    ],
)
def test_agents_find_what_later_items_support(agent, tmp_path) -> None:
    """What is compared after each step finds answers that are kept too long."""
    rules = Rules(support=0.6, rotations="yaw")
    with checking():
        (rollout,) = evaluate(
            [agent], [sequence(3, items=9, side=12)], 0, rules=rules, file=tmp_path / "r.jsonl"
        )
    assert verify_dataset(tmp_path / "r.jsonl", blockout()).is_valid
    assert rollout.total > 0.3


def test_a_result_without_enough_support_is_refused(tmp_path) -> None:
    file = tmp_path / "r.jsonl"
    (rollout,) = evaluate(["smallest-first/random/random"], [sequence(side=12)], 0, file=file)
    placed = rollout.pack.contents(blockout()).placed
    named = [*placement_problems(Rules(support=0.6), rollout.pack.cells, placed)]
    box = Box((12, 12, 12), support=0.6)
    expected = [not box.is_feasible(one.item, one.location) for one in placed[:1]]
    assert len(named) >= sum(expected) and "has a support of" in named[0]
    line = json.loads(file.read_text())
    line["provenance"]["rules"] = {"support": 0.6}
    file.write_text(json.dumps(line) + "\n")
    problems = [str(problem) for problem in verify_dataset(file, blockout()).problems]
    assert any("its rules want 0.6" in problem for problem in problems)


@pytest.mark.parametrize("support", [-0.1, 1.01, float("nan"), "60%"])
def test_a_support_that_is_no_share_is_refused(support) -> None:
    with pytest.raises(ArgumentError, match=r"support .* is not possible: 0 to 1"):
        Rules(support=support)


def test_support_is_not_for_items_that_move() -> None:
    with pytest.raises(ArgumentError, match="need items that stay on the grid"):
        replace(Rules(support=0.6)).changed(physics=True)
