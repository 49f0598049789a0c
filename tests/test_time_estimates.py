"""The estimated remaining time of a generation, with a fake clock."""

import pytest

from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.datasets.provenance import UNKNOWN_PROVENANCE, Evolved
from packit_sim.game.generation.jobs import EvolutionProgress
from packit_sim.game.generation.time_estimates import ENOUGH, TimeEstimate, format_remaining

SETTINGS = EvolutionSettings(generations=99, patience=20)
"""An evolution has 100 generations, the first included, or ends 20 after its best."""


def pack(generation: int | None) -> Pack:
    provenance = (
        UNKNOWN_PROVENANCE
        if generation is None
        else Evolved(seed=0, generation=generation, size=1.0, settings=SETTINGS)
    )
    return Pack(LibraryRef("zoo", "1", ""), (100, 100, 100), (), 0.0, provenance)


def at(*generations: int) -> list[EvolutionProgress]:
    """Where evolutions 0, 1, 2 ... stand, of which so many generations are done."""
    return [EvolutionProgress(n, done - 1, 0.4) for n, done in enumerate(generations)]


def test_the_first_generations_tell_nothing() -> None:
    estimate = TimeEstimate(SETTINGS, packs=4, workers=2, since=0.0)
    assert estimate.seconds_left([], 10.0) is None
    assert estimate.seconds_left(at(ENOUGH, ENOUGH - 1), 10.0) is None
    assert estimate.seconds_left(at(ENOUGH, ENOUGH), 10.0) is not None


def test_the_rest_is_estimated_at_the_same_pace() -> None:
    """100 generations in 50 s; left are 50, 50 and twice 100."""
    estimate = TimeEstimate(SETTINGS, packs=4, workers=2, since=1000.0)
    assert estimate.seconds_left(at(50, 50), 1050.0) == pytest.approx(150)


def test_the_last_pack_has_one_worker_alone() -> None:
    """Two workers did 150 generations in 60 s, so that one does 1.25 a second."""
    estimate = TimeEstimate(SETTINGS, packs=2, workers=2, since=0.0)
    estimate.finish(0, pack(99))
    assert estimate.seconds_left([EvolutionProgress(1, 49, 0.4)], 60.0) == pytest.approx(40)


def test_what_was_there_before_took_none_of_the_time() -> None:
    done = {0: pack(99)}
    estimate = TimeEstimate(
        SETTINGS, 2, 1, since=0.0, before=[EvolutionProgress(1, 39, 0.4)], done=done
    )
    assert estimate.seconds_left([EvolutionProgress(1, 39, 0.4)], 10.0) is None
    assert estimate.seconds_left([EvolutionProgress(1, 59, 0.4)], 10.0) == pytest.approx(20)


def test_evolutions_are_as_long_as_those_that_ended() -> None:
    """The first ended after 50 + 21 generations; one that takes longer may run to the end."""
    estimate = TimeEstimate(SETTINGS, packs=3, workers=1, since=0.0)
    estimate.finish(0, pack(50))
    assert estimate.seconds_left([], 71.0) == pytest.approx(2 * 71)
    assert estimate.seconds_left([EvolutionProgress(1, 79, 0.4)], 151.0) == pytest.approx(20 + 71)


def test_a_checkpoint_of_a_finished_pack_is_let_be() -> None:
    estimate = TimeEstimate(SETTINGS, packs=1, workers=8, since=0.0)
    estimate.finish(0, pack(99))
    assert estimate.is_over(0) and not estimate.is_over(1)
    assert estimate.seconds_left(at(90), 10.0) == 0


def test_packs_without_a_recorded_generation_count_as_the_longest() -> None:
    estimate = TimeEstimate(SETTINGS, packs=2, workers=1, since=0.0, done={0: pack(None)})
    assert estimate.seconds_left([EvolutionProgress(1, 49, 0.4)], 50.0) == pytest.approx(50)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, ""),
        (0.0, ""),
        (59, "less than a minute left"),
        (100, "about 2 min left"),
        (3599, "about 60 min left"),
        (3600, "about 1 h left"),
        (4500, "about 1 h 20 min left"),
        (7100, "about 2 h left"),
        (40000, "about 11 h left"),
        (2.25 * 86400, "about 2.2 days left"),
    ],
)
def test_a_time_is_rounded_to_its_accuracy(seconds: float | None, text: str) -> None:
    assert format_remaining(seconds) == text
