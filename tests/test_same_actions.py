"""Agents play what they played when `references/actions.json` was written.

To write the file anew, after a change that is meant: `python -m tests.test_same_actions`.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from packit_sim.core import caches
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import Rules

RECORD = Path(__file__).parent / "references" / "actions.json"

CASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("largest-fitting-first/lowest/maximal-contact", {}),
    ("largest-fitting-first/lowest/maximal-contact", {"cells": (80, 100, 120)}),
    ("largest-fitting-first/lowest/maximal-contact", {"easy": True}),
    ("largest-fitting-first/lowest/maximal-contact+lns=8", {}),
    ("largest-fitting-first/lowest/blbf+mcts=4", {}),
    ("largest-fitting-first/aligned/blbf+beam=2", {"cells": (120, 120, 80)}),
    ("largest-fitting-first/lowest/heightmap-minimisation", {"kinematic": True}),
    ("smallest-first/first-fit/least-empty", {}),
    ("largest-box-first/aligned/least-empty", {"easy": True, "cells": (80, 80, 80)}),
    ("longest-first/lowest/dblf", {}),
    ("largest-first/random/heightmap-minimisation", {}),
    ("random/random/random", {}),
)
"""Agents, and how the rules differ from those of the paper."""

TASKS = 2


@pytest.fixture(scope="module", name="tasks")
def _tasks() -> list[Task]:
    return starter_tasks()


def starter_tasks() -> list[Task]:
    return load_tasks("starter", ShapeLibrary.open("everyday"))[:TASKS]


def play(name: str, changes: dict[str, Any], task: Task) -> str:
    """Play a task; return a digest of what was placed, in which order, where."""
    episode = Episode(task, Rules().changed(**changes))
    Agent.from_name(name).play(episode, np.random.default_rng(0))
    placed = [(p.item.shape.id, p.item.rotation, *p.location) for p in episode.box.placed]
    return hashlib.sha256(repr((placed, episode.total)).encode()).hexdigest()[:16]


def key(name: str, changes: dict[str, Any]) -> str:
    return " ".join([name, *(f"{field}={value}" for field, value in changes.items())])


SLOW = {"easy": True}, {"kinematic": True}


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        pytest.param(*case, id=key(*case), marks=[pytest.mark.slow] if case[1] in SLOW else [])
        for case in CASES
    ],
)
def test_agents_play_as_recorded(tasks: list[Task], name: str, changes: dict[str, Any]) -> None:
    caches.clear("no-fit tables", "pairs that met", "collisions")
    recorded = json.loads(RECORD.read_text())[key(name, changes)]
    assert [play(name, changes, task) for task in tasks] == recorded


@pytest.mark.slow
def test_what_caches_hold_changes_no_action(tasks: list[Task]) -> None:
    name, changes = CASES[0]
    (recorded,) = json.loads(RECORD.read_text())[key(name, changes)][:1]
    caches.clear()
    assert {play(name, changes, tasks[0]) for _ in range(36)} == {
        recorded
    }  # then pairs have tables


if __name__ == "__main__":
    found = {key(*case): [play(*case, task) for task in starter_tasks()] for case in CASES}
    RECORD.write_text(json.dumps(found, indent=1) + "\n")
