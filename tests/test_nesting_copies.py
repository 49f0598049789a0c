"""Boxes of many copies of one item: blocks of them are arranged and stacked."""

import numpy as np
import pytest

from packit_sim import ItemType, NestSettings, Packing, nest
from packit_sim.parts.nesting import copies
from packit_sim.parts.nesting.knapsacks import KnapsackSearch

VERTICES = ((0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))

BOX = 3.1, 3.1, 12.0


@pytest.fixture(autouse=True)
def _only_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of a dozen copies, which nothing else improves."""
    monkeypatch.setattr(copies, "_BLOCK", 12)
    monkeypatch.setattr(KnapsackSearch, "advance", lambda search, problem, budget: budget.take(999))


def packed(demand: int, **settings: int) -> list[Packing]:
    """Return the packings that are found, each better than the one before."""
    corner = ItemType("corner", np.array(VERTICES, float), np.array(FACES), demand)
    found: list[Packing] = []
    asked = NestSettings(workers=1, **settings)
    nest([corner], BOX, "knapsack", callback=lambda one, _: found.append(one), settings=asked)
    return found


def heights(packing: Packing) -> np.ndarray:
    """Return the lowest and highest height of each copy."""
    own = [packing.vertices(each)[:, 2] for each in packing.placements]
    return np.array([(each.min(), each.max()) for each in own])


def test_blocks_hold_more_copies_than_the_first_packing() -> None:
    first, *_, last = packed(90, iterations=200)
    assert len(last.placements) > len(first.placements) and last.problems() == []


def test_a_block_is_repeated() -> None:
    last = packed(90, iterations=200)[-1]
    places = [(tuple(np.round(p.pose.rotation, 9).ravel()), *np.round(p.pose.translation[:2], 6))
              for p in last.placements]  # fmt: skip
    assert len(set(places)) <= len(places) - copies._BLOCK // 2
    assert heights(last).max() <= BOX[2] + 1e-3


def test_a_search_ends_when_all_copies_are_in_the_box() -> None:
    (last,) = {len(one.placements) for one in packed(14, iterations=10_000)[-1:]}
    assert last == 14


def test_the_same_search_finds_the_same_packing() -> None:
    one, other = (packed(90, iterations=120)[-1] for _ in range(2))
    assert [p.matrix.tolist() for p in one.placements] == [
        p.matrix.tolist() for p in other.placements
    ]
