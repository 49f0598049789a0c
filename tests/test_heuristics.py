"""The heuristic policies: tasks solved by hand, and comparisons with slow definitions."""

from collections.abc import Callable, Iterator
from functools import cache
from itertools import chain, product
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_agents.heuristics.column_runs import SHORTEST_GAP, mask_runs
from packit_agents.heuristics.contacts import Neighbours, by_contacts
from packit_agents.heuristics.heightmaps import gaps, growth, heightmap, space_below
from packit_sim.box import Box
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.episodes.policy_registry import load_policy
from packit_sim.geometry import rotations
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import STEP, Triple
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import Mask
from packit_sim.rules import End, Rules
from tests.examples import examples
from tests.zoo import RING, ZOO, cube_of, fill, random_item

DOCS = Path(__file__).parents[1] / "docs" / "guides" / "agents.md"

SEEDS = st.integers(0, 2**32 - 1)
BOXES = st.tuples(*[st.integers(4, 7).map(lambda nodes: STEP * nodes)] * 3)

Measure = Callable[[Item], float]
MEASURES: dict[str, Measure] = {
    "largest-first": lambda item: -item.volume,
    "smallest-first": lambda item: item.volume,
    "largest-box-first": lambda item: -float(np.round(item.extents.prod(), 12)),
    "longest-first": lambda item: -float(np.round(item.extents.max(), 12)),
}

SHAPES = (
    "largest-first",
    "largest-fitting-first",
    "smallest-first",
    "largest-box-first",
    "longest-first",
)
ROTATIONS = ("aligned", "first-fit", "lowest")
LOCATIONS = ("blbf", "dblf", "heightmap-minimisation", "maximal-contact", "least-empty")
ALL = tuple(("random", *names) for names in (SHAPES, ROTATIONS, LOCATIONS))


def block(*size: int) -> Item:
    """A block of so many cells an axis."""
    diagonal = float(np.linalg.norm(size))
    return Item(Shape.from_mesh(creation.box(size), f"block-{size}"), (diagonal / 100) ** 3)


def task_of(*items: Item, cells: Triple) -> Task:
    return Task(items, Pack(LibraryRef("zoo", "1", ""), cells, (), 0.0), ())


def episode_of(
    *items: Item,
    cells: Triple = (40, 40, 40),
    placed: tuple[tuple[Item, Triple], ...] = (),
    easy: bool = False,
    kinematic: bool = False,
) -> Episode:
    """An episode that begins in a box with something in it."""
    episode = Episode(task_of(*items, cells=cells), Rules(easy, kinematic))
    for item, location in placed:
        episode.box.place(item, location)
    return episode


policy = cache(load_policy)


def choose(stage: Stage, name: str, episode: Episode) -> int:
    return policy(stage, name)(episode, np.random.default_rng(0))


def locate(name: str, episode: Episode) -> Triple:
    """Where a policy puts the only item, upright unless the location comes first."""
    episode.step(0)
    if not episode.rules.easy:
        episode.step(0)
    at = choose(Stage.LOCATION, name, episode)
    assert episode.action_mask()[at]
    i, j, k = (int(n) for n in np.unravel_index(at, episode.box.nodes))
    return i, j, k


# --- Shape-Selection

RING_39 = Item(RING, (39 / 100 / RING.extents.max()) ** 3)
"""Its box has 39 x 39 x 9 cells, less than half of which the ring fills."""


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("largest-first", [0, 2, 1, 3]),
        ("smallest-first", [3, 1, 2, 0]),
        ("largest-box-first", [2, 0, 1, 3]),
        ("longest-first", [1, 2, 0, 3]),
    ],
)
def test_shapes_come_in_the_order_known_by_hand(name, order) -> None:
    items = cube_of(20), block(60, 5, 5), RING_39, cube_of(10)
    assert RING_39.cells == (39, 39, 9) and RING_39.volume < cube_of(20).volume
    episode = episode_of(*items, cells=(100, 100, 100))
    played = []
    while episode.end is None:
        played.append(choose(Stage.SHAPE, name, episode))
        episode.step(played[-1])
        episode.step(0)
        episode.step(choose(Stage.LOCATION, "blbf", episode))
    assert played == order


