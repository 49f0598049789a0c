import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.box import Box
from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.evolution_settings import SEARCHES, EvolutionSettings
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.generation.chromosomes import Chromosome, crossover, mutate, order_crossover
from packit_sim.game.generation.evolution import Evolution, EvolutionState, Generation, evolve
from packit_sim.game.generation.pack_creator import PackCreator, Recipe, draw_pool
from packit_sim.game.generation.strategies import search_of, select
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from tests.zoo import BALL, CUBE

SMALL = EvolutionSettings(pool=8, population=8, elite=2, lucky=2, generations=4, keep_every=2)
seeds = st.integers(0, 2**32 - 1)


def assert_valid(chromosome: Chromosome, settings: EvolutionSettings) -> None:
    assert sorted(chromosome.order.tolist()) == list(range(settings.pool))
    assert ((chromosome.scales >= 0) & (chromosome.scales < len(settings.scales))).all()
    assert ((chromosome.rotations >= 0) & (chromosome.rotations < 24)).all()
    assert chromosome.scales.shape == chromosome.rotations.shape == (settings.pool,)


@pytest.mark.parametrize(
    ("a", "b", "start", "stop", "child"),
    [
        # Davis' example: the part between the cuts stays, the rest comes from behind the second cut
        ([1, 2, 3, 4, 5, 6, 7, 8], [2, 4, 6, 8, 7, 5, 3, 1], 2, 5, [8, 7, 3, 4, 5, 1, 2, 6]),
        ([0, 1, 2, 3], [3, 2, 1, 0], 0, 4, [0, 1, 2, 3]),
        ([0, 1, 2, 3], [3, 2, 1, 0], 2, 2, [3, 2, 1, 0]),
        ([0, 1, 2, 3], [3, 2, 1, 0], 0, 1, [0, 2, 1, 3]),
    ],
)
def test_order_crossover_by_hand(a, b, start, stop, child) -> None:
    assert order_crossover(np.array(a), np.array(b), start, stop).tolist() == child


@given(seeds)
def test_children_consist_of_their_parents_genes(seed) -> None:
    rng = np.random.default_rng(seed)
    a, b = Chromosome.random(SMALL, rng), Chromosome.random(SMALL, rng)
    child = crossover(a, b, rng)
    assert_valid(child, SMALL)
    assert ((child.scales == a.scales) | (child.scales == b.scales)).all()
    assert ((child.rotations == a.rotations) | (child.rotations == b.rotations)).all()


@given(seeds, st.floats(0, 1), st.floats(0, 1))
def test_mutants_are_valid_and_rate_0_changes_nothing(seed, swap_rate, point_rate) -> None:
    rng = np.random.default_rng(seed)
    settings = EvolutionSettings(pool=8, swap_rate=swap_rate, point_rate=point_rate)
    parent = Chromosome.random(settings, rng)
    mutant = mutate(parent, settings, rng)
    assert_valid(mutant, settings)
    assert (mutant.order != parent.order).sum() in (0, 2)
    still = mutate(parent, EvolutionSettings(pool=8, swap_rate=0, point_rate=0), rng)
    for gene in ("order", "scales", "rotations"):
        assert (getattr(still, gene) == getattr(parent, gene)).all()


@given(seeds)
def test_the_best_survive_and_some_others_at_random(seed) -> None:
    rng = np.random.default_rng(seed)
    densities = rng.random(8).tolist()
    survivors = select(densities, SMALL, rng)
    ranked = sorted(range(8), key=lambda n: -densities[n])
    assert survivors[:2] == ranked[:2]
    assert len(set(survivors)) == 4 and set(survivors[2:]) <= set(ranked[2:])


def test_the_pack_creator_leaves_out_what_finds_no_place() -> None:
    """Worked by hand: a cube over half the box an axis, a second one that can't join it, a ball."""
    big = (0.56 * 3**0.5) ** 3
    small = (0.2 * 3**0.5) ** 3
    creator = PackCreator([CUBE, CUBE, BALL], [big, small], (100, 100, 100))
    upright = np.zeros(3, dtype=int)
    box = creator.pack(Chromosome(np.array([1, 0, 2]), np.array([0, 0, 1]), upright))
    assert [p.item for p in box.placed] == [Item(CUBE, big), Item(BALL, small)]
    assert [p.location for p in box.placed] == [(0, 0, 0), (0, 14, 0)]
    again = creator.pack(Chromosome(np.array([2, 0, 1]), np.array([0, 0, 1]), upright))
    assert again.placed[0].location == (0, 0, 0)


def test_the_pool_is_drawn_by_category_first() -> None:
    library = ShapeLibrary.open("everyday")
    drawn = draw_pool(library, 3000, np.random.default_rng(0))
    counts = dict.fromkeys(library.categories, 0)
    for id in drawn:
        counts[library[id].category] += 1
    expected = 3000 / len(counts)
    assert all(abs(n - expected) < 6 * expected**0.5 for n in counts.values())


def facts(evolution: Evolution) -> tuple:
    return evolution.best, evolution.kept, evolution.densities, evolution.evaluated


