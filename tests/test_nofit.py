"""No-fit tables compared with the oracle for a pair, at every offset."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core import caches
from packit_sim.engine import nofit
from packit_sim.engine.nofit import MEETINGS_BEFORE_TABLE, NoFit
from packit_sim.engine.screening_kernels import BLOCKED, OPEN
from packit_sim.geometry.shapes import Item
from packit_sim.placement import PlacedItem
from tests.zoo import BALL, RING, ZOO, random_item


@given(st.integers(0, 2**32 - 1))
def test_a_table_says_of_every_offset_what_the_oracle_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = sorted((random_item(ZOO, 0.2, rng) for _ in range(2)), key=lambda i: i.key)
    table = NoFit(first, second)
    here = (20, 20, 20)
    for place in np.ndindex(*(size + 2 for size in table.states.shape)):  # and one beyond
        x, y, z = (a + n - 1 - r for a, n, r in zip(here, place, table.reach, strict=True))
        a, b = PlacedItem(first, here), PlacedItem(second, (x, y, z))
        expected = placement.conflicts(a, b)
        assert table.conflict(a, b) is table.conflict(b, a) is expected
    assert not (table.states == OPEN).any()
    if first.key != second.key:
        for placed, item in ((PlacedItem(first, here), second), (PlacedItem(second, here), first)):
            states = np.zeros((41, 41, 41), dtype=np.uint8)
            table.merge_into(states, placed, item)
            assert (states == BLOCKED).sum() == (table.states == BLOCKED).sum()
            for location in rng.integers(10, 31, size=(20, 3)):
                candidate = PlacedItem(item, tuple(location.tolist()))
                blocked = states[candidate.location] == BLOCKED
                assert blocked == placement.conflicts(placed, candidate)


def test_a_pair_earns_its_table_by_meeting_and_again_when_it_is_gone() -> None:
    caches.clear()
    ring, ball = Item(RING, 0.4**3), Item(BALL, 0.2**3)
    placed = [PlacedItem(ring, (0, 0, 0))]
    for _ in range(2):
        for _ in range(MEETINGS_BEFORE_TABLE):
            assert nofit.no_fit_tables(placed, ball) is None
        for _ in range(3):
            tables = nofit.no_fit_tables(placed, ball)
            assert tables is not None and len(tables) == 1
        caches.clear("no-fit tables")


@pytest.mark.parametrize("swap", [False, True])
def test_with_tables_or_without_the_mask_is_the_same(swap: bool) -> None:
    caches.clear()
    items = [Item(RING, 0.5**3, 5), Item(BALL, 0.3**3)]
    host, item = reversed(items) if swap else items
    box = Box()
    box.place(host, (3, 4, 5))
    cold = box.feasible(item)
    for _ in range(MEETINGS_BEFORE_TABLE + 2):
        assert (box.feasible(item) == cold).all()
    assert caches.usage()["no-fit tables"].hits > 0
    assert cold.any() and not cold.all()
