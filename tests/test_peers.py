"""Other packing methods on cases solved by hand, and the check of their packings."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation
from trimesh.transformations import rotation_matrix

from benchmarks.peers import picture
from benchmarks.peers.cuboids import Cuboids
from benchmarks.peers.grids import profile_turned, profiles, voxels
from benchmarks.peers.heightmaps import Heightmaps
from benchmarks.peers.heuristic import VoxelHeuristic
from benchmarks.peers.players import Player
from benchmarks.peers.posed import AXIS_ORDERS, Posed
from benchmarks.peers.rows import Row, read, summaries, write
from benchmarks.peers.spectral import Metrics, Spectral, distances
from benchmarks.peers.validity import QualityScores
from packit_sim import Box, Item, Shape
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.geometry import rotations
from packit_sim.parts.packings.packing_files import verify_packing
from tests.examples import examples
from tests.zoo import BALL, BOWL, CUBE, PLATE, RING, SOUP, TILTED, cube_of, random_item

LIBRARY = LibraryRef("zoo", "1", "0")
HEURISTIC = "largest-first/aligned/blbf"
BOX = (100, 100, 100)

CONSERVATIVE = (
    Spectral(1),
    Spectral(2),
    Spectral(4),
    Heightmaps(),
    VoxelHeuristic(1),
    VoxelHeuristic(2),
    VoxelHeuristic(4),
)
SAMPLED = (Spectral(2, sampled=True), Heightmaps(sampled=True), VoxelHeuristic(2, sampled=True))
ALL = (*CONSERVATIVE, *SAMPLED, Player(HEURISTIC))


def task_of(*items: Item, cells: tuple[int, int, int] = BOX) -> Task:
    return Task(tuple(items), Pack(LIBRARY, cells, (), 0.0), ())


def named(peer) -> str:
    return peer.name


def ring_and_ball() -> Task:
    """A ring of 0.4 with a hole of 0.21, and a ball of 0.16 that fits nowhere else in the box."""
    ring = Item(RING, (0.4 / RING.extents[0]) ** 3)
    ball = Item(BALL, (0.16 / BALL.extents[0]) ** 3)
    return task_of(ring, ball, cells=(40, 40, 20))


@pytest.mark.parametrize("peer", ALL, ids=named)
def test_two_cubes_lie_side_by_side(peer) -> None:
    task = task_of(cube_of(40), cube_of(40), cells=(80, 40, 40))
    packing = peer.pack(task)
    centres = sorted(posed.centre.tolist() for posed in packing)
    np.testing.assert_allclose(centres, [[0.2, 0.2, 0.2], [0.6, 0.2, 0.2]])
    assert QualityScores.of(packing, task.cells) == QualityScores((), (), (0, 1))


@pytest.mark.parametrize("peer", ALL, ids=named)
def test_what_does_not_fit_is_left_outside(peer) -> None:
    task = task_of(cube_of(40), cube_of(40), cube_of(20), cells=(60, 40, 40))
    packing = peer.pack(task)
    assert [posed.item.scale for posed in packing] == [cube_of(40).scale, cube_of(20).scale]
    assert peer.pack(task_of(cube_of(61), cells=(60, 60, 60))) == []


@pytest.mark.parametrize(
    "peer",
    [Spectral(1), Spectral(2), Heightmaps(), VoxelHeuristic(1), Player(HEURISTIC)],
    ids=named,
)
def test_a_ball_goes_into_a_ring(peer) -> None:
    task = ring_and_ball()
    packing = peer.pack(task)
    assert [posed.item.shape.id for posed in packing] == ["ring", "ball"]
    assert QualityScores.of(packing, task.cells).valid


def test_cuboids_leave_the_ball_outside_the_ring() -> None:
    pytest.importorskip("packvium")
    assert [posed.item.shape.id for posed in Cuboids().pack(ring_and_ball())] == ["ring"]


def test_cuboids_fill_a_box_whatever_their_turn() -> None:
    pytest.importorskip("packvium")
    brick = Shape.from_mesh(creation.box((0.5, 0.3, 0.2)), "brick")
    scale = float(np.linalg.norm((0.5, 0.3, 0.2))) ** 3
    for cells in itertools.permutations((100, 60, 20)):
        task = task_of(*[Item(brick, scale)] * 4, cells=cells)
        packing = Cuboids().pack(task)
        assert len(packing) == 4
        assert QualityScores.of(packing, task.cells).valid


def test_an_agent_stops_by_the_rules_or_skips() -> None:
    task = task_of(cube_of(60), cube_of(60), cube_of(40))
    assert len(Player(HEURISTIC, skipping=False).pack(task)) == 1
    assert [round(posed.item.extents[0], 6) for posed in Player(HEURISTIC).pack(task)] == [0.6, 0.4]


def crate() -> Item:
    """Open at the top, 40 cells a side, with walls of a fifth of a cell."""
    walls = [creation.box(bounds=[(0, 0, 0), (1, 1, 0.005)])]
    for turn in range(4):
        wall = creation.box(bounds=[(0, 0, 0), (0.005, 1, 1)])
        walls.append(
            wall.apply_transform(rotation_matrix(turn * np.pi / 2, (0, 0, 1), (0.5, 0.5, 0)))
        )
    shape = Shape.from_mesh(trimesh.util.concatenate(walls), "crate")
    return Item(shape, (0.4 / shape.extents[0]) ** 3)


def test_sampled_voxels_miss_thin_walls_and_what_crosses_them() -> None:
    task = task_of(crate(), cube_of(32), cells=(40, 40, 40))
    assert not voxels(crate(), 2, sampled=True).any()
    packing = Spectral(2, sampled=True).pack(task)
    assert len(packing) == 2
    assert QualityScores.of(packing, task.cells).pairs == ((0, 1),)
    assert len(Spectral(2).pack(task)) == 1, "the cube in a corner leaves no space for the crate"


@examples(6)
@given(st.integers(0, 2**32 - 1))
def test_conservative_peers_are_always_valid(seed) -> None:
    rng = np.random.default_rng(seed)
    shapes = (CUBE, BALL, RING, BOWL, PLATE, SOUP, TILTED)
    task = task_of(*(random_item(shapes, 0.5, rng) for _ in range(6)), cells=(60, 52, 40))
    for peer in CONSERVATIVE:
        packing = peer.pack(task)
        assert packing, peer.name
        assert QualityScores.of(packing, task.cells).valid, peer.name


def test_transforms_count_collisions_as_a_plain_loop_does() -> None:
    rng = np.random.default_rng(3)
    filled, own = rng.random((9, 8, 12)) < 0.3, rng.random((4, 8, 3)) < 0.5
    metrics = Metrics(filled)
    spectrum = metrics.spectrum(own)
    steps = distances(filled)
    collisions, nearness = np.zeros((2, 6, 1, 10))
    for i, j, k in np.ndindex(6, 1, 10):
        window = slice(i, i + 4), slice(j, j + 8), slice(k, k + 3)
        collisions[i, j, k] = (filled[window] & own).sum()
        nearness[i, j, k] = steps[window][own].sum()
    np.testing.assert_allclose(metrics.collisions(spectrum, own.shape), collisions, atol=1e-3)
    np.testing.assert_allclose(metrics.proximity(spectrum, own.shape), nearness, atol=1e-3)


def test_distances_are_steps_from_what_is_filled_from_walls_and_from_the_floor() -> None:
    filled = np.zeros((5, 5, 9), dtype=bool)
    assert distances(filled)[2, 2].tolist() == [1, 2, 3, 3, 3, 3, 3, 3, 3]
    filled[2, 2, 5] = True
    assert distances(filled)[2, 2].tolist() == [1, 2, 3, 2, 1, 0, 1, 2, 3]


def test_voxels_are_of_cells_and_turn_with_the_item() -> None:
    item = Item(RING, 0.2)
    assert np.array_equal(voxels(item, 1, sampled=False), item.outer)
    assert voxels(item, 1, sampled=True).sum() < item.outer.sum()
    for turn in range(rotations.COUNT):
        turned = item.turned(turn)
        upright = voxels(item, 1, sampled=False)
        assert np.array_equal(rotations.turn_array(upright, turn), turned.outer)
        profile = profile_turned(profiles(item, sampled=False), turn)
        x, y, z = turned.cells
        assert np.array_equal(profile.reshape(x, y, z, 4).any(axis=3), turned.outer)
    coarse = voxels(item, 2, sampled=False)
    assert coarse.shape == tuple(-(-n // 2) for n in item.cells)
    assert np.array_equal(coarse, coarse[::-1])


def test_six_rotations_are_all_orders_of_the_axes() -> None:
    orders = {tuple(rotations.AXES[turn].tolist()) for turn in AXIS_ORDERS}
    assert orders == set(itertools.permutations(range(3)))
    assert AXIS_ORDERS[0] == 0


def test_conflicts_are_those_of_the_check_of_foreign_packings(tmp_path) -> None:
    """A cube in a wall, two that overlap, a ball inside a hollow cube, and one that is free."""
    cube, ball = cube_of(20), Item(BALL, 0.001)
    around = [(0.05, 0.5, 0.5), (0.3, 0.2, 0.2), (0.4, 0.3, 0.2), (0.7, 0.7, 0.7), (0.5, 0.8, 0.2)]
    packing = [Posed(cube, np.array(centre)) for centre in around]
    packing.append(Posed(ball, np.array((0.7, 0.7, 0.7))))
    verdict = QualityScores.of(packing, BOX)
    assert verdict == QualityScores((0,), ((1, 2), (3, 5)), (1, 3, 4))
    for posed in packing:
        posed.item.shape.mesh.export(tmp_path / f"{posed.item.shape.id}.ply")
    items = [
        {"mesh": f"{posed.item.shape.id}.ply", "pose": posed.pose.tolist()} for posed in packing
    ]
    (tmp_path / "packing.json").write_text(json.dumps({"box": [1, 1, 1], "items": items}))
    report = verify_packing(tmp_path / "packing.json")
    assert len(report.problems) == len(verdict.outside) + len(verdict.pairs)


def test_contact_is_valid_and_overlap_beyond_the_tolerance_is_not() -> None:
    first = Posed(cube_of(20), np.array((0.1, 0.1, 0.1)))
    for overlap, holds in ((-1e-3, True), (0.0, True), (0.9e-4, True), (2e-4, False)):
        second = Posed(cube_of(20), np.array((0.3 - overlap, 0.1, 0.1)))
        assert QualityScores.of([first, second], BOX).valid == holds, overlap


def test_rows_are_summed_up_written_and_read_again(tmp_path) -> None:
    box = Box()
    box.place(cube_of(20), (0, 0, 0))
    packing = [Posed(placed.item, placed.center) for placed in box.placed]
    tasks = [task_of(cube_of(20), cube_of(20)), task_of(cube_of(20))]
    rows = [Row.of("one", 1, task, packing, 0.5) for task in tasks]
    twice = [*packing, *packing]
    rows += [Row.of("other", 1, task, twice, 1.0) for task in tasks]
    assert (rows[0].share, rows[1].share) == pytest.approx((0.5, 1.0))
    one, other = summaries(rows, "one")
    assert (one.valid.mean, one.complete.mean, one.pairs.mean) == (100, 50, 0)
    assert (other.valid.mean, other.complete.mean, other.pairs.mean) == (0, 0, 1)
    assert other.share.mean == pytest.approx(2 * other.kept.mean)
    assert other.difference.ties == 2
    head = {"library": {"digest": "0"}, "peers": {"one": {"side": 1}, "other": {"side": 1}}}
    file = tmp_path / "peers.json"
    assert read(file, head) == []
    write(file, head, [one, other], rows)
    assert read(file, head) == rows
    changed = {**head, "peers": {"one": {"side": 1}, "other": {"side": 2}}}
    assert read(file, changed) == rows[:2]
    assert read(file, {**head, "library": {"digest": "1"}}) == []


def test_the_picture_has_a_row_a_peer(tmp_path) -> None:
    pytest.importorskip("matplotlib")
    task = task_of(cube_of(20))
    rows = [Row.of("one", together, task, [], 0.5) for together in (1, 2)]
    rows += [replace(row, peer="other", pairs=2) for row in rows]
    picture.save(summaries(rows, "one"), tmp_path / "peers.png")
    assert (tmp_path / "peers.png").stat().st_size > 10_000