def test_the_largest_that_fits_comes_before_larger_ones_that_do_not() -> None:
    """The floor has space for one of two large blocks, and next to it for the cube."""
    items = block(24, 40, 24), cube_of(12), block(24, 40, 28)
    episode = episode_of(*items)
    assert choose(Stage.SHAPE, "largest-fitting-first", episode) == 2
    episode.box.place(items[2], (0, 0, 0))
    episode.outside[2] = False
    assert choose(Stage.SHAPE, "largest-first", episode) == 0
    assert choose(Stage.SHAPE, "largest-fitting-first", episode) == 1
    scores = policy(Stage.SHAPE, "largest-fitting-first").scores(episode, np.random.default_rng(0))
    assert scores.argmax() == 1 and scores[0] > -20 and np.isneginf(scores[2])


def test_a_shape_that_fits_only_in_another_rotation_fits_in_the_easy_game() -> None:
    """Of two boards the larger one is too deep for the box, and not too wide."""
    items, cells = (block(8, 36, 24), block(8, 20, 24)), (40, 24, 40)
    chosen = [
        choose(Stage.SHAPE, "largest-fitting-first", episode_of(*items, cells=cells, easy=easy))
        for easy in (False, True)
    ]
    assert chosen == [1, 0]


@pytest.mark.parametrize("name", ["largest-first", "largest-fitting-first"])
def test_where_nothing_fits_the_largest_comes_first(name) -> None:
    items = cube_of(20), cube_of(24)
    assert choose(Stage.SHAPE, name, episode_of(*items, cells=(16, 16, 16))) == 1


@pytest.mark.parametrize("name", MEASURES)
def test_of_shapes_that_tie_the_first_outside_comes_first(name) -> None:
    episode = episode_of(cube_of(10), cube_of(20), cube_of(20), cube_of(10))
    first, second = (0, 3) if name == "smallest-first" else (1, 2)
    assert choose(Stage.SHAPE, name, episode) == first
    episode.outside[first] = False
    assert choose(Stage.SHAPE, name, episode) == second


@pytest.mark.parametrize("name", MEASURES)
@examples(20)
@given(seed=SEEDS, count=st.integers(1, 8))
def test_the_order_of_items_does_not_change_what_is_chosen(name, seed, count) -> None:
    """The chosen shape measures the same, and no other measures better."""
    rng = np.random.default_rng(seed)
    shapes = [ZOO[n] for n in rng.integers(3, size=count)]
    items = [Item(shape, float(rng.choice([0.25, 0.5, 1]))) for shape in shapes]
    measure = MEASURES[name]
    best = min(map(measure, items))
    for _ in range(3):
        episode = episode_of(*items)
        assert measure(items[choose(Stage.SHAPE, name, episode)]) == pytest.approx(best)
        rng.shuffle(items)  # type: ignore[arg-type]


# --- Rotation-Selection


def turned_cells(name: str, episode: Episode, shape: int = 0) -> Triple:
    return episode.task.items[shape].turned(choose(Stage.ROTATION, name, episode)).cells


def test_lowest_stands_a_shape_up_in_a_slot_where_flat_it_would_lie_on_top() -> None:
    """A slot of 12 cells is left at the front of the floor, the rest is 20 cells high."""
    episode = episode_of(block(10, 20, 30), placed=((block(40, 28, 20), (0, 0, 0)),))
    episode.step(0)
    assert turned_cells("aligned", episode) == turned_cells("first-fit", episode) == (20, 30, 10)
    assert turned_cells("lowest", episode) == (30, 10, 20)
    episode.step(choose(Stage.ROTATION, "lowest", episode))
    assert episode.chosen_item is not None and episode.chosen_item.blbf == (0, 7, 0)


