"""Requirements of packings, and which parts are taken out to meet them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.dropping import Dropping, drop_violations
from packit_sim.parts.handling.packing_stages import stage_motions
from packit_sim.parts.handling.requirements import Requirements, packing_order, violations
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from tests.examples import examples
from tests.packed_parts import CAGE, bowl, cuboid, moved, packed, table

BALL = creation.icosphere(subdivisions=2, radius=12).apply_translation((50, 50, 50))


def test_the_cheaper_of_two_interlocked_parts_is_taken_out() -> None:
    packing = packed(BALL, CAGE, names=("ball", "cage"))
    found = violations(packing, Requirements(removable=True))
    assert [one.sentence for one in found] == [
        "'ball' can't be taken out: 'cage' is in the way",
        "'cage' can't be taken out: 'ball' is in the way",
    ]
    reduced = drop_violations(packing, Requirements(removable=True))
    cheaper = int(packing.types[0].volume > packing.types[1].volume)
    assert [(one.part, one.type) for one in reduced.dropped] == [(cheaper, cheaper)]
    assert "can't be taken out" in reduced.dropped[0].reason
    assert reduced.kept == (1 - cheaper,)
    assert violations(reduced.packing, Requirements(removable=True)) == []


def test_a_value_decides_which_of_them_stays() -> None:
    packing = packed(BALL, CAGE)
    types = tuple(
        replace(one, value=value) for one, value in zip(packing.types, (5, 1), strict=True)
    )
    reduced = drop_violations(replace(packing, types=types), Requirements(removable=True))
    assert reduced.kept == (0,)


def test_insertable_from_the_top_reports_the_order() -> None:
    bowls = [moved(bowl(), 50, 50, 8 * n) for n in (2, 0, 1)]
    packing = packed(*bowls)
    requirements = Requirements(insertable=True)
    assert violations(packing, requirements) == []
    assert packing_order(packing, requirements) == (1, 2, 0)
    assert drop_violations(packing, requirements).kept == (1, 2, 0)


def test_nothing_may_rest_on_parts_that_must_not_be_stacked_on() -> None:
    box, other = cuboid((20, 20, 0), (50, 50, 39)), cuboid((0, 90, 0), (5, 95, 5))
    packing = packed(box, moved(table(), 5, 5, 7), other, names=("box", "table", "cube"))
    found = violations(packing, Requirements(no_stack=frozenset({0})))
    assert [(one.part, one.others) for one in found] == [(0, (1,))]
    assert found[0].sentence == "'table' is on 'box', which may carry nothing"
    lower = packed(cuboid((20, 20, 0), (50, 50, 30)), moved(table(), 5, 5, 2), other)
    assert violations(lower, Requirements(no_stack=frozenset({0, 1, 2}))) == []


def test_load_limits_count_what_rests_on_others() -> None:
    tower = packed(*(cuboid((0, 0, 20 * n), (20, 20, 20 * n + 20)) for n in range(4)))
    requirements = Requirements(max_loads={0: 299.0}, masses=(100.0,) * 4)
    assert [one.sentence for one in violations(tower, requirements)] == [
        "'part0' carries 300 g: at most 299 g"
    ]
    assert violations(tower, replace(requirements, max_loads={0: 300.0})) == []
    reduced = drop_violations(tower, requirements)
    assert len(reduced.dropped) == 1
    assert violations(reduced.packing, requirements) == []


def test_fixed_parts_stay_and_are_in_the_way() -> None:
    packing = packed(BALL, CAGE)
    requirements = Requirements(removable=True, fixed=frozenset({1}))
    reduced = drop_violations(packing, requirements)
    assert reduced.kept == (1,)
    both = Requirements(no_stack=frozenset({0}), fixed=frozenset({0, 1}))
    stacked = packed(cuboid((0, 0, 0), (20, 20, 20)), cuboid((0, 0, 20), (20, 20, 40)))
    with pytest.raises(ArgumentError, match="fixed violate a requirement"):
        drop_violations(stacked, both)


def test_parts_return_that_violate_nothing_any_more() -> None:
    """The smaller block goes first; the larger one is too heavy alone, so the smaller returns."""
    base = cuboid((0, 0, 0), (60, 60, 20))
    blocks = [cuboid((0, 0, 20), (20, 20, 40)), cuboid((30, 30, 20), (60, 60, 50))]
    packing = packed(base, *blocks)
    requirements = Requirements(max_loads={0: 10.0}, masses=(1.0, 9.0, 11.0))
    reduced = drop_violations(packing, requirements)
    assert reduced.kept == (0, 1)
    assert [one.part for one in reduced.dropped] == [2]


def test_a_constraint_of_a_search_names_the_parts_to_take_out() -> None:
    constraint = Dropping(Requirements(removable=True), lambda packing: packing)
    packing = packed(BALL, CAGE)
    taken = constraint.taken_out(packing)
    assert len(taken) == 1
    left = tuple(p for n, p in enumerate(packing.placements) if n not in taken)
    assert constraint.taken_out(replace(packing, placements=left)) == {}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"stable": -1.0}, "stable -1.0 is not possible"),
        ({"stable": 1.0}, "need masses"),
        ({"max_loads": {0: 1.0}}, "need masses"),
        ({"max_loads": {0: math.nan}, "masses": (1.0,)}, "max_load nan"),
        ({"masses": (math.inf,)}, "mass inf"),
        ({"metres": 0.0}, "metres 0.0"),
    ],
)
def test_bad_requirements_are_one_clear_error(settings, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        Requirements(**settings)


@pytest.mark.parametrize(
    ("requirements", "message"),
    [
        (Requirements(no_stack=frozenset({2})), "no_stack has the number 2: it must be below 2"),
        (Requirements(fixed=frozenset({-1})), "fixed has the number -1"),
        (Requirements(masses=(1.0,)), "1 masses for 2 types"),
    ],
)
def test_requirements_of_other_packings_are_one_clear_error(requirements, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        violations(packed(BALL, CAGE), requirements)


def _tower_and_ledge() -> Packing:
    """A tower of two cubes, and a plank of which more than half hangs over its edge."""
    return packed(
        cuboid((0, 0, 0), (20, 20, 20)),
        cuboid((0, 0, 20), (20, 20, 40)),
        cuboid((5, 5, 40), (60, 15, 44)),
    )


def test_what_hangs_over_an_edge_falls_and_is_taken_out() -> None:
    packing = _tower_and_ledge()
    motions = stage_motions(packing, (0, 1, 2), (0.01, 0.01, 0.01))
    assert [one.part for one in motions] == [0, 1, 2]
    assert motions[2].distance > 10 and motions[2].stage == 3
    requirements = Requirements(stable=2.0, masses=(10.0, 10.0, 10.0))
    found = violations(packing, requirements)
    assert [(one.rule, one.part) for one in found] == [("stable", 2)]
    reduced = drop_violations(packing, requirements)
    assert reduced.kept == (0, 1)
    assert violations(reduced.packing, requirements) == []


def test_a_floating_part_starts_where_it_rests() -> None:
    packing = packed(cuboid((0, 0, 30), (20, 20, 50)))
    (motion,) = stage_motions(packing, (0,), (0.1,))
    assert motion.distance < 0.5


def test_boxes_are_simulated_apart() -> None:
    packing = packed(cuboid((0, 0, 0), (20, 20, 20)), cuboid((0, 0, 0), (20, 20, 20)))
    both = replace(
        packing, objective="bins", placements=(Placement(0, np.eye(4)), Placement(1, np.eye(4), 1))
    )
    motions = stage_motions(both, (1, 0), (0.1, 0.1))
    assert [(one.part, one.distance < 0.5) for one in motions] == [(0, True), (1, True)]


@given(st.integers(0, 2**32 - 1))
@examples(12)
def test_what_remains_meets_all_requirements_and_only_parts_are_missing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    meshes = []
    for n in range(10):
        low = np.array((*rng.uniform(0, 60, 2), 9 * n))
        meshes.append(cuboid(low, low + np.array((*rng.uniform(5, 40, 2), rng.uniform(1, 8)))))
    packing = packed(*meshes)
    requirements = Requirements(
        insertable=True,
        no_stack=frozenset(rng.choice(10, 3, replace=False).tolist()),
        max_loads={int(n): float(rng.uniform(0, 30)) for n in rng.choice(10, 4, replace=False)},
        masses=tuple(rng.uniform(1, 10, 10).tolist()),
    )
    reduced = drop_violations(packing, requirements)
    assert violations(reduced.packing, requirements) == []
    dropped = [one.part for one in reduced.dropped]
    assert sorted([*reduced.kept, *dropped]) == list(range(10))
    for new, old in zip(reduced.packing.placements, reduced.kept, strict=True):
        assert new is packing.placements[old]
    for part in dropped:  # none can return
        more = [packing.placements[n] for n in (*reduced.kept, part)]
        assert violations(replace(packing, placements=tuple(more)), requirements)
