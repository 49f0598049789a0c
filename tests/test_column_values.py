"""Values of column heights: the online game of polycubes, learned by playing."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from trimesh import creation

from packit_agents.learning.run_folder import TrainingError
from packit_agents.learning.tensor_files import TensorFileError, write_tensors
from packit_agents.online.column_kernels import plan, play
from packit_agents.online.columns import FORM_START, ColumnGame, cubes
from packit_agents.online.policies import ColumnPolicy, ColumnPolicyAhead
from packit_agents.online.value_tables import FORMAT, Patterns, ValueTables
from packit_agents.online.value_training import ValueTraining, ValueTrainingSettings
from packit_sim.core.errors import ArgumentError, StateError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.generation.sequences import SequenceSampler
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import End, Rules
from scripts.build_blockout import CELL_CM, SHAPES
from tests.runs import packit

ONLINE = Rules(kinematic=True, buffer=3, rotations="yaw")
CELLS = (20, 20, 20)


@cache
def sampler() -> SequenceSampler:
    return SequenceSampler(ShapeLibrary.open("blockout"), CELLS, CELL_CM)


@cache
def game() -> ColumnGame:
    items = [sampler().item(id) for id in sampler().library]
    return ColumnGame.of(CELLS, items, "yaw")


def task(seed: int) -> Task:
    return sampler().pack(seed).task(sampler().library)


@cache
def tables(seed: int = 0) -> ValueTables:
    """Random tables, for buffers of one and four."""
    rng = np.random.default_rng(seed)
    size = Patterns.of(game().sides).entries
    entries = {buffer: rng.random(size).astype(np.float32) for buffer in (1, 4)}
    return ValueTables(game(), entries)


def value(heights: np.ndarray, buffer: int = 4) -> float:
    """The sum of the tables' entries, from their definition alone."""
    columns, _, starts, entries = tables().arrays(buffer)
    total = 0.0
    for own, start in zip(columns.tolist(), starts.tolist(), strict=True):
        number = 0
        for column in own:
            number = number * 6 + int(heights[column]) if column >= 0 else number
        total += entries[start + number]
    return total


def lowest(form: np.ndarray, heights: np.ndarray, x: int, y: int) -> int:
    """Height at which a form comes to rest, by its columns."""
    columns = form[FORM_START : FORM_START + 4 * form[4]].reshape(-1, 4)
    return max(0, *(int(heights[(x + i) * 5 + y + j] - low) for i, j, low, _ in columns.tolist()))


def after(form: np.ndarray, heights: np.ndarray, x: int, y: int) -> np.ndarray | None:
    base = lowest(form, heights, x, y)
    if base + form[3] > 5:
        return None
    found = heights.copy()
    columns = form[FORM_START : FORM_START + 4 * form[4]].reshape(-1, 4)
    for i, j, _, top in columns.tolist():
        found[(x + i) * 5 + y + j] = base + top
    return found


def placements(shape: int, heights: np.ndarray) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """All placements of a shape, with the heights after them."""
    found = []
    for form in range(game().firsts[shape], game().firsts[shape + 1]):
        row = game().forms[form]
        for x, y in itertools.product(range(6 - row[1]), range(6 - row[2])):
            then = after(row, heights, x, y)
            if then is not None:
                found.append(((shape, form, x, y), then))
    return found


def played_at_random(seed: int) -> Episode:
    """An episode after some random placements."""
    rng, episode = np.random.default_rng(seed), Episode(task(seed), ONLINE)
    for _ in range(3 * int(rng.integers(2, 14))):
        if episode.end is None:
            episode.step(rng.choice(np.flatnonzero(episode.action_mask())))
    return episode


def test_shapes_are_those_of_the_library() -> None:
    for id in SHAPES:
        assert cubes(sampler().item(id)) == tuple(sorted(SHAPES[id]))
    assert len(game().shapes) == 8 and len(game().forms) == 25 and game().most_shapes == 31


