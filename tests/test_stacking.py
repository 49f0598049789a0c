"""What parts rest on, and loads: stacks whose answers are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.supports import lowered, stacking
from packit_sim.parts.handling.sweeps import PartSweeps
from tests.examples import examples
from tests.packed_parts import bowl, cuboid, joined, moved, packed, table


def test_a_table_on_a_box_rests_on_it_alone() -> None:
    """Its top is 4 mm above the box, its legs 7 mm above the floor: it rests on the box."""
    box = cuboid((20, 20, 0), (50, 50, 39))
    found = stacking(packed(box, moved(table(), 5, 5, 7)))
    assert found.supports == ((), (0,))
    assert found.on_floor == (True, False)
    assert found.drops == pytest.approx((0, 4), abs=0.02)
    assert found.on_top(0) == (1,)


def test_a_table_over_a_lower_box_stands_on_the_floor() -> None:
    box = cuboid((20, 20, 0), (50, 50, 30))
    found = stacking(packed(box, moved(table(), 5, 5, 2)))
    assert found.supports == ((), ())
    assert found.on_floor == (True, True)


def test_loads_are_shared_equally_and_passed_on() -> None:
    """A beam of 6 on two posts of 1; a weight of 10 on the beam."""
    posts = [cuboid((x, 0, 0), (x + 10, 10, 20)) for x in (0, 40)]
    beam, weight = cuboid((0, 0, 20), (50, 10, 30)), cuboid((0, 0, 30), (10, 10, 40))
    found = stacking(packed(*posts, beam, weight))
    assert found.loads([1, 1, 6, 10]) == pytest.approx({0: 8, 1: 8, 2: 10, 3: 0})


def test_the_floor_takes_its_share() -> None:
    """A lintel with one foot on the floor and its other end on a block."""
    lintel = joined(cuboid((25, 0, 0), (40, 20, 20)), cuboid((0, 0, 10), (25, 20, 20)))
    found = stacking(packed(cuboid((0, 0, 0), (20, 20, 10)), lintel))
    assert found.supports[1] == (0,) and found.on_floor[1]
    assert found.loads([1, 8])[0] == pytest.approx(4)


def test_all_parts_of_a_floating_tower_come_down_together() -> None:
    tower = [cuboid((10, 10, 30 + 20 * n), (30, 30, 45 + 20 * n)) for n in range(3)]
    packing = packed(*tower)
    found = stacking(packing)
    assert found.drops == pytest.approx((30, 35, 40), abs=0.05)
    assert found.supports == ((), (0,), (1,))
    resting = lowered(packing)
    assert resting.problems() == []
    assert resting.height == pytest.approx(45, abs=0.05)
    assert stacking(resting).drops == pytest.approx((0, 0, 0), abs=0.03)


def test_of_two_links_of_a_chain_one_hangs_on_the_other() -> None:
    """Each is above and below the other; one comes down to the floor, the other with it."""
    link = joined(
        cuboid((10, 40, 40), (60, 45, 45)),
        cuboid((10, 40, 80), (60, 45, 85)),
        cuboid((10, 40, 45), (15, 45, 80)),
        cuboid((55, 40, 45), (60, 45, 80)),
    )
    other = joined(
        cuboid((30, 10, 60), (35, 75, 65)),
        cuboid((30, 10, 20), (35, 15, 60)),
        cuboid((30, 70, 20), (35, 75, 60)),
        cuboid((30, 10, 15), (35, 75, 20)),
    )
    found = stacking(packed(link, other))
    assert found.drops == pytest.approx((30, 15), abs=0.05)
    assert found.supports == ((1,), ()) and found.on_floor == (False, True)


def test_a_fixed_part_carries_others_and_does_not_come_down() -> None:
    shelf, cube = cuboid((0, 0, 50), (50, 50, 60)), cuboid((10, 10, 70), (20, 20, 80))
    found = stacking(packed(shelf, cube), fixed=(0,))
    assert found.drops == pytest.approx((0, 10), abs=0.02)
    assert found.supports == ((), (0,))
    assert found.on_floor == (True, False)


def test_a_leaning_pile_of_bowls_rests_on_the_lowest() -> None:
    bowls = [moved(bowl(), 50, 50, 20 * n) for n in range(3)]
    found = stacking(packed(*bowls))
    assert found.supports == ((), (0,), (1,))
    assert found.loads([1, 2, 4]) == pytest.approx({0: 6, 1: 4, 2: 0})
    assert 0 < found.drops[1] < 20


def test_a_wider_contact_distance_finds_more_supports() -> None:
    posts = [cuboid((0, 0, 0), (10, 10, 20)), cuboid((40, 0, 0), (50, 10, 19))]
    packing = packed(*posts, cuboid((0, 0, 20), (50, 10, 30)))
    assert stacking(packing).supports[2] == (0,)
    assert stacking(packing, contact=1.5).supports[2] == (0, 1)


@pytest.mark.parametrize("contact", [0, -1, math.nan])
def test_a_contact_distance_must_be_positive(contact: float) -> None:
    with pytest.raises(ArgumentError, match="contact"):
        stacking(packed(bowl()), contact)


def test_a_packing_with_a_clearance_is_not_lowered() -> None:
    with pytest.raises(ArgumentError, match="clearance of 1 can't be lowered"):
        lowered(packed(bowl(), clearance=1.0))


@given(st.integers(0, 2**32 - 1))
@examples(30)
def test_settling_keeps_the_order_and_the_whole_weight_reaches_the_floor(seed: int) -> None:
    rng = np.random.default_rng(seed)
    meshes = []
    for n in range(12):  # disjoint slabs, one above the other
        low = np.array((*rng.uniform(0, 60, 2), 8 * n))
        meshes.append(cuboid(low, low + np.array((*rng.uniform(5, 40, 2), rng.uniform(1, 7)))))
    packing = packed(*meshes)
    found = stacking(packing)
    masses = rng.uniform(0, 10, len(meshes)).tolist()
    loads = found.loads(masses)
    shares = [1 / (len(below) + 1) if floor else 0 for below, floor in _rows(found)]
    reached = sum((loads[n] + masses[n]) * share for n, share in enumerate(shares))
    assert reached == pytest.approx(sum(masses))
    resting = lowered(packing)
    assert resting.problems() == []
    sweeps = PartSweeps(resting)
    for n, below in enumerate(found.supports):
        gaps = [sweeps.distance(m, n, "up") for m in below]
        assert all(gap <= 2.2e-3 for gap in gaps)
        assert found.on_floor[n] or below


def _rows(found):
    return zip(found.supports, found.on_floor, strict=True)
