"""Boxes of many copies of one item: blocks of them are arranged and stacked."""

import numpy as np
import pytest

from packit_sim import ItemType, NestSettings, Packing, nest
from packit_sim.parts.nesting import copies
from packit_sim.parts.nesting.knapsacks import KnapsackSearch

VERTICES = ((0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))

BOX = 3.1, 3.1, 12.0


@pytest.fixture(name="only_blocks")
def _only_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of a dozen copies, which nothing else improves."""
    monkeypatch.setattr(copies, "_BLOCK", 12)
    monkeypatch.setattr(KnapsackSearch, "_rebuild", lambda *_: None)
    monkeypatch.setattr(KnapsackSearch, "_end", lambda *_: None)  # of exchanges


def packed(demand: int, iterations: int, start: Packing | None = None) -> list[Packing]:
    """Return the packings that are found, each better than the one before."""
    corner = ItemType("corner", np.array(VERTICES, float), np.array(FACES), demand)
    found: list[Packing] = []
    asked = NestSettings(workers=1, start=start, iterations=iterations)
    nest([corner], BOX, "knapsack", callback=lambda one, _: found.append(one), settings=asked)
    return found


def test_blocks_hold_more_copies_than_the_first_packing(only_blocks) -> None:
    first, *_, last = packed(90, iterations=200)
    assert len(last.placements) > len(first.placements) and last.problems() == []


def test_a_block_is_repeated(only_blocks) -> None:
    last = packed(90, iterations=200)[-1]
    poses = [each.pose for each in last.placements]
    columns = {(*each.rotation.ravel().round(9), *each.translation[:2].round(6)) for each in poses}
    assert len(columns) <= len(poses) - copies._BLOCK // 2


def test_a_search_ends_when_all_copies_are_in_the_box(only_blocks) -> None:
    (last,) = {len(one.placements) for one in packed(14, iterations=10_000)[-1:]}
    assert last == 14


def test_the_same_search_finds_the_same_packing(only_blocks) -> None:
    one, other = (packed(90, iterations=120)[-1] for _ in range(2))
    assert [p.matrix.tolist() for p in one.placements] == [
        p.matrix.tolist() for p in other.placements
    ]


def test_a_search_goes_on_from_a_packing(only_blocks) -> None:
    first = packed(90, iterations=100)[-1]
    last = packed(90, start=first, iterations=400)[-1]
    assert len(last.placements) > len(first.placements) and last.problems() == []


def test_limits_are_kept() -> None:
    corner = ItemType("corner", np.array(VERTICES, float), np.array(FACES), 90)
    asked = NestSettings(workers=1, iterations=60, limits=(((1.0,), 20.0),))
    found = nest([corner], BOX, "knapsack", settings=asked)
    assert len(found.placements) == 20