@pytest.mark.parametrize("number", range(4))
def test_a_shape_fits_from_where_its_columns_come_to_rest(number: int) -> None:
    episode = played_at_random(number)
    heights = game().heights(episode.box.placed)
    for n in np.flatnonzero(episode.visible).tolist():
        item = episode.task.items[n]
        shape = game().shape(item)
        for form in game().forms[game().firsts[shape] : game().firsts[shape + 1]]:
            mask = episode.box.feasible(item.turned(int(form[0])))
            for x, y in itertools.product(range(6 - form[1]), range(6 - form[2])):
                fits = np.flatnonzero(mask[x, y])
                if after(form, heights, x, y) is None:
                    assert not len(fits)
                else:
                    assert fits[0] == lowest(form, heights, x, y)


def test_turned_heights_have_the_same_value() -> None:
    heights = np.random.default_rng(1).integers(6, size=(5, 5))
    turned = [value(np.rot90(heights, n).ravel()) for n in range(4)]
    assert turned == pytest.approx([turned[0]] * 4)
    assert value(heights.T.ravel()) != pytest.approx(turned[0])


def looked(heights: np.ndarray, counts: np.ndarray, plies: int, width: int = 600):
    nothing = np.empty(0, dtype=np.int64)
    arrays = game().arrays, tables().arrays(4)
    found, best = plan(heights, counts, nothing, *arrays, 1, width, plies)
    return tuple(found.tolist()), best


def best_of(heights: np.ndarray, counts: np.ndarray) -> float:
    return max(
        (1 + value(then) for s in np.flatnonzero(counts) for _, then in placements(s, heights)),
        default=0.0,
    )


def expected(heights: np.ndarray, counts: np.ndarray) -> float:
    """The mean over what arrives of the best placement, from the definition alone."""
    return np.mean([best_of(heights, counts + own) for own in np.eye(8, dtype=int)])


@pytest.mark.parametrize("plies", [0, 1])
def test_the_best_placement_is_found(plies: int) -> None:
    heights = np.random.default_rng(2).integers(2, 5, size=25)
    counts = np.array((0, 1, 0, 0, 1, 0, 0, 0))
    all_values = {}
    for shape in (1, 4):
        left = counts - np.eye(8, dtype=int)[shape]
        for move, then in placements(shape, heights):
            later = value(then) if plies == 0 else expected(then, left)
            all_values[move] = 1 + later
    found, best = looked(heights, counts, plies)
    assert best == pytest.approx(max(all_values.values()))
    assert all_values[found] == pytest.approx(best)


def test_a_placement_is_found_where_all_values_are_negative() -> None:
    heights, counts = np.full(25, 3), np.eye(8, dtype=int)[1]
    patterns = tables().patterns
    bad = patterns.arrays(np.full(patterns.entries, -1.0))
    found, _ = plan(heights, counts, np.empty(0, dtype=np.int64), game().arrays, bad, 1, 1, 0)
    assert found[0] == 1


def test_two_arrivals_ahead_the_best_few_are_compared() -> None:
    heights = np.full(25, 4)
    heights[[0, 1, 2, 5, 6, 7, 10, 11, 12]] = 2, 3, 2, 3, 2, 3, 2, 2, 3
    counts = np.array((0, 0, 0, 1, 0, 0, 0, 0))
    first = placements(3, heights)
    first.sort(key=lambda one: -expected(one[1], 0 * counts))
    best = {}
    for move, then in first[:5]:
        total = 0.0
        for arrival in range(8):
            moves = placements(arrival, then)
            moves.sort(key=lambda one: -value(one[1]))
            total += max((1 + expected(one, 0 * counts) for _, one in moves[:5]), default=0.0)
        best[move] = 1 + total / 8
    found, value_found = looked(heights, counts, 2)
    assert value_found == pytest.approx(max(best.values()))
    assert best[found] == pytest.approx(value_found)


