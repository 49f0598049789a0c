"""The benchmarks of evolution measure what they claim to measure."""

import dataclasses

import numpy as np
import pytest

from packit_sim import EvolutionSettings, ShapeLibrary
from packit_sim.game.generation.chromosomes import Chromosome
from packit_sim.game.generation.evolution import Evolution, evolve

pytest.importorskip("torch")
from benchmarks.evolution import Meter, early_stop

SMALL = EvolutionSettings(
    pool=8, population=8, elite=2, lucky=2, generations=4, patience=9, keep_every=2
)


@pytest.fixture(name="searches", scope="module")
def _searches():
    pytest.importorskip("deap")
    from benchmarks import searches

    return searches


@pytest.mark.slow
def test_stopping_early_is_read_off_the_densities() -> None:
    library = ShapeLibrary.open("everyday")
    settings = EvolutionSettings(pool=6, population=6, elite=1, lucky=1, generations=40, patience=3)
    stopped = evolve(library, 4, settings)
    through = evolve(library, 4, dataclasses.replace(settings, patience=41)).densities
    assert early_stop(through, 3) == len(stopped.densities) - 1
    assert through[: len(stopped.densities)] == stopped.densities


def test_a_meter_counts_what_is_given_up_and_changes_nothing() -> None:
    library = ShapeLibrary.open("everyday")
    alone = evolve(library, 5, SMALL)
    early, whole = Meter(), Meter(whole=True)
    for meter in (early, whole):
        evolution = Evolution(library, 5, SMALL)
        while not evolution.is_over:
            evolution.step(meter)
        assert evolution.densities == alone.densities and evolution.best == alone.best
        assert meter.chromosomes == alone.evaluated
    assert early.given_up > whole.given_up == 0


def test_a_run_of_the_papers_search_is_its_evolution(searches) -> None:
    library = ShapeLibrary.open("everyday")
    _, _, found = searches.run(library, searches.PAPERS, 3, SMALL)
    assert found == evolve(library, 3, SMALL).densities


def test_searches_start_from_the_same_and_pack_equally_many(searches) -> None:
    for kind in searches.KINDS.values():
        search, rng, same = kind(SMALL), np.random.default_rng(1), np.random.default_rng(1)
        first = search.ask(rng)
        wanted = [Chromosome.random(SMALL, same) for _ in range(SMALL.population)]
        assert [c.to_json() for c in first] == [c.to_json() for c in wanted]
        search.tell(first, np.linspace(0.1, 0.5, len(first)).tolist())
        for _ in range(3):
            children = search.ask(rng)
            assert len(children) == SMALL.children
            search.tell(children, rng.random(len(children)).tolist())


def test_tournaments_are_repeatable_keep_the_best_and_breed_chromosomes(searches) -> None:
    asked = []
    for _ in range(2):
        search, rng = searches.Tournaments(SMALL), np.random.default_rng(2)
        search.tell(search.ask(rng), [0.1, 0.9, *[0.2] * 6])
        best = search.population[1].to_json()
        children = search.ask(rng)
        assert search.population[0].to_json() == best and max(search.densities) == 0.9
        asked.append([child.to_json() for child in children])
        for child in children:
            assert sorted(child.order) == list(range(8))
            assert set(child.scales) <= set(range(5)) and set(child.rotations) <= set(range(24))
    assert asked[0] == asked[1]


def test_intervals_hold_the_mean_and_shrink_to_a_constant(searches) -> None:
    values = np.array([[0.1, 0.5], [0.2, 0.5], [0.6, 0.5]])
    mean, low, high = searches.interval(values)
    assert mean == pytest.approx([0.3, 0.5])
    assert low[0] < 0.3 < high[0] and low[1] == pytest.approx(0.5) == high[1]