def test_first_fit_continues_if_aligned_does_not_fit() -> None:
    episode = episode_of(block(8, 16, 24), cells=(40, 20, 40))
    episode.step(0)
    assert turned_cells("aligned", episode) == (16, 24, 8)
    assert turned_cells("first-fit", episode) == turned_cells("lowest", episode) == (24, 16, 8)
    fits_upright = episode_of(block(8, 16, 24), cells=(8, 16, 24))
    fits_upright.step(0)
    for name in ("first-fit", "lowest"):
        assert turned_cells(name, fits_upright) == (8, 16, 24)


@pytest.mark.parametrize("name", ["first-fit", "lowest"])
def test_ties_and_shapes_that_do_not_fit_are_aligned(name) -> None:
    ties, no_room = (40, 40, 40), (8, 8, 8)
    for item, cells in ((cube_of(8), ties), (block(8, 16, 24), ties), (RING_39, no_room)):
        episode = episode_of(item, cells=cells)
        episode.step(0)
        assert choose(Stage.ROTATION, name, episode) == rotations.aligned(item.extents)


@pytest.mark.parametrize("name", ["aligned", "first-fit", "lowest"])
def test_where_the_location_comes_first_rotations_are_those_that_fit_there(name) -> None:
    """At the front wall nothing longer than 12 cells along y is left."""
    episode = episode_of(block(10, 20, 30), easy=True)
    episode.step(0)
    episode.step(int(np.ravel_multi_index((0, 7, 0), (10, 10, 10))))
    assert turned_cells(name, episode) == (30, 10, 20)


def slow_lowest(episode: Episode) -> int:
    """Every rotation at its BLBF location; the first in the order of alignment of the lowest."""
    assert episode.shape is not None
    item = episode.task.items[episode.shape]
    tops = {}
    for n in rotations.by_alignment(item.extents):
        turned = item.turned(n)
        at = episode.box.blbf(turned)
        if at is not None:
            tops[n] = STEP * at[2] + turned.cells[2]
    return min(tops, key=tops.__getitem__) if tops else rotations.aligned(item.extents)


@examples(20)
@given(seed=SEEDS, cells=BOXES, kinematic=st.booleans())
def test_lowest_is_what_trying_all_rotations_says(seed, cells, kinematic) -> None:
    episode = crowded(seed, cells, easy=False, kinematic=kinematic)
    assert choose(Stage.ROTATION, "lowest", episode) == slow_lowest(episode)


# --- Location-Selection

ROOF = (
    (block(4, 20, 8), (5, 0, 0)),
    (block(4, 20, 8), (9, 0, 0)),
    (block(20, 20, 4), (5, 0, 2)),
)
"""A bridge at the right and the back of a box of 40 cells, with a space of 12 x 20 x 8 below it."""

STEPS = ((block(4, 8, 8), (0, 0, 0)), (block(20, 8, 12), (5, 0, 0)))
"""A box of 40 x 8 cells in steps: 4 of 8 cells high, 16 of none, 20 of 12."""

SLOT = ((cube_of(8), (0, 3, 0)), (cube_of(8), (0, 7, 0)))
"""Two cubes at the left wall, with 8 cells between them, and 12 at the back."""