def test_known_arrivals_are_packed_to_the_end() -> None:
    heights, counts = np.zeros(25, dtype=np.int64), np.zeros(8, dtype=np.int64)
    square = game().shapes.index(tuple(sorted(SHAPES["o"])))
    counts[square] = 1
    arrays = game().arrays, tables().arrays(4)
    _, best = plan(heights, counts, np.full(40, square), *arrays, 60, 50, 0)
    assert best == 20  # four squares in each of five layers
    found, best = plan(np.full(25, 5), counts, np.empty(0, np.int64), *arrays, 5, 3, 1)
    assert found[0] == -1 and best == 0


@pytest.mark.parametrize("policy", [ColumnPolicy, ColumnPolicyAhead])
def test_the_agent_plays_until_no_visible_shape_fits(policy, tmp_path) -> None:
    file = tmp_path / "tables.safetensors"
    tables().write(file)
    agent = Agent.from_name(f"columns{'-ahead' if policy is ColumnPolicyAhead else ''}@{file}")
    assert policy(file).weights_digest == tables().digest
    for seed, rules in (
        (0, ONLINE),
        (1, replace(ONLINE, buffer=1)),
        (2, replace(ONLINE, easy=True)),
    ):
        episode = Episode(task(seed), rules)
        agent.play(episode, np.random.default_rng(0))
        assert episode.end is End.NO_LOCATION
        counts = np.zeros(8, dtype=int)
        for n in np.flatnonzero(episode.visible):
            counts[game().shape(episode.task.items[n])] += 1
        heights = game().heights(episode.box.placed)
        assert best_of(heights, counts) == 0 < len(episode.box.placed)


def test_what_the_values_are_not_for_is_refused(tmp_path) -> None:
    file = tmp_path / "tables.safetensors"
    tables().write(file)
    policy, rng = ColumnPolicy(file), np.random.default_rng(0)
    with pytest.raises(ArgumentError, match=r"for the rules PackIt, kinematic, online .* not for"):
        policy(Episode(task(0), replace(ONLINE, rotations="all")), rng)
    with pytest.raises(ArgumentError, match="a box of 20 x 20 x 20 cells, not of 24 x 20 x 20"):
        policy(Episode(task(0), replace(ONLINE, cells=(24, 20, 20))), rng)
    with pytest.raises(ArgumentError, match="need polycubes whose cubes are a grid step wide"):
        policy(Episode(load_tasks("starter")[0], replace(ONLINE, cells=CELLS)), rng)
    bar = Item(Shape.from_mesh(creation.box((0.0398, 0.0398, 0.0798)), "bar"), 0.0976**3)
    with pytest.raises(ArgumentError, match="'bar' is none of the 8"):
        policy(Episode(replace(task(0), items=(bar,)), ONLINE), rng)
    episode = Episode(task(0), ONLINE)
    episode.step(next(n for n in np.flatnonzero(episode.visible) if n != policy(episode, rng)))
    with pytest.raises(StateError, match="name the agent alone"):
        policy(episode, rng)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"sides": (5, 5, 50)}, "2 to 12 cubes along each side"),
        ({"shapes": []}, "0 shapes are not possible"),
        ({"shapes": [((0, 0, 0), (0, 0, 0))]}, "not the cubes of a polycube"),
        ({"shapes": [((1, 0, 0),)]}, "not the cubes of a polycube"),
        ({"sides": (5, 5, 6)}, "have .* entries"),
        ({"rotations": "pitch"}, "rotations"),
        ({"sides": None}, "sides"),
    ],
)
def test_tables_of_other_games_are_refused(changed, message, tmp_path) -> None:
    file = tmp_path / "tables.safetensors"
    made = {"sides": (5, 5, 5), "shapes": game().shapes, "rotations": "yaw", **changed}
    tensors = {f"buffer {n}": own for n, own in tables().buffers.items()}
    write_tensors(file, FORMAT, tensors, game=made, provenance={})
    with pytest.raises(TensorFileError, match=message):
        ValueTables.read(file)