def test_evolution_is_repeatable_and_its_packs_hold() -> None:
    library = ShapeLibrary.open("everyday")
    seen: list[Generation] = []
    first = evolve(library, 7, SMALL, seen.append)
    again = evolve(library, 7, SMALL)
    assert facts(first) == facts(again)
    assert evolve(library, 8, SMALL).best != first.best
    assert list(first.densities) == sorted(first.densities) and len(first.densities) == 5
    assert [g.number for g in seen] == [0, 1, 2, 3, 4]
    assert [g.best for g in seen] == list(first.densities)
    assert first.best.density == first.densities[-1]
    assert [pack.density for pack in first.kept] == [first.densities[n] for n in (0, 2, 4)]
    assert verify(first.best, library) == []
    evolved = first.best.provenance
    assert evolved.seed == 7 and 0.75 <= evolved.size <= 1 and evolved.settings.pool == 8
    factors = {round(i.scale / evolved.size**3, 9) for i in first.best.items}
    assert factors <= {0.25, 0.5, 1.0, 2.0, 4.0}


def test_evolution_stops_when_it_gets_no_better() -> None:
    library = ShapeLibrary.open("everyday")
    alone = EvolutionSettings(
        pool=1,
        population=4,
        elite=1,
        lucky=1,
        generations=50,
        patience=3,
        scales=(0.1,),
        point_rate=0,
    )
    stopped = evolve(library, 1, alone)
    assert len(stopped.densities) < 50
    assert len(set(stopped.densities[-4:])) == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"pool": 0},
        {"population": 50},
        {"scales": ()},
        {"scales": (1.0, -1.0)},
        {"size_range": (1.0, 0.5)},
        {"swap_rate": 1.5},
        {"cells": (10, 10, 10)},
        {"generations": -1},
        {"patience": 0},
        {"search": "annealing"},
        {"search": "climbing"},
    ],
)
def test_impossible_settings_are_refused_by_name(wrong) -> None:
    with pytest.raises(
        ValueError, match="multiple of 4" if "cells" in wrong else next(iter(wrong))
    ):
        EvolutionSettings(**wrong)


def test_boxes_of_other_sizes_evolve_too() -> None:
    library = ShapeLibrary.open("everyday")
    settings = EvolutionSettings(
        pool=5, population=4, elite=1, lucky=1, generations=1, cells=(60, 80, 40)
    )
    pack = evolve(library, 0, settings).best
    assert pack.cells == (60, 80, 40)
    assert isinstance(pack.replay(library), Box)


@pytest.mark.slow
@pytest.mark.parametrize("search", SEARCHES)
def test_workers_change_nothing(search) -> None:
    library = ShapeLibrary.open("everyday")
    settings = dataclasses.replace(SMALL, search=search)
    alone = evolve(library, 5, settings)
    with Workers(2) as workers:
        assert facts(evolve(library, 5, settings, workers=workers)) == facts(alone)
    assert alone.densities == sorted(alone.densities)


@pytest.mark.parametrize("search", SEARCHES)
def test_a_stored_state_resumes_the_same_evolution(search) -> None:
    library = ShapeLibrary.open("everyday")
    settings = dataclasses.replace(SMALL, search=search)
    whole = evolve(library, 6, settings)
    for stop in (0, 1, 3):
        first = Evolution(library, 6, settings)
        for _ in range(stop):
            first.step()
        second = Evolution(library, 6, settings)
        text = typed_json.encode(first.state)
        second.restore(typed_json.decode(text, EvolutionState, ArgumentError))
        while not second.is_over:
            second.step()
        assert facts(second) == facts(whole)


@pytest.mark.parametrize("search", SEARCHES)
@given(seeds)
def test_giving_up_on_hopeless_chromosomes_changes_nothing(search, seed) -> None:
    """A search takes the same course if densities below its threshold are given as 0."""
    settings = dataclasses.replace(SMALL, population=12, elite=3, lucky=3, search=search)
    searches = search_of(settings), search_of(settings)
    rngs = np.random.default_rng(seed), np.random.default_rng(seed)
    draws = np.random.default_rng(seed)
    for _ in range(12):
        asked, same = (s.ask(rng) for s, rng in zip(searches, rngs, strict=True))
        assert [c.to_json() for c in asked] == [c.to_json() for c in same]
        known = draws.random(len(asked)).tolist()
        assert searches[0].threshold == searches[1].threshold
        blurred = [d if d >= searches[1].threshold else 0.0 for d in known]
        searches[0].tell(asked, known)
        searches[1].tell(same, blurred)


@pytest.mark.slow
def test_hopeless_chromosomes_are_given_up_and_no_others() -> None:
    library = ShapeLibrary.open("everyday")
    settings = EvolutionSettings(pool=30, size_range=(0.7, 0.7))
    recipe = Recipe.drawn(library, settings, np.random.default_rng(1))
    creator = recipe.creator()
    rng = np.random.default_rng(2)
    drawn = [Chromosome.random(settings, rng) for _ in range(12)]
    known = [creator.density(chromosome) for chromosome in drawn]
    boxes = [creator.pack(chromosome).snapshot().placed for chromosome in drawn]
    assert all(len(placed) < 30 for placed in boxes)
    for threshold in (*known, *(density + 1e-6 for density in known), 0.9):
        for chromosome, density, placed in zip(drawn, known, boxes, strict=True):
            found = creator.density(chromosome, threshold)
            assert found == (density if density >= threshold else 0)
            if found:
                assert creator.box.placed == placed


def test_what_was_written_down_of_another_evolution_is_refused() -> None:
    library = ShapeLibrary.open("everyday")
    state = Evolution(library, 6, SMALL).state
    with pytest.raises(ValueError, match="seed was 6, now 7"):
        Evolution(library, 7, SMALL).restore(state)
    other = dataclasses.replace(SMALL, size_range=(0.5, 0.6))
    with pytest.raises(ValueError, match="settings was"):
        Evolution(library, 6, other).restore(state)
