"""Constraints beyond validity, and the parts that are left out to meet them."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.candidates import in_order
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.handling.broken import broken_constraints
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.filtering import filter_packing
from packit_sim.parts.handling.order import packing_order
from packit_sim.parts.handling.stability import stage_motions
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from tests.examples import examples
from tests.packed_parts import BAR, CAGE, bowl, cuboid, moved, packed, table

BALL = creation.icosphere(subdivisions=2, radius=12).apply_translation((50, 50, 50))


def test_the_cheaper_of_two_interlocked_parts_is_left_out() -> None:
    packing = packed(BALL, CAGE, names=("ball", "cage"))
    found = broken_constraints(packing, Constraints(removable=True))
    assert [one.sentence for one in found] == [
        "'ball' can't be taken out: 'cage' is in the way",
        "'cage' can't be taken out: 'ball' is in the way",
    ]
    filtered = filter_packing(packing, Constraints(removable=True))
    cheaper = int(packing.types[0].volume > packing.types[1].volume)
    assert [(one.part, one.type) for one in filtered.left_out] == [(cheaper, cheaper)]
    assert "can't be taken out" in filtered.left_out[0].reason
    assert filtered.kept == (1 - cheaper,)
    assert broken_constraints(filtered.packing, Constraints(removable=True)) == []


def test_a_value_decides_which_of_them_stays() -> None:
    packing = packed(BALL, CAGE)
    types = tuple(
        replace(one, value=value) for one, value in zip(packing.types, (5, 1), strict=True)
    )
    filtered = filter_packing(replace(packing, types=types), Constraints(removable=True))
    assert filtered.kept == (0,)


def test_insertable_from_the_top_reports_the_order() -> None:
    bowls = [moved(bowl(), 50, 50, 8 * n) for n in (2, 0, 1)]
    packing = packed(*bowls)
    constraints = Constraints(insertable=True)
    assert broken_constraints(packing, constraints) == []
    assert packing_order(packing, constraints) == (1, 2, 0)
    assert filter_packing(packing, constraints).kept == (1, 2, 0)


def test_nothing_may_rest_on_parts_that_must_not_be_stacked_on() -> None:
    box, other = cuboid((20, 20, 0), (50, 50, 39)), cuboid((0, 90, 0), (5, 95, 5))
    packing = packed(box, moved(table(), 5, 5, 7), other, names=("box", "table", "cube"))
    found = broken_constraints(packing, Constraints(no_stack=frozenset({0})))
    assert [(one.part, one.others) for one in found] == [(0, (1,))]
    assert found[0].sentence == "'table' is on 'box', which may carry nothing"
    lower = packed(cuboid((20, 20, 0), (50, 50, 30)), moved(table(), 5, 5, 2), other)
    assert broken_constraints(lower, Constraints(no_stack=frozenset({0, 1, 2}))) == []


def test_load_limits_count_what_rests_on_others() -> None:
    tower = packed(*(cuboid((0, 0, 20 * n), (20, 20, 20 * n + 20)) for n in range(4)))
    constraints = Constraints(max_loads={0: 299.0}, masses=(100.0,) * 4)
    assert [one.sentence for one in broken_constraints(tower, constraints)] == [
        "'part0' carries 300 g: at most 299 g"
    ]
    assert broken_constraints(tower, replace(constraints, max_loads={0: 300.0})) == []
    filtered = filter_packing(tower, constraints)
    assert len(filtered.left_out) == 1
    assert broken_constraints(filtered.packing, constraints) == []


def test_fixed_parts_stay_and_are_in_the_way() -> None:
    packing = packed(BALL, CAGE)
    constraints = Constraints(removable=True, fixed=frozenset({1}))
    filtered = filter_packing(packing, constraints)
    assert filtered.kept == (1,)
    both = Constraints(no_stack=frozenset({0}), fixed=frozenset({0, 1}))
    stacked = packed(cuboid((0, 0, 0), (20, 20, 20)), cuboid((0, 0, 20), (20, 20, 40)))
    with pytest.raises(ArgumentError, match="fixed break a constraint"):
        filter_packing(stacked, both)


def test_parts_return_that_break_nothing_any_more() -> None:
    """The smaller block goes first; the larger one is too heavy alone, so the smaller returns."""
    base = cuboid((0, 0, 0), (60, 60, 20))
    blocks = [cuboid((0, 0, 20), (20, 20, 40)), cuboid((30, 30, 20), (60, 60, 50))]
    packing = packed(base, *blocks)
    constraints = Constraints(max_loads={0: 10.0}, masses=(1.0, 9.0, 11.0))
    filtered = filter_packing(packing, constraints)
    assert filtered.kept == (0, 1)
    assert [one.part for one in filtered.left_out] == [2]


def test_what_remains_is_not_filtered_again() -> None:
    packing = packed(BALL, CAGE)
    filtered = filter_packing(packing, Constraints(removable=True))
    assert len(filtered.left_out) == 1
    again = filter_packing(filtered.packing, Constraints(removable=True))
    assert again.left_out == () and again.packing.placements == filtered.packing.placements


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"stable": -1.0}, "stable -1.0 is not possible"),
        ({"stable": 1.0}, "need masses"),
        ({"max_loads": {0: 1.0}}, "need masses"),
        ({"max_loads": {0: math.nan}, "masses": (1.0,)}, "max_load nan"),
        ({"masses": (math.inf,)}, "mass inf"),
        ({"unit": "yard"}, "unit 'yard' is not known: choose from micron, mm"),
    ],
)
def test_bad_constraints_are_one_clear_error(settings, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        Constraints(**settings)


def test_a_unit_of_no_length_is_refused_before_anything_is_simulated() -> None:
    with pytest.raises(ArgumentError, match=r"metres 0.0 is not possible"):
        stage_motions(packed(cuboid((0, 0, 0), (9, 9, 9))), (0,), (1.0,), metres=0.0)


@pytest.mark.parametrize(
    ("constraints", "message"),
    [
        (Constraints(no_stack=frozenset({2})), "no_stack has the number 2: it must be below 2"),
        (Constraints(fixed=frozenset({-1})), "fixed has the number -1"),
        (Constraints(masses=(1.0,)), "1 masses for 2 types"),
    ],
)
def test_constraints_of_other_packings_are_one_clear_error(constraints, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        broken_constraints(packed(BALL, CAGE), constraints)


def _tower_and_ledge() -> Packing:
    """A tower of two cubes, and a plank of which more than half hangs over its edge."""
    return packed(
        cuboid((0, 0, 0), (20, 20, 20)),
        cuboid((0, 0, 20), (20, 20, 40)),
        cuboid((5, 5, 40), (60, 15, 44)),
    )


def test_what_hangs_over_an_edge_falls_and_is_left_out() -> None:
    packing = _tower_and_ledge()
    motions = stage_motions(packing, (0, 1, 2), (0.01, 0.01, 0.01))
    assert [one.part for one in motions] == [0, 1, 2]
    assert motions[2].distance > 10 and motions[2].stage == 3
    constraints = Constraints(stable=2.0, masses=(10.0, 10.0, 10.0))
    found = broken_constraints(packing, constraints)
    assert [(one.constraint, one.part) for one in found] == [("stable", 2)]
    assert re.search(r" moves by [\d.]+ mm: at most 2 mm$", found[0].sentence)
    filtered = filter_packing(packing, constraints)
    assert filtered.kept == (0, 1)
    assert broken_constraints(filtered.packing, constraints) == []


def test_a_floating_part_starts_where_it_rests() -> None:
    packing = packed(cuboid((0, 0, 30), (20, 20, 50)))
    (motion,) = stage_motions(packing, (0,), (0.1,))
    assert motion.distance < 0.5


def test_boxes_are_simulated_apart() -> None:
    packing = packed(cuboid((0, 0, 0), (20, 20, 20)), cuboid((0, 0, 0), (20, 20, 20)))
    both = replace(packing, objective="bins", placements=(Placement(0), Placement(1, box=1)))
    motions = stage_motions(both, (1, 0), (0.1, 0.1))
    assert [(one.part, one.distance < 0.5) for one in motions] == [(0, True), (1, True)]


@given(st.integers(0, 2**32 - 1))
@examples(12)
def test_what_remains_meets_all_constraints_and_only_parts_are_missing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    meshes = []
    for n in range(10):
        low = np.array((*rng.uniform(0, 60, 2), 9 * n))
        meshes.append(cuboid(low, low + np.array((*rng.uniform(5, 40, 2), rng.uniform(1, 8)))))
    packing = packed(*meshes)
    constraints = Constraints(
        insertable=True,
        no_stack=frozenset(rng.choice(10, 3, replace=False).tolist()),
        max_loads={int(n): float(rng.uniform(0, 30)) for n in rng.choice(10, 4, replace=False)},
        masses=tuple(rng.uniform(1, 10, 10).tolist()),
    )
    filtered = filter_packing(packing, constraints)
    assert broken_constraints(filtered.packing, constraints) == []
    left_out = [one.part for one in filtered.left_out]
    assert sorted([*filtered.kept, *left_out]) == list(range(10))
    for new, old in zip(filtered.packing.placements, filtered.kept, strict=True):
        assert new is packing.placements[old]
    for part in left_out:  # none can return
        more = [packing.placements[n] for n in (*filtered.kept, part)]
        assert broken_constraints(replace(packing, placements=tuple(more)), constraints)


@pytest.mark.parametrize(("mass", "is_said"), [(None, True), (20.0, False)])
def test_a_stability_without_masses_is_said(mass: float | None, is_said: bool) -> None:
    parts = [Part("a", creation.box((10, 10, 10)), mass=1.0), Part("b", BAR, mass=mass)]
    task = prepared_task(parts, (100, 100, 100), "volume", PackSettings(stable=3.0))
    assert any("count as 1 g/cm3 for the stability" in note for note in task.notes) == is_said


def test_parts_are_not_lowered_onto_what_may_carry_nothing() -> None:
    parts = [
        Part("fragile", creation.box((20, 20, 10)), no_stack=True),
        Part("cube", creation.box((10, 10, 10))),
    ]
    settings = PackSettings(workers=1, iterations=5, stable=3.0)
    result = pack(parts, (60, 30, 60), settings=settings)
    (packing,) = result.packings
    fragile, cube = sorted(packing.placements, key=lambda one: one.type)
    corner, own = (packing.vertices(one).min(axis=0) for one in (fragile, cube))
    raised = replace(cube, pose=cube.pose.shifted(corner - own + np.array((5, 5, 30))))
    floating = replace(packing, placements=(fragile, raised))
    (found,) = in_order(replace(result, packings=(floating,))).packings
    heights = [found.vertices(one)[:, 2].min() for one in found.placements]
    assert sorted(heights) == [pytest.approx(0, abs=0.01), pytest.approx(30, abs=0.01)]