@pytest.mark.parametrize("name", ["buffer 0", "buffer x", "other", "buffer 01"])
def test_tables_with_other_names_are_refused(name, tmp_path) -> None:
    file = tmp_path / "tables.safetensors"
    made = {"sides": (5, 5, 5), "shapes": game().shapes, "rotations": "yaw"}
    write_tensors(file, FORMAT, {name: tables().buffers[1]}, game=made, provenance={})
    with pytest.raises(TensorFileError, match=f"holds '{name}'"):
        ValueTables.read(file)
    write_tensors(file, FORMAT, {}, game=made, provenance={})
    with pytest.raises(TensorFileError, match="holds no tables"):
        ValueTables.read(file)


def test_a_buffer_has_the_tables_of_the_next_smaller_one() -> None:
    for buffer, known in ((1, 1), (3, 1), (4, 4), (9, 4)):
        assert (tables().arrays(buffer)[3] == tables().buffers[known]).all()


SMALL = ValueTrainingSettings(buffers=(1, 2), games=300, rounds=3, validation_games=100)


def test_training_learns_and_resumes_to_the_same_tables(tmp_path) -> None:
    seen = []
    whole = ValueTraining(SMALL, tmp_path / "whole").run(Workers(1), seen.append)
    assert [one.rounds for one in seen] == [1, 2, 3]
    assert all(own.mean > 17 for own in seen[-1].placed.values())  # 14.5 and 15.4 untrained

    class Stop(Exception):
        pass

    def stop(result) -> None:
        raise Stop

    with pytest.raises(Stop):
        ValueTraining(SMALL, tmp_path / "stopped").run(Workers(1), stop)
    resumed = ValueTraining(SMALL, tmp_path / "stopped").run(Workers(1))
    assert resumed.digest == whole.digest
    curves = [(tmp_path / name / "curve.json").read_text() for name in ("whole", "stopped")]
    assert curves[0] == curves[1]
    with pytest.raises(TrainingError, match=r"another settings\.seed"):
        ValueTraining(replace(SMALL, seed=1), tmp_path / "whole")
    (tmp_path / "whole" / "last.npz").write_bytes(b"what")
    with pytest.raises(TrainingError, match=r"last\.npz is damaged"):
        ValueTraining(SMALL, tmp_path / "whole").run(Workers(1))


def test_games_depend_on_arrivals_alone() -> None:
    arrivals = np.random.default_rng(3).integers(8, size=(20, 40))
    nothing = np.empty(0)
    fixed = tables().arrays(1)
    found = [play(arrivals, 1, game().arrays, fixed, (nothing, nothing)) for _ in range(2)]
    assert (found[0] == found[1]).all() and found[0].min() > 5


@pytest.mark.parametrize(
    "changed", [{"buffers": ()}, {"buffers": (0,)}, {"buffers": (2, 2)}, {"games": 0}]
)
def test_settings_that_are_not_possible_are_refused(changed) -> None:
    with pytest.raises(ArgumentError, match=next(iter(changed))):
        replace(SMALL, **changed)


def test_the_command_trains_and_its_tables_play(tmp_path) -> None:
    folder = tmp_path / "columns"
    options = ("--buffer", "2", "--rounds", "1", "--games", "50", "--workers", "1")
    assert "wrote" in packit("train-columns", "--out", str(folder), *options)
    data = str(tmp_path / "sequences")
    packit("datasets", "sequences", "--sequences", "1", "--out", data)
    rules = ("--kinematic", "--buffer", "2", "--rotations", "yaw", "--workers", "1")
    agent = f"columns@{folder / 'last.safetensors'}"
    assert "1 columns@" in packit("evaluate", data, "--agent", agent, *rules)