@pytest.mark.parametrize(
    ("item", "placed", "cells", "expected"),
    [
        pytest.param(
            cube_of(20),
            (),
            (40, 40, 40),
            dict.fromkeys(LOCATIONS, (0, 0, 0)),
            id="an empty box: the corner, since all its corners tie",
        ),
        pytest.param(
            cube_of(20),
            ((cube_of(20), (0, 0, 0)),),
            (40, 40, 40),
            {
                "blbf": (0, 5, 0),
                "dblf": (5, 0, 0),
                "heightmap-minimisation": (0, 5, 0),
                "maximal-contact": (0, 5, 0),
                "least-empty": (0, 5, 0),
            },
            id="beside a cube: deepest is at the back, left is at the left",
        ),
        pytest.param(
            cube_of(20),
            ((cube_of(20), (0, 0, 0)), (cube_of(20), (5, 0, 0))),
            (40, 40, 40),
            {"blbf": (0, 5, 0), "dblf": (0, 0, 5)},
            id="deepest goes up before it comes to the front",
        ),
        pytest.param(
            block(12, 20, 8),
            ROOF,
            (40, 40, 40),
            {
                "blbf": (0, 0, 0),
                "dblf": (0, 0, 0),
                "heightmap-minimisation": (6, 0, 0),
                "maximal-contact": (6, 0, 0),
                "least-empty": (0, 0, 0),
            },
            id="below a roof the heightmap does not grow, and everything touches",
        ),
        pytest.param(
            block(12, 8, 4),
            ROOF,
            (40, 40, 40),
            {"heightmap-minimisation": (6, 0, 0), "least-empty": (0, 0, 0)},
            id="of many locations below the roof the bottom left back one",
        ),
        pytest.param(
            block(20, 8, 4),
            STEPS,
            (40, 8, 40),
            {
                "blbf": (0, 0, 2),
                "dblf": (0, 0, 2),
                "heightmap-minimisation": (5, 0, 3),
                "maximal-contact": (5, 0, 3),
                "least-empty": (5, 0, 3),
            },
            id="on the higher step nothing is empty below",
        ),
        pytest.param(
            cube_of(8),
            SLOT,
            (40, 40, 40),
            {
                "blbf": (0, 0, 0),
                "dblf": (0, 0, 0),
                "heightmap-minimisation": (0, 0, 0),
                "maximal-contact": (0, 5, 0),
                "least-empty": (0, 0, 0),
            },
            id="in a slot four faces touch, in the corner three",
        ),
    ],
)
@pytest.mark.parametrize("kinematic", [False, True])
def test_locations_known_by_hand(item, placed, cells, expected, kinematic) -> None:
    for name, location in expected.items():
        if kinematic and placed is ROOF:
            continue
        episode = episode_of(item, cells=cells, placed=placed, kinematic=kinematic)
        assert locate(name, episode) == location, name


def test_what_comes_from_above_does_not_get_below_a_roof() -> None:
    for name in LOCATIONS:
        i, j, k = locate(name, episode_of(block(12, 20, 8), placed=ROOF, kinematic=True))
        assert i <= 2 or j >= 5 or k >= 3, name


def test_numbers_known_by_hand() -> None:
    """A plank of 20 x 8 x 4 cells, from wall to wall: across the gap, and on the higher step."""
    box = Box((40, 8, 40))
    for item, location in STEPS:
        box.place(item, location)
    item = block(20, 8, 4)
    mask = box.feasible(item)
    grown = growth(heightmap(box.outer_words), item, mask)
    empty = gaps(space_below(box.outer_words), item, mask)
    touching = contacts(box.outer_words, item, mask)
    assert grown[0, 0, 2] == 20 * 8 * 12 - 4 * 8 * 8 and grown[5, 0, 3] == 20 * 8 * 4
    assert empty[0, 0, 2] == 16 * 8 * 8 and empty[5, 0, 3] == 0
    sides, end = 2 * 20 * 4, 8 * 4
    assert touching[5, 0, 3] == 20 * 8 + sides + end
    assert touching[0, 0, 2] == 4 * 8 + sides + 2 * end
    assert touching[0, 0, 9] == sides + end  # the top is no wall


def contacts(words: Words, item: Item, mask: Mask) -> npt.NDArray[np.int64]:
    """The contacts at each location of a mask, 0 elsewhere; checks that they are in order."""
    found = np.zeros(mask.shape, dtype=np.int64)
    before = None
    for most, (i, j, k) in by_contacts(Neighbours.of(words), item, mask):
        assert mask[i, j, k] and (before is None or before < (-most, k, i, j))
        found[i, j, k], before = most, (-most, k, i, j)
        mask = mask.copy()
        mask[i, j, k] = False
    assert not mask.any()
    return found


