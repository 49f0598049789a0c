"""Exact cover: cuboids and polycubes fill a box, or are proved not to; the engine agrees."""

import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from trimesh import creation

from packit_agents.planning.exact_cover import ExactCover, Outcome, exact_cover
from packit_sim.core.errors import ArgumentError
from packit_sim.core.extras import MissingPackageError
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.evaluation import play
from packit_sim.game.generation import polycube_cuts
from packit_sim.game.generation.puzzles import cut_puzzle
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.rules import End, Rules

RULE = Agent.from_name("largest-first/aligned/blbf")


def searching(seconds: float = 20) -> Agent:
    return replace(RULE, name="exact", search=ExactCover(seconds))


def puzzle(kind: str, pieces: int, seed: int = 0) -> Task:
    """The pieces of a puzzle, without where they were."""
    box = cut_puzzle(kind, pieces, seed)
    return Task.of([placed.item.turned(0) for placed in box.placed], box.cells)


def cuboid(*steps: int) -> Item:
    extents = 0.04 * np.array(steps)
    return Item.of_size(Shape.from_mesh(creation.box(extents), "x".join(map(str, steps))), extents)


def played(task: Task, rules: Rules, agent: Agent) -> Episode:
    return play(task, agent, np.random.default_rng(0), rules=rules)


@pytest.mark.parametrize(("kind", "pieces"), [("guillotine", 12), ("pinwheel", 16)])
def test_cuboids_that_a_rule_leaves_outside_fill_the_box(kind, pieces) -> None:
    task = puzzle(kind, pieces)
    assert played(task, Rules(), RULE).end is End.NO_LOCATION
    for rules in (Rules(), Rules(easy=True)):
        episode = played(task, rules, searching())
        assert episode.end is End.COMPLETE and episode.total == pytest.approx(1)


@pytest.mark.slow
@pytest.mark.parametrize("pieces", [5, 8])
def test_polycubes_fill_the_box(pieces) -> None:
    pytest.importorskip("pysat", reason="python-sat comes with the extra exact")
    episode = played(puzzle("polycubes", pieces), Rules(), searching(60))
    assert episode.end is End.COMPLETE


def cut(kind: str, pieces: int) -> tuple[list[Item], tuple[int, int, int]]:
    task = puzzle(kind, pieces)
    return list(task.items), task.pack.cells


L, BAR = ((0, 0, 0), (1, 0, 0), (0, 1, 0)), ((0, 0, 0), (1, 0, 0), (2, 0, 0))


def polycube(cubes: tuple[tuple[int, int, int], ...]) -> Item:
    """A polycube of 4 cells a cube, by its union of cells."""
    filled = np.zeros((5, 5, 5), dtype=bool)
    filled[tuple(np.array(cubes).T)] = True
    return polycube_cuts.piece_of(filled).item().item


@pytest.mark.slow
def test_polycubes_that_cannot_fill_the_box_are_proved_so() -> None:
    """Three bars fill a layer of 3 x 3 cubes; an L, and two bars, do not."""
    pytest.importorskip("pysat", reason="python-sat comes with the extra exact")
    layer = (60, 60, 20)
    for cubes, outcome in (((L, BAR, BAR), Outcome.IMPOSSIBLE), ((L, L, BAR), Outcome.FILLED)):
        found = exact_cover([polycube(each) for each in cubes], layer, 60)
        assert found.outcome is outcome, cubes


LONG_SEARCH = """
from packit_agents.planning import exact_cover
from packit_sim import cut_puzzle
box = cut_puzzle("polycubes", pieces=16)
print("searching", flush=True)
try:
    exact_cover.exact_cover([each.item.turned(0) for each in box.placed], box.cells, 600)
except KeyboardInterrupt:
    print("stopped")
"""


@pytest.mark.slow
def test_ctrl_c_ends_the_solver_at_once() -> None:
    pytest.importorskip("pysat", reason="python-sat comes with the extra exact")
    command = [sys.executable, "-c", LONG_SEARCH]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "searching\n"
        time.sleep(5)  # the solver runs
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=60)[0] == "stopped\n"


def test_cuboids_that_cannot_fill_the_box_are_proved_so() -> None:
    """Two squares of 2 x 2 have no place in a layer of 3 x 3."""
    items = [cuboid(2, 2, 1), cuboid(2, 2, 1), cuboid(1, 1, 1)]
    assert exact_cover(items, (12, 12, 4), 5).outcome is Outcome.IMPOSSIBLE
    episode = played(Task.of(items, (12, 12, 4)), Rules(), searching())
    assert episode.total == pytest.approx(5 / 9)  # the policies play, and skip the second square


def test_only_allowed_rotations_are_used() -> None:
    """A bar that lies fits; one that has to stand does not by rotations about z."""
    standing = [cuboid(4, 1, 1), cuboid(4, 1, 1)]
    assert exact_cover(standing, (4, 8, 16), 5).outcome is Outcome.FILLED
    yaw = Rules(rotations="yaw")
    assert exact_cover(standing, (4, 8, 16), 5, rules=yaw).outcome is Outcome.IMPOSSIBLE
    assert exact_cover(standing, (8, 16, 4), 5, rules=yaw).outcome is Outcome.FILLED


def test_too_little_time_says_nothing() -> None:
    assert exact_cover(*cut("pinwheel", 32), seconds=1e-9).outcome is Outcome.UNKNOWN


def test_what_is_no_exact_cover_is_named() -> None:
    ball = Item(Shape.from_mesh(creation.icosphere(), "ball"), 0.01)
    with pytest.raises(ArgumentError, match=r"shape 'ball' at scale 0\.01 is no union of cubes"):
        exact_cover([ball], (100, 100, 100), 1)
    with pytest.raises(ArgumentError, match="fill the box: they have 1 of 2 cubes"):
        exact_cover([cuboid(1, 1, 1)], (4, 4, 8), 1)
    with pytest.raises(ArgumentError, match="can't play by the rules PackIt, kinematic"):
        played(puzzle("guillotine", 5), Rules(kinematic=True), searching())
    for value in ("200", "x"):
        with pytest.raises(ArgumentError, match=f"not '{value}'"):
            ExactCover.parse(value)
    assert ExactCover.parse("60s") == ExactCover(60)


def test_without_the_solver_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pysat", None)
    with pytest.raises(MissingPackageError, match=r"need pysat, .*'packit-sim\[exact\]'"):
        exact_cover(*cut("polycubes", 5), seconds=1)
