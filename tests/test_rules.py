"""The rules of the game as a value: their description, file format and box."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from packit_sim.box import Box
from packit_sim.core.errors import ArgumentError
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling_box import SettlingBox
from packit_sim.rules import PACKIT, Rules

WORLD = PhysicsSettings(friction=0.7, decomposition=DecompositionSettings(method="bisection"))

CASES = {
    "PackIt": PACKIT,
    "PackIt-Easy, kinematic": Rules(easy=True, kinematic=True),
    "PackIt, physics, box of 80 x 80 x 60 cells": Rules(PACKIT.easy).changed(
        physics=True, cells=(80, 80, 60)
    ),
    "PackIt, kinematic, online with a buffer of 5, yaw rotations": Rules(
        kinematic=True, buffer=5, rotations="yaw"
    ),
}


@pytest.mark.parametrize("text", CASES)
def test_rules_have_a_name_for_messages_and_tables(text) -> None:
    assert str(CASES[text]) == text


def test_rules_with_another_world_have_another_name() -> None:
    assert str(Rules(physics=WORLD)) == (
        "PackIt, physics friction=0.7 decomposition.method='bisection'"
    )


@pytest.mark.parametrize("rules", [*CASES.values(), Rules(True, physics=WORLD)], ids=str)
def test_rules_are_the_same_after_a_way_through_json(rules) -> None:
    assert Rules.from_json(json.loads(json.dumps(asdict(rules)))) == rules


def test_fields_that_are_missing_in_json_keep_their_defaults() -> None:
    assert Rules.from_json({}) == PACKIT
    assert Rules.from_json({"physics": True}) == Rules(physics=PhysicsSettings())
    assert Rules.from_json({"physics": {"friction": 0.7}}).physics == PhysicsSettings(friction=0.7)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"eazy": True},
            "no setting 'eazy': choose from easy, kinematic, physics, cells, buffer, r",
        ),
        ({"buffer": -1}, "a buffer of -1 items is not possible: choose 1 or more, or None"),
        ({"rotations": "roll"}, "field 'rotations' is 'roll'"),
        ({"easy": 1}, "field 'easy' is 1: expected bool, got int"),
        ({"cells": [1, 2, 3]}, "a box of 1 x 2 x 3 cells is not possible"),
        ({"physics": {"friction": -1.0}}, "friction -1.0 is not possible"),
        (
            {"physics": {"frictoin": 0.7}},
            "no setting 'physics.frictoin': choose from side, density",
        ),
        (
            {"physics": {"decomposition": {"overhang": 0.02}}},
            "no setting 'physics.decomposition.overhang': choose from method, threshold",
        ),
        ({"kinematic": True, "physics": True}, "either kinematic or has physics, not both"),
    ],
)
def test_rules_that_are_not_possible_are_refused(values, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        Rules.from_json(values)


def test_rules_make_the_box_that_they_ask_for() -> None:
    box = Rules(kinematic=True).new_box((40, 40, 80))
    assert isinstance(box, Box) and box.kinematic and box.cells == (40, 40, 80)
    box = Rules(physics=WORLD, cells=(80, 80, 60)).new_box((40, 40, 80))
    assert isinstance(box, SettlingBox) and box.settings == WORLD and box.cells == (80, 80, 60)