# --- against slow and obvious definitions

Cells = npt.NDArray[np.bool_]


def slow_growth(filled: Cells, cells: Cells, start: Triple) -> int:
    """The sum of the heightmap after placing, less that before: column by column."""
    after = filled.copy()
    window = tuple(slice(s, s + n) for s, n in zip(start, cells.shape, strict=True))
    after[window] |= cells
    total = 0
    for x, y in np.ndindex(filled.shape[:2]):
        for sign, column in ((-1, filled[x, y]), (1, after[x, y])):
            total += sign * max((z + 1 for z in range(len(column)) if column[z]), default=0)
    return total


def slow_gaps(filled: Cells, cells: Cells, start: Triple) -> int:
    """Down from the lowest cell of each column, cell by cell, as long as they are empty."""
    total = 0
    for x, y in np.ndindex(cells.shape[:2]):
        if cells[x, y].any():
            z = start[2] + int(cells[x, y].argmax()) - 1
            while z >= 0 and not filled[start[0] + x, start[1] + y, z]:
                total += 1
                z -= 1
    return total


def slow_contacts(filled: Cells, cells: Cells, start: Triple) -> int:
    """Each of the six neighbours of each cell."""
    total = 0
    for cell in np.argwhere(cells) + start:
        for axis in range(3):
            for step in (-1, 1):
                other = cell.copy()
                other[axis] += step
                if not 0 <= other[axis] < filled.shape[axis]:
                    total += (axis, step) != (2, 1)
                else:
                    total += int(filled[tuple(other)])
    return total


SLOW: dict[str, tuple[Callable[[Cells, Cells, Triple], int], int]] = {
    "heightmap-minimisation": (slow_growth, 1),
    "least-empty": (slow_gaps, 1),
    "maximal-contact": (slow_contacts, -1),
}


def crowded(seed: int, cells: Triple, easy: bool, kinematic: bool) -> Episode:
    """An episode in a box with a few odd shapes in it, one more of which is chosen."""
    rng = np.random.default_rng(seed)
    items = [random_item(ZOO, 0.17, rng) for _ in range(5)]
    episode = episode_of(items[0].turned(0), cells=cells, easy=easy, kinematic=kinematic)
    fill(episode.box, items[1:], rng)
    episode.step(0)
    return episode


def standings(episode: Episode) -> Iterator[tuple[Item, Triple]]:
    """Each feasible location, bottom, left and back first, and the item as it is valued there."""
    assert episode.chosen_item is not None
    item = episode.chosen_item.item
    nodes = np.argwhere(episode.chosen_item.feasible)
    for i, j, k in nodes[np.lexsort((nodes[:, 1], nodes[:, 0], nodes[:, 2]))].tolist():
        if episode.rotation is None:
            valid = episode.chosen_item.rotations((i, j, k))
            rotation = next(n for n in rotations.by_alignment(item.extents) if valid[n])
            yield item.turned(rotation), (i, j, k)
        else:
            yield item, (i, j, k)


@pytest.mark.parametrize("easy", [False, True])
@pytest.mark.parametrize("name", SLOW)
@examples(8)
@given(seed=SEEDS, cells=BOXES, kinematic=st.booleans())
def test_locations_are_what_slow_loops_say(name, easy, seed, cells, kinematic) -> None:
    episode = crowded(seed, cells, easy, kinematic)
    if not easy:
        episode.step(seed % 24)
    if episode.end is not None:
        return
    score, sign = SLOW[name]
    scores = {
        location: sign * score(episode.box.outer, item.outer, tuple(STEP * n for n in location))
        for item, location in standings(episode)
    }
    expected = min(scores, key=scores.__getitem__)
    at = choose(Stage.LOCATION, name, episode)
    assert np.unravel_index(at, episode.box.nodes) == expected


