"""The learned model of what fits: its box, its features, its network, and search in it."""

from functools import partial

import numpy as np
import pytest

from packit_agents.learned_model.contact_kernels import COUNTS, contact_features
from packit_agents.learned_model.contact_network import ContactNetwork, bundled_network
from packit_agents.learned_model.imagined_search import ImaginedSearch
from packit_agents.learned_model.learned_box import LearnedBox
from packit_agents.placements.ruin_and_recreate import RuinAndRecreate
from packit_agents.planning.budgets import Budget
from packit_agents.planning.neighbourhood_search import NeighbourhoodSearch
from packit_agents.planning.rollouts import play_on
from packit_sim.box import Box
from packit_sim.core.assets import assets_folder
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.rules import PACKIT, Rules
from tests.runs import tasks

HEURISTIC = Agent.from_name("largest-first/aligned/blbf")
PLACED = 6


def blocked(box, item, locations):
    """A model that is afraid."""
    return np.zeros(len(locations), dtype=bool)


def free(box, item, locations):
    """A model that fears nothing."""
    return np.ones(len(locations), dtype=bool)


def right(box, item, locations):
    """A model that is always right."""
    exact = Box()
    exact.restore(box.snapshot())
    return np.array([exact.is_feasible(item, at) for at in locations.tolist()], dtype=bool)


def filled(task: int = 1) -> Box:
    """A box with the first items of a task's solution."""
    episode = Episode(tasks()[task])
    for shape, rotation, at in episode.task.solution[:PLACED]:
        episode.box.place(episode.task.items[shape].turned(rotation), at)
    return episode.box


def others(task: int = 1):
    """The next items of the solution, in their rotations."""
    found = tasks()[task]
    return [found.items[n].turned(r) for n, r, _ in found.solution[PLACED : PLACED + 3]]


def test_with_a_model_that_is_right_the_box_is_the_exact_one() -> None:
    exact, box = filled(), LearnedBox(right)
    box.restore(exact.snapshot())
    for item in others():
        mask = exact.feasible(item)
        assert np.array_equal(box.feasible(item), mask)
        assert box.blbf(item) == exact.blbf(item)
        assert box.is_feasible(item, box.blbf(item))
    item = others()[0]
    assert np.array_equal(box.feasible_in_any(item), exact.feasible_in_any(item))
    for each in (box, exact):
        each.fill(item)
    assert np.array_equal(box.outer_words, exact.outer_words)


def test_a_model_decides_open_locations_alone() -> None:
    exact, afraid, bold = filled(), LearnedBox(blocked), LearnedBox(free)
    for box in (afraid, bold):
        box.restore(exact.snapshot())
    undecided = 0
    for item in others():
        mask = exact.feasible(item)
        assert not (afraid.feasible(item) & ~mask).any()
        assert not (mask & ~bold.feasible(item)).any()
        undecided += (bold.feasible(item) & ~afraid.feasible(item)).sum()
    assert undecided > 10


def test_features_are_counts_of_shared_cells_on_two_levels() -> None:
    """Compared with plain arrays of the two items' cells and fine cells."""
    box = Box()
    first, second = tasks()[1].items[:2]
    placed = box.place(first, (3, 2, 1))
    found = []

    def keep(box, item, locations):
        found.append((locations, contact_features(box.arrays, item.voxels.arrays, locations)))
        return blocked(box, item, locations)

    learned = LearnedBox(keep)
    learned.restore(box.snapshot())
    learned.feasible(second)
    ((locations, features),) = found
    assert len(locations) > 10
    for at, row in zip(locations[:1], np.expm1(features)[:1], strict=True):
        for level, side in enumerate((1, 4)):
            name = ("outer_cells", "outer_fine")[level]
            grids = []
            for item, location in ((placed.item, placed.location), (second, at)):
                grid, cells = np.zeros((100 * side,) * 3, bool), getattr(item.voxels, name)
                start = 4 * side * np.array(location)
                grid[tuple(map(slice, start, start + cells.shape))] = cells
                grids.append(grid)
            shared = grids[0] & grids[1]
            counted = row[level * COUNTS : (level + 1) * COUNTS]
            assert counted[0] == pytest.approx(shared.sum(), rel=1e-4)
            words = shared.reshape(np.repeat([25 * side, 4], 1).tolist() * 3).sum((1, 3, 5))
            assert counted[1] == pytest.approx((words > 0).sum(), rel=1e-4)
            assert counted[2] == pytest.approx(words.max(), rel=1e-4)
            split = shared.reshape(*shared.shape[:2], 25 * side, 4)
            pairs = (split[..., :-1] & split[..., 1:]).sum()
            assert counted[5] == pytest.approx(pairs, rel=1e-4)


