"""Separability: chains, cages, hooks and tunnels solved by hand; ways replayed in small steps."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.handling import ways_out
from packit_sim.parts.handling.broken import broken_constraints
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.filtering import filter_packing
from packit_sim.parts.handling.offset_kernels import UNREACHED, costs_to_border
from packit_sim.parts.handling.offsets import offsets_of
from packit_sim.parts.handling.removal import Removal, removable
from packit_sim.parts.handling.restacking import separated
from packit_sim.parts.handling.separability import (
    LinkedPair,
    linked_pairs,
    links_in_words,
    separable,
)
from packit_sim.parts.handling.sweeps import AXES
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import RECORD, write_record
from packit_sim.parts.results.summary import summary
from packit_sim.parts.results.verification import verify_record
from tests.packed_parts import BAR, CAGE, cuboid, joined, moved, packed, u_profile

BALL = creation.icosphere(subdivisions=2, radius=12).apply_translation((50, 50, 50))


def ring(radius: float = 15, wire: float = 2) -> trimesh.Trimesh:
    """A torus about z, at the origin."""
    return creation.torus(radius, wire, major_sections=32, minor_sections=12)


def chain(x: float = 50, y: float = 50, z: float = 50) -> list[trimesh.Trimesh]:
    """Two links that do not touch."""
    upright = ring()
    upright.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    return [moved(ring(), x, y, z), moved(upright, x + 15, y, z)]


def clasp(gap: float) -> trimesh.Trimesh:
    """A square ring in the plane of x and y, with a gap at high x, around `ROD`."""
    return joined(
        cuboid((30, 30, 40), (35, 70, 60)),
        cuboid((30, 30, 40), (70, 35, 60)),
        cuboid((30, 65, 40), (70, 70, 60)),
        cuboid((65, 30, 40), (70, 50 - gap / 2, 60)),
        cuboid((65, 50 + gap / 2, 40), (70, 70, 60)),
    )


ROD = joined(
    cuboid((45, 45, 5), (55, 55, 95)),
    cuboid((33, 33, 5), (67, 67, 10)),
    cuboid((33, 33, 90), (67, 67, 95)),
)
"""A rod with a plate on each end that does not fit through `clasp`."""


def channel(*points: tuple[float, float, float], half: float = 5.0) -> trimesh.Trimesh:
    """A block with a square channel through these points."""
    cut = [
        cuboid(np.minimum(a, b) - half, np.maximum(a, b) + half)  # type: ignore[arg-type]
        for a, b in pairwise(points)
    ]
    tool = trimesh.boolean.union(cut, engine="manifold")
    block = cuboid((10, 10, 10), (90, 90, 90))
    return trimesh.boolean.difference([block, tool], engine="manifold")


def test_two_links_of_a_chain_are_linked() -> None:
    packing = packed(*chain())
    assert linked_pairs(packing) == (LinkedPair((0, 1), True),)
    found = separable(packing)
    assert found.order == ()
    assert [(one.part, one.by, one.is_proven) for one in found.stuck] == [
        (0, (1,), True),
        (1, (0,), True),
    ]


def test_rings_that_only_cross_each_others_bounding_boxes_are_not_linked() -> None:
    flat, upright = chain()
    packing = packed(flat, moved(upright, -15, 0, 17.5))
    assert linked_pairs(packing) == ()
    assert separable(packing).stuck == ()


def test_a_ball_in_a_cage_is_linked_to_it() -> None:
    packing = packed(BALL, CAGE, cuboid((0, 0, 0), (10, 10, 10)))
    assert linked_pairs(packing) == (LinkedPair((0, 1), True),)
    assert separable(packing).order == (2,)


def test_a_clasp_leaves_a_rod_through_its_gap_only_if_that_is_wide_enough() -> None:
    """The gap is 14 and the rod 10 wide: it slides out sideways; 2 is too narrow."""
    opened = packed(clasp(14), ROD)
    assert linked_pairs(opened) == ()
    assert separable(opened).stuck == ()
    closed = packed(clasp(2), ROD)
    assert linked_pairs(closed) == (LinkedPair((0, 1), True),)
    assert len(separable(closed).stuck) == 2


def test_a_bolt_leaves_an_l_shaped_channel_round_the_corner() -> None:
    """Its foot is below a lip: it has to move along the foot, to a wider way up."""
    hole = [
        cuboid((45, 25, 25), (55, 75, 35)),  # for the foot, with space to move
        cuboid((45, 25, 35), (55, 60, 95)),  # for the stem, as long as the foot further on
    ]
    tool = trimesh.boolean.union(hole, engine="manifold")
    block = cuboid((20, 20, 10), (80, 80, 90))
    housing = trimesh.boolean.difference([block, tool], engine="manifold")
    bolt = joined(cuboid((46, 45, 26), (54, 53, 80)), cuboid((46, 45, 26), (54, 74, 34)))
    packing = packed(bolt, housing)
    assert linked_pairs(packing) == ()
    found = separable(packing)
    assert found.stuck == ()
    _replay([bolt, housing], found)


def test_a_part_goes_round_more_corners_than_removal_tries() -> None:
    winding = channel(
        (50, 50, 50),
        (70, 50, 50),
        (70, 70, 50),
        (70, 70, 30),
        (30, 70, 30),
        (30, 30, 30),
        (30, 30, 95),
    )
    cube = cuboid((46, 46, 46), (54, 54, 54))
    packing = packed(cube, winding)
    assert len(removable(packing).stuck) == 2
    assert linked_pairs(packing) == ()
    found = separable(packing)
    assert found.order[0] == 0 and found.stuck == ()
    _replay([cube, winding], found)
    blocked = packed(cube, winding, cuboid((20, 20, 90), (40, 40, 95)))
    assert separable(blocked).order == (2, 0, 1)  # the lid goes first
    assert [one.part for one in separable(blocked, fixed=(2,)).stuck] == [0, 1]


def test_a_cavity_with_a_narrow_opening_is_no_solid() -> None:
    """A wire of 0.4 mm is in a cavity, larger than voxels, whose opening is smaller than them."""
    hollow = channel((50, 50, 50), (50, 50, 95), half=0.5)
    room = cuboid((40, 40, 20), (60, 60, 60))
    hollow = trimesh.boolean.difference([hollow, room], engine="manifold")
    wire = cuboid((49.8, 49.8, 25), (50.2, 50.2, 55))
    assert linked_pairs(packed(wire, hollow)) == ()


def test_parts_that_only_together_hold_a_part_are_no_linked_pair() -> None:
    """Six plates around a cube leave no way out, but any plate goes first."""
    plates = [cuboid((35, 35, 30), (65, 65, 34)), cuboid((35, 35, 66), (65, 65, 70))]
    plates += [cuboid((31, 31, 34), (35, 69, 66)), cuboid((65, 31, 34), (69, 69, 66))]
    plates += [cuboid((35, 31, 34), (65, 35, 66)), cuboid((35, 65, 34), (65, 69, 66))]
    packing = packed(cuboid((40, 40, 40), (60, 60, 60)), *plates)
    assert linked_pairs(packing) == ()
    assert separable(packing).stuck == ()
    held = separable(packing, fixed=range(1, 7))
    assert [(one.part, one.is_proven) for one in held.stuck] == [(0, True)]


def test_links_in_different_boxes_do_not_see_each_other() -> None:
    packing = packed(*chain())
    placements = (packing.placements[0], Placement(1, box=1))
    apart = replace(packing, placements=placements, objective="bins")
    assert linked_pairs(apart) == () and separable(apart).stuck == ()


def test_what_can_be_removed_can_be_separated() -> None:
    for meshes in ((u_profile(), BAR), (BALL, cuboid((0, 0, 0), (10, 10, 10)))):
        packing = packed(*meshes)
        assert removable(packing).stuck == () == separable(packing).stuck


def test_constraints_name_what_interlocks_and_leave_the_cheapest_out() -> None:
    packing = packed(*chain(), cuboid((0, 0, 0), (10, 10, 10)), names=("ring", "link", "cube"))
    separately = Constraints(separable=True)
    assert [one.sentence for one in broken_constraints(packing, separately)] == [
        "'ring' can't be moved out without turning: 'link' is in the way",
        "'link' can't be moved out without turning: 'ring' is in the way",
    ]
    filtered = filter_packing(packing, separately)
    assert len(filtered.left_out) == 1 and "without turning" in filtered.left_out[0].reason
    assert broken_constraints(filtered.packing, separately) == []


def test_parts_of_a_strip_that_interlock_are_placed_again_on_top() -> None:
    strip = replace(
        packed(*chain(), clearance=1.0),
        container=BoxContainer((100, 100, math.inf)),
        objective="strip",
    )
    found = separated(strip)
    assert linked_pairs(found) == () and separable(found).stuck == ()
    assert found.problems() == [] and strip.height < found.height < 110
    assert separated(found) is found
    with pytest.raises(ArgumentError, match="only a strip"):
        separated(packed(*chain()))


def test_pack_leaves_parts_out_that_interlock_and_records_it(tmp_path: Path) -> None:
    flat, upright = chain()
    task = prepared_task(
        [Part("ring", flat, rotations="fixed")],
        "100x100x100mm",
        "volume",
        PackSettings(separable=True, fixed=[Part("link", upright)]),
    )
    inside = Packing(
        task.types, task.container(task.boxes[0]), (Placement(0),), task.gap, "knapsack"
    )
    for settings, count in ((task.settings, 0), (replace(task.settings, separable=False), 1)):
        packed_parts = candidate(replace(task, settings=settings), [inside])
        assert packed_parts.count == count
    checked = check(packed_parts)
    assert "linked pairs" not in summary(packed_parts)  # parts in conflict are not linked but wrong
    assert (
        summary(packed_parts, checked)["linked pairs"] == "link (fixed) and ring (part 0 of box 1)"
    )
    write_record(packed_parts, checked, tmp_path, {})
    record = tmp_path / RECORD
    report = verify_record(record)
    assert report.problems == () and report.linked == "link (fixed) and ring (part 0 of box 1)"
    text = record.read_text()
    record.write_text(text.replace("link (fixed) and ring (part 0 of box 1)", "none"))
    assert "linked pairs" in str(verify_record(record).problems[0])
    earlier = json.loads(text)
    del earlier["request"]["separable"], earlier["summary"]["linked pairs"]
    record.write_text(json.dumps(earlier))
    assert verify_record(record).problems == ()
    record.write_text(text.replace('"separable": false', '"separable": true'))
    assert "can't be moved out without turning" in str(verify_record(record).problems[0])


def test_verify_reports_linked_pairs_of_any_packing(tmp_path: Path) -> None:
    packed(*chain(), names=("ring", "link")).write(tmp_path / "packing.json")
    read = Packing.read(tmp_path / "packing.json")
    assert len(read.placements) == 2 and read.container.size == (100, 100, 100)
    report = verify_record(tmp_path / "packing.json")
    assert (
        report.is_valid
        and report.linked.startswith("item 0 (")
        and " and item 1 (" in report.linked
    )


def test_what_is_neither_moved_out_nor_proven_to_be_stuck_is_in_doubt(monkeypatch) -> None:
    monkeypatch.setattr(ways_out, "_ATTEMPTS", ())
    packing = packed(*chain(), names=("ring", "link"))
    pairs = linked_pairs(packing)
    assert pairs == (LinkedPair((0, 1), False),)
    assert links_in_words(pairs, ("a", "b")) == "a and b (not proven)"
    assert [one.is_proven for one in separable(packing).stuck] == [False, False]
    broken = broken_constraints(packing, Constraints(separable=True))
    assert broken[0].sentence == "'ring' was not moved out without turning: 'link' is in the way"


def test_many_linked_pairs_are_counted() -> None:
    pairs = [LinkedPair((n, n + 1), True) for n in range(12)]
    assert links_in_words(pairs, [f"{n}" for n in range(13)]).endswith("; 9 and 10; 2 more")


def test_offsets_that_are_surely_blocked_are_those_of_overlaps() -> None:
    """The parts are convex, so that blocked offsets enclose no free ones."""
    ball = creation.icosphere(subdivisions=2, radius=0.1)
    beam = creation.box((0.5, 0.12, 0.2))
    turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3))
    beam.apply_transform(turn)
    beam_from_world = np.linalg.inv(turn)
    manager = trimesh.collision.CollisionManager()
    manager.add_object("beam", beam)
    low = beam.bounds[0] - ball.bounds[1]
    found = offsets_of(np.asarray(ball.triangles), [np.asarray(beam.triangles)], low, -low, 2**16)
    rng = np.random.default_rng(0)
    blocked = np.argwhere(found.costs == UNREACHED)
    assert len(blocked) > 100
    for cell in rng.permutation(blocked)[:200]:
        pose = np.eye(4)
        pose[:3, 3] = (cell + found.first + rng.uniform(-0.5, 0.5, 3)) * found.cell
        middle = beam_from_world[:3, :3] @ pose[:3, 3]
        is_inside = bool((np.abs(middle) < (0.25, 0.06, 0.1)).all())  # FCL compares surfaces alone
        assert is_inside or manager.in_collision_single(ball, pose)


def test_an_offset_beyond_the_cells_has_no_way() -> None:
    ball = creation.icosphere(subdivisions=1, radius=0.1)
    low = np.full(3, -0.3)
    found = offsets_of(np.asarray(ball.triangles), [], low, -low, 2**12)
    last = found.first + found.costs.shape - 1
    assert found.cost(last * found.cell) is not None
    for axis in np.eye(3, dtype=int):
        assert found.cost((last + axis) * found.cell) is None
        assert found.cost((found.first - axis) * found.cell) is None


def test_costs_to_the_border_are_those_of_repeated_relaxation() -> None:
    rng = np.random.default_rng(0)
    costs = rng.choice(np.array((0, 0, 0, 1, 9), np.uint8), (7, 8, 9))
    true = np.full((9, 10, 11), np.inf)
    border = np.pad(np.zeros((5, 6, 7), bool), 1, constant_values=True)
    inside = true[1:-1, 1:-1, 1:-1]
    for _ in range(costs.size):
        ahead = np.min(
            [np.roll(true, s, a)[1:-1, 1:-1, 1:-1] for s in (1, -1) for a in range(3)], axis=0
        )
        ahead[border] = 0
        inside[...] = np.where(costs, ahead + costs, np.inf)
    expected = np.where(np.isfinite(inside), inside, UNREACHED)
    assert (costs_to_border(costs) == expected).all()


def boxes(count: int, seed: int) -> Packing:
    """Random boxes that touch nothing, in a container of 100 mm."""
    rng = np.random.default_rng(seed)
    meshes: list[trimesh.Trimesh] = []
    low, high = np.empty((0, 3)), np.empty((0, 3))
    while len(meshes) < count:
        size = 40 * rng.uniform(0.4, 1, 3) / count ** (1 / 3)
        corner = rng.uniform(0, 100 - size)
        if not ((corner < high) & (corner + size > low)).all(axis=1).any():
            low, high = np.vstack((low, corner)), np.vstack((high, corner + size))
            meshes.append(cuboid(corner.tolist(), (corner + size).tolist()))
    return packed(*meshes)


def test_of_random_boxes_none_are_linked() -> None:
    packing = boxes(100, 0)
    start = time.process_time()
    assert linked_pairs(packing) == ()
    assert separable(packing).stuck == ()
    assert time.process_time() - start < 3


@pytest.mark.slow
def test_a_ball_leaves_a_helical_tube() -> None:
    tube, middle = _helix()
    ball = moved(creation.icosphere(subdivisions=2, radius=3.5), *middle)
    found = separable(packed(ball, tube))
    assert found.order[0] == 0 and found.stuck == ()
    _replay([ball, tube], found)


def _helix() -> tuple[trimesh.Trimesh, np.ndarray]:
    """A tube of radius 5 inside and 7 outside along a helix, and the middle of its axis."""
    angles = np.linspace(0, 3 * np.pi, 90)
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    out = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1)
    axis = 20 * out + np.stack((0 * angles, 0 * angles, 10 * angles / np.pi), axis=1) + (50, 50, 20)
    along = np.gradient(axis, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = np.cross(along, out)
    cos, sin = np.cos(around)[None, :, None], np.sin(around)[None, :, None]
    rings = [axis[:, None] + r * (cos * out[:, None] + sin * across[:, None]) for r in (7, 5)]
    grid = np.arange(2 * 90 * 24).reshape(2, 90, 24)
    after = np.roll(grid, -1, axis=2)
    quads = [
        (grid[0, :-1], after[0, :-1], after[0, 1:], grid[0, 1:]),
        (grid[1, :-1], grid[1, 1:], after[1, 1:], after[1, :-1]),
        (grid[0, :1], grid[1, :1], after[1, :1], after[0, :1]),
        (grid[0, -1:], after[0, -1:], after[1, -1:], grid[1, -1:]),
    ]
    faces = np.concatenate(
        [np.stack(q, axis=-1).reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]] for q in quads]
    )
    mesh = trimesh.Trimesh(
        np.concatenate(rings).reshape(-1, 3), faces.reshape(-1, 3), process=False
    )
    mesh.fix_normals()
    assert mesh.is_volume
    return mesh, axis[45]


def _replay(meshes: list[trimesh.Trimesh], found: Removal) -> None:
    """Move each part along its way in small steps, past those that are still there."""
    manager = trimesh.collision.CollisionManager()
    for n, mesh in enumerate(meshes):
        manager.add_object(str(n), mesh)
    for part, route in zip(found.order, found.routes, strict=True):
        manager.remove_object(str(part))
        middle = meshes[part].bounds.mean(axis=0)
        smaller = meshes[part].copy()
        smaller.vertices = middle + (smaller.vertices - middle) * (1 - 0.03 / smaller.extents)
        shift = np.zeros(3)
        for direction, length in (*route.moves, (route.out, 150.0)):
            axis, sign = AXES[direction]
            for share in np.linspace(0, 1, 15):
                pose = np.eye(4)
                pose[:3, 3] = shift
                pose[axis, 3] += sign * length * share
                assert not manager.in_collision_single(smaller, pose)
            shift[axis] += sign * length