@examples(20)
@given(seed=SEEDS, cells=BOXES)
def test_scores_are_those_of_slow_loops(seed, cells) -> None:
    episode = crowded(seed, cells, easy=False, kinematic=False)
    episode.step(seed % 24)
    if episode.end is not None:
        return
    assert episode.chosen_item is not None
    item, mask, words = (
        episode.chosen_item.item,
        episode.chosen_item.feasible,
        episode.box.outer_words,
    )
    fast = (
        (growth(heightmap(words), item, mask), slow_growth),
        (gaps(space_below(words), item, mask), slow_gaps),
        (contacts(words, item, mask), slow_contacts),
    )
    nodes = np.random.default_rng(seed).permutation(np.argwhere(mask))[:10]
    for scores, slow in fast:
        assert not scores[~mask].any()
        for node in nodes:
            expected = slow(episode.box.outer, item.outer, tuple((STEP * node).tolist()))
            assert scores[tuple(node)] == expected, slow.__name__


def test_nothing_is_scored_if_nothing_fits() -> None:
    box, item = Box((40, 40, 40)), cube_of(50)
    mask = box.feasible(item)
    assert not mask.any()
    for scores in (
        growth(heightmap(box.outer_words), item, mask),
        gaps(space_below(box.outer_words), item, mask),
        contacts(box.outer_words, item, mask),
    ):
        assert scores.shape == mask.shape and not scores.any()


@given(seed=SEEDS, nodes=st.tuples(*[st.integers(1, 9)] * 3), share=st.floats(0, 1))
def test_runs_cover_all_that_is_true_and_have_long_gaps_between_them(seed, nodes, share) -> None:
    mask = np.random.default_rng(seed).random(nodes) < share**4
    looked_at = np.zeros(mask.size, dtype=bool)
    end_before = -SHORTEST_GAP
    for begin, end in mask_runs(mask).tolist():
        assert mask.flat[begin] and mask.flat[end - 1]
        assert begin - end_before >= SHORTEST_GAP
        looked_at[begin:end] = True
        end_before = end
    assert (looked_at >= mask.ravel()).all()


# --- all policies, in any episode


def play_all(episode: Episode, names: tuple[str, ...], rng: np.random.Generator) -> list[int]:
    """Plays on to the end, with an eye on the mask; the actions."""
    actions = []
    while episode.end is None:
        actions.append(policy(episode.stage, names[episode.stage])(episode, rng))
        assert episode.action_mask()[actions[-1]]
        episode.step(actions[-1])
    return actions


@given(
    seed=SEEDS,
    cells=BOXES,
    easy=st.booleans(),
    kinematic=st.booleans(),
    names=st.tuples(*map(st.sampled_from, ALL)),
)
def test_every_policy_chooses_what_is_valid_and_a_seed_says_all(
    seed, cells, easy, kinematic, names
) -> None:
    rng = np.random.default_rng(seed)
    items = [random_item(ZOO, 0.17, rng).turned(0) for _ in range(4)]
    played = []
    for _ in range(2):
        episode = episode_of(*items, cells=cells, easy=easy, kinematic=kinematic)
        played.append(play_all(episode, names, np.random.default_rng(seed)))
        assert episode.end is not End.INVALID_ACTION
    assert played[0] == played[1]


@pytest.mark.slow
@pytest.mark.parametrize("easy", [False, True])
def test_only_random_policies_draw_random_numbers(easy) -> None:
    for names in product(*ALL):
        rng = np.random.default_rng(1)
        before = rng.bit_generator.state
        play_all(episode_of(cube_of(12), RING_39, cube_of(16), easy=easy), names, rng)
        assert (rng.bit_generator.state == before) == ("random" not in names), names


def test_the_page_of_the_docs_has_every_policy() -> None:
    rows = [line.split("|") for line in DOCS.read_text(encoding="utf-8").splitlines()]
    listed = {row[1].strip(" `") for row in rows if len(row) > 3}
    assert set(chain(*ALL)) <= listed