def test_the_bundled_network_knows_more_than_the_more_frequent_answer() -> None:
    network, correct, exact = bundled_network(), [], []
    for task in (1, 2):
        box = filled(task)
        items = others(task)
        bold, afraid = LearnedBox(free), LearnedBox(blocked)
        for each in (bold, afraid):
            each.restore(box.snapshot())
        found = network.probabilities(box.snapshot(), items)
        for item, probability in zip(items, found, strict=True):
            mask = box.feasible(item)
            is_open = bold.feasible(item) & ~afraid.feasible(item)
            assert np.array_equal(probability[~is_open], mask[~is_open])
            correct += ((probability > 0.5) == mask)[is_open].tolist()
            exact += mask[is_open].tolist()
    assert np.mean(correct) > max(np.mean(exact), 1 - np.mean(exact)) + 0.1


def test_weights_of_another_network_are_refused(tmp_path) -> None:
    network = bundled_network()
    network.write(tmp_path / "same.safetensors")
    assert ContactNetwork.read(tmp_path / "same.safetensors").digest == network.digest
    with pytest.raises(Exception, match="'packit-placements': this agent reads 'packit-contacts'"):
        ContactNetwork.read(assets_folder() / "weights" / "champion.safetensors")


def played(search, rules: Rules = PACKIT, agent: Agent = HEURISTIC) -> Episode:
    episode = Episode(tasks()[1], rules)
    search(agent, episode, np.random.default_rng(0), lambda rollouts, best: None)
    assert episode.end is not None
    exact = Box(episode.box.cells)
    for placed in episode.box.placed:
        exact.place(placed.item, placed.location)
    return episode


def test_search_with_a_model_that_is_right_is_the_search_itself() -> None:
    lns = NeighbourhoodSearch(Budget(rollouts=3))
    imagined, exact = played(ImaginedSearch(lns, partial(LearnedBox, right))), played(lns)
    assert imagined.box.placed[: len(exact.box.placed)] == exact.box.placed


@pytest.mark.parametrize("easy", [False, True])
@pytest.mark.parametrize("model", [blocked, free])
def test_a_plan_of_a_wrong_model_is_played_by_the_rules(model, easy) -> None:
    search = ImaginedSearch(NeighbourhoodSearch(Budget(rollouts=2)), partial(LearnedBox, model))
    assert played(search, Rules(easy=easy)).total > 0.3


def test_ruin_and_recreate_plans_in_the_model_too() -> None:
    asked = []

    def model(box, item, locations):
        asked.append(item)
        return blocked(box, item, locations)

    search = ImaginedSearch(RuinAndRecreate(Budget(rollouts=2)), partial(LearnedBox, model))
    played(search, agent=Agent.from_name("champion"))
    assert asked


def test_a_model_that_changes_its_mind_ends_no_search() -> None:
    """Its answer depends on what else is in the box, and so on the order of a layout."""
    layouts = []

    def model(box, item, locations):
        return np.full(len(locations), not layouts)

    episode = Episode(tasks()[1])
    episode.box = LearnedBox(model)
    search = RuinAndRecreate(Budget(rollouts=1))
    search(
        Agent.from_name("champion"),
        episode,
        np.random.default_rng(0),
        lambda rollouts, best: layouts.append(best),
    )
    assert episode.end is not None and episode.total > 0.3


@pytest.mark.parametrize("rules", [{"kinematic": True}, {"support": 0.5}, {"boxes": 2}])
def test_the_rules_must_be_those_that_the_model_knows(rules) -> None:
    search = ImaginedSearch(NeighbourhoodSearch(Budget(rollouts=2)), Box)
    with pytest.raises(ArgumentError, match="these are"):
        search(HEURISTIC, Episode(tasks()[1], Rules(**rules)), None, None)


def test_a_box_of_other_cells_is_planned_in() -> None:
    search = ImaginedSearch(NeighbourhoodSearch(Budget(rollouts=2)), Box)
    assert played(search, Rules(cells=(120, 80, 100))).box.cells == (120, 80, 100)


def test_a_plan_is_played_where_it_was_planned() -> None:
    other, planned = Agent.from_name("largest-first/first-fit/random"), []

    def search(agent, episode, rng, on_progress):
        play_on(other, episode, rng, stages=())
        planned.extend(episode.box.placed)

    found = played(ImaginedSearch(search, Box)).box.placed
    assert set(planned) <= set(found) and len(planned) > 1
