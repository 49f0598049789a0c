"""Evening: parts move until the packed area varies less over the height."""

from dataclasses import replace

import pytest
from trimesh import creation

from packit_sim import Limits, PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts import check
from packit_sim.parts.filling.balance import off_middle
from packit_sim.parts.packings.layers import layers

QUICK = PackSettings(workers=1, iterations=5, clearance=1.0, wall_clearance=1.0)


def parts() -> list[Part]:
    return [
        Part("rod", creation.box((8, 8, 60)), rotations="fixed"),
        Part("cube", creation.box((15, 15, 15)), 5, rotations="fixed"),
    ]


def test_layers_become_more_even() -> None:
    plain = pack(parts(), (60, 60, 70), settings=QUICK)
    even = pack(parts(), (60, 60, 70), settings=replace(QUICK, even=True))
    assert even.counts == plain.counts
    assert even.height <= plain.height * (1 + 1e-9)
    assert not check(even).problems
    before, after = (layers(each.packings[0]).variation for each in (plain, even))
    assert after < 0.7 * before
    note = f"box 1 is evened: the area of its layers varies by {after:.3f} of the mean, before by"
    assert note in even.notes[-1]


def test_a_balance_is_kept() -> None:
    settings = replace(QUICK, even=True, limits=Limits(balance=0.02))
    packed = pack(parts(), (60, 60, 70), settings=settings)
    assert packed.count == 6
    assert abs(off_middle(packed.task, packed.packings[0])).max() <= 0.02


def test_constraints_are_not_possible_with_it() -> None:
    with pytest.raises(ArgumentError, match="even is not possible with constraints"):
        pack(parts(), (60, 60, 70), settings=replace(QUICK, even=True, removable=True))
