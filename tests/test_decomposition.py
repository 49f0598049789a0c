"""Convex pieces: hulls and cuts of known solids, cavities, and the cache on disk."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from trimesh import creation, sample

from packit_sim.core import caches
from packit_sim.core.extras import MissingPackageError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.shapes import Shape
from packit_sim.physics.convex import decomposition, disk_cache
from packit_sim.physics.convex.bisection import bisect
from packit_sim.physics.convex.decomposition import Decomposition, decompose, decompose_all
from packit_sim.physics.convex.fitting import FittedItems
from packit_sim.physics.convex.pieces import (
    MAX_CORNERS,
    SHEET,
    MassProperties,
    Piece,
    clipped,
    covering,
    within,
)
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.convex.solids import Solid
from tests.examples import examples
from tests.zoo import BALL, BOWL, CUBE, PLATE, RING, SOUP, TILTED

HALVES = DecompositionSettings(method="bisection", hausdorff=0.1)
SEEDS = st.integers(0, 2**32 - 1)
solid_of = cache(Solid)  # distances from the surface of half a million voxels


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty store, and nothing in the process's cache."""
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path / "kept"))
    monkeypatch.setattr(decomposition, "Solid", solid_of)
    caches.clear("decompositions")
    yield tmp_path / "kept"
    caches.clear("decompositions")


def block(low: tuple[float, ...], high: tuple[float, ...]) -> Piece:
    return Piece.around(np.array([low, high])[np.indices((2, 2, 2)).reshape(3, 8).T, range(3)])


def random_piece(rng: np.random.Generator) -> Piece:
    return Piece.around(rng.uniform(-1, 1, 3) + rng.uniform(-1, 1, (int(rng.integers(4, 30)), 3)))


def is_in(points: np.ndarray, piece: Piece, slack: float = 1e-6) -> np.ndarray:
    return (points @ piece.planes[:, :3].T + piece.planes[:, 3] <= slack).all(axis=1)


def covers(pieces: tuple[Piece, ...] | list[Piece], shape: Shape) -> bool:
    """Whether each point of the surface is in a piece, up to sampling and rounding."""
    points, _ = sample.sample_surface(shape.mesh, 500, seed=1)
    return np.any([is_in(points, piece, SHEET) for piece in pieces], axis=0).all()


@given(SEEDS)
def test_a_hull_is_convex_closed_and_around_its_points(seed) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (int(rng.integers(4, MAX_CORNERS)), 3))
    piece = Piece.around(points)
    assert is_in(points, piece).all()
    edges = piece.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).tolist()
    assert sorted(edges) == sorted([end, start] for start, end in edges)
    assert not is_in(piece.triangles.mean(axis=1) + _normals(piece) * 1e-3, piece).any()


def _normals(piece: Piece) -> np.ndarray:
    a, b, c = np.moveaxis(piece.triangles, 1, 0)
    crosses = np.cross(b - a, c - a)
    return crosses / np.linalg.norm(crosses, axis=1)[:, None]


@given(SEEDS)
def test_what_a_plane_parts_is_the_whole_again(seed) -> None:
    rng = np.random.default_rng(seed)
    piece, normal = random_piece(rng), rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    inside = rng.dirichlet(np.ones(len(piece.vertices))) @ piece.vertices
    offset = -float(normal @ inside)
    parts = [piece.cut(sign * normal, sign * offset) for sign in (1, -1)]
    assert sum(part.volume for part in parts) == pytest.approx(piece.volume, abs=10 * SHEET)
    for part, sign in zip(parts, (1, -1), strict=True):
        assert (sign * (part.vertices @ normal + offset)).max() < SHEET
        assert is_in(part.vertices, piece, SHEET).all()


def test_a_cut_outside_a_piece_keeps_all_or_nothing() -> None:
    piece = block((0, 0, 0), (1, 2, 3))
    whole = piece.cut(np.array((0.0, 0.0, 1.0)), -3.5)
    assert whole is not None
    assert whole.volume == pytest.approx(6)
    assert piece.cut(np.array((0.0, 0.0, -1.0)), 3.5) is None


def test_what_is_flat_becomes_a_sheet() -> None:
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    assert Piece.around(square).volume == pytest.approx(SHEET)
    assert Piece.around(square[:2]).volume == pytest.approx(SHEET**2)
    assert Piece.around(square[:1]).volume == pytest.approx(SHEET**3)


def test_a_hull_of_many_corners_keeps_those_farthest_out() -> None:
    ball = creation.icosphere(subdivisions=4)
    piece = Piece.around(np.asarray(ball.vertices) * (1, 1, 3))
    assert len(piece.vertices) <= MAX_CORNERS
    assert 0.95 < piece.volume / (3 * ball.volume) < 1


def test_mass_properties_of_a_block_and_of_its_halves() -> None:
    """Hand-solved: a block of a x b x c has the moment (b^2 + c^2) / 12 about its axis along a."""
    low, high = (1, 2, 3), (2, 4, 6)
    halves = [block(low, (2, 4, 5)), block((1, 2, 5), high)]
    for pieces in ([block(low, high)], halves):
        found = MassProperties.of(pieces)
        assert found.volume == pytest.approx(6)
        assert np.allclose(found.center, (1.5, 3, 4.5))
        assert np.allclose(found.moments, np.array((1 + 4, 1 + 9, 4 + 9)) / 12)
        assert np.allclose(np.abs(found.axes), np.eye(3)[::-1])
        assert np.linalg.det(found.axes) == pytest.approx(1)


def test_what_of_a_surface_is_in_a_block() -> None:
    cube = CUBE.mesh.triangles
    half = CUBE.extents[0] / 2
    corner = block((0, 0, 0), (1, 1, 1))
    points = within(np.asarray(cube), corner)
    assert np.allclose(points.min(axis=0), 0) and np.allclose(points.max(axis=0), half)
    assert Piece.around(points).volume == pytest.approx(half**3 * 5 / 6)  # all but the inner corner
    assert not len(within(np.asarray(cube), block((1, 1, 1), (2, 2, 2))))
    assert not len(clipped(np.asarray(cube), np.array([[0, 0, 1, 1.0]])))


def test_a_solid_knows_what_a_hull_fills() -> None:
    """The middle of the bowl's lid is one radius from it: the bowl is half a ball."""
    radius = BOWL.extents[0] / 2
    solid = solid_of(BOWL)
    hull = Piece.around(np.asarray(BOWL.mesh.vertices))
    assert solid.hausdorff(hull) == pytest.approx(radius, abs=4 * solid.voxel)
    assert solid_of(CUBE).hausdorff(Piece.around(np.asarray(CUBE.mesh.vertices))) == 0
    middle, wall = np.zeros((1, 3)), CUBE.extents / 2 - 1e-6
    assert solid_of(CUBE).encloses(middle).all() and not solid_of(CUBE).encloses(wall[None]).any()
    assert not solid.encloses(middle).any()


@pytest.mark.parametrize("shape", [CUBE, BALL, PLATE, TILTED], ids=lambda shape: shape.id)
def test_a_convex_shape_is_one_piece(shape: Shape) -> None:
    found = decompose(shape)  # by CoACD, which is not asked
    assert (len(found.pieces), found.method, found.problem) == (1, "convex", None)
    assert found.distances == (0,)
    assert abs(found.volume_error) < 0.03 and (shape is BALL or abs(found.volume_error) < 1e-6)


@pytest.mark.parametrize("shape", [BOWL, RING, SOUP], ids=lambda shape: shape.id)
def test_halving_ends_where_no_hull_is_too_far_out(shape: Shape) -> None:
    solid = solid_of(shape)
    pieces = bisect(shape, solid, 0.03, 200)
    assert 4 < len(pieces) < 200
    assert max(map(solid.hausdorff, pieces)) <= 0.03
    assert covers(pieces, shape)
    assert len(bisect(shape, solid, 0.001, 7)) in (7, 8)


def angle() -> Shape:
    """Two blocks as an L: their faces are 2 wide, 1 deep and 2 high, less a corner of 1."""
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    vertices = np.array([(x, y, z) for y in (0, 1) for x, z in outline], dtype=float)
    front = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    back = [(c + 6, b + 6, a + 6) for a, b, c in front]
    around = [(n, (n + 1) % 6) for n in range(6)]
    sides = [f for a, b in around for f in ((a, a + 6, b), (b, a + 6, b + 6))]
    mesh = trimesh.Trimesh(vertices, front + back + sides)
    assert mesh.is_volume
    return Shape.from_mesh(mesh, "angle")


def test_coacd_takes_an_angle_apart() -> None:
    shape = angle()
    found = decompose(shape)
    assert (found.method, found.problem, len(found.pieces)) == ("coacd", None, 2)
    assert found.volume_error == pytest.approx(0, abs=0.02)
    assert max(found.distances) < 0.01
    assert covers(found.pieces, shape)
    corner = shape.extents / 2 * (0.5, 1, 0.5)
    assert not any(is_in(corner[None], piece).any() for piece in found.pieces)


@pytest.mark.slow
def test_coacd_leaves_a_bowl_hollow_and_no_larger() -> None:
    bowl = decompose(BOWL, DecompositionSettings(threshold=0.1))
    assert (bowl.method, bowl.problem) == ("coacd", None)
    assert len(bowl.pieces) > 4
    assert covers(bowl.pieces, BOWL)
    ball = creation.icosphere(radius=0.3 * BOWL.extents[0])
    inside = ball.vertices + np.array((0, 0, BOWL.extents[2] / 2))  # about the lid's middle
    assert not any(is_in(inside, piece).any() for piece in bowl.pieces)
    hull = ConvexHull(BOWL.mesh.vertices).equations  # a piece would have fewer corners
    beyond = [piece.vertices @ hull[:, :3].T + hull[:, 3] for piece in bowl.pieces]
    assert max(float(distances.max()) for distances in beyond) < 1e-9
    volume = sum(piece.volume for piece in bowl.pieces)
    assert bowl.volume_error == pytest.approx(volume / BOWL.volume - 1)


@pytest.mark.parametrize(
    ("run", "problem"),
    [
        ("raise SystemExit(3)", "ended with status 3"),
        ("import os; os.kill(os.getpid(), 11)", "ended with status -11"),
        ("import time; time.sleep(300)", "took more than 3 s"),
        (
            decomposition._RUN.partition("import coacd")[0] + "while True: pass",
            "took more than 1 s of CPU time",
        ),
        ("import sys, numpy; numpy.savez(sys.argv[1] + '/hulls.npz')", "it found no pieces"),
    ],
)
def test_where_coacd_fails_halving_does_it(
    run: str, problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decomposition, "_RUN", run)
    monkeypatch.setattr(decomposition, "_PATIENCE", 3 if "sleep" in run else 600)
    found = decompose(BOWL, DecompositionSettings(seconds=1, hausdorff=0.2))
    assert found.method == "bisection"
    assert found.problem is not None and problem in found.problem
    assert covers(found.pieces, BOWL)


def test_without_coacd_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise decomposition.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(decomposition.metadata, "version", missing)
    with pytest.raises(
        MissingPackageError, match=r"pip install 'packit-sim\[physics\]'.*bisection"
    ):
        decompose(BOWL)
    assert decompose(BOWL, HALVES).method == "bisection"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"method": "vhacd"}, "'vhacd' is not known: choose from coacd, bisection"),
        ({"threshold": 0.0}, r"threshold 0.0 is not possible: 0.01 to 1"),
        ({"max_pieces": 0}, "max_pieces 0 is not possible: 1 to 1000"),
        ({"hausdorff": float("nan")}, "hausdorff nan is not possible"),
    ],
)
def test_settings_out_of_range(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DecompositionSettings(**settings)


def same(one: Decomposition, other: Decomposition) -> bool:
    return (one.distances, one.method, one.problem, one.volume_error) == (
        other.distances,
        other.method,
        other.problem,
        other.volume_error,
    ) and all(
        np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)
        for a, b in zip(one.pieces, other.pieces, strict=True)
    )


def refuse(*arguments: object) -> None:
    raise AssertionError("computed again")


def test_cached_pieces_are_not_computed_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = decompose(RING, HALVES)
    assert decompose(RING, HALVES) is first
    caches.clear("decompositions")
    monkeypatch.setattr(decomposition, "decompose_anew", refuse)
    assert same(decompose(RING, HALVES), first)
    (kept,) = (path for path in folder.rglob("*") if path.is_file())
    assert kept.parent.name == "decompositions" and kept.name.startswith(RING.digest[:32])
    with pytest.raises(AssertionError, match="computed again"):
        decompose(RING, DecompositionSettings(method="bisection", hausdorff=0.02))


@pytest.mark.parametrize("damage", ["cut", "bits", "empty", "foreign", "folder"])
def test_damaged_pieces_are_computed_again(
    damage: str, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first = decompose(RING, HALVES)
    (kept,) = (path for path in folder.rglob("*") if path.is_file())
    data = bytearray(kept.read_bytes())
    if damage == "cut":
        kept.write_bytes(data[: len(data) // 2])
    elif damage == "bits":
        data[len(data) // 2] ^= 255
        kept.write_bytes(data)
    elif damage == "empty":
        kept.write_bytes(b"")
    elif damage == "foreign":
        with kept.open("wb") as file:
            np.savez(file, vertices=np.zeros(3))
    else:
        kept.unlink()
        kept.mkdir()
    caches.clear("decompositions")
    assert same(decompose(RING, HALVES), first)
    assert "is damaged and will be computed again" in caplog.text
    if damage == "folder":
        assert "can't be written" in caplog.text
    else:
        caplog.clear()
        caches.clear("decompositions")
        assert same(decompose(RING, HALVES), first)
        assert not caplog.text


def test_a_folder_that_cannot_be_written_is_gone_without(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder.write_text("a file is in the way")
    with caplog.at_level(logging.WARNING):
        assert decompose(RING, HALVES).method == "bisection"
    assert "can't be written" in caplog.text


def test_where_things_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(disk_cache.CACHE_VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert disk_cache.cache_folder() == tmp_path / "packit-sim"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert disk_cache.cache_folder() == tmp_path / ".cache" / "packit-sim"


def test_many_at_once_make_the_same(folder: Path) -> None:
    reported = []
    shapes = [RING, BOWL, RING, CUBE, RING]
    found = decompose_all(shapes, HALVES, 4, lambda shape, one: reported.append(shape.id))
    assert reported == [shape.id for shape in shapes]
    assert same(found[0], found[2]) and same(found[0], found[4])
    assert len([path for path in folder.rglob("*") if path.is_file()]) == 3
    caches.clear("decompositions")
    assert all(same(decompose(s, HALVES), one) for s, one in zip(shapes, found, strict=True))


def overlap(one: Piece, other: Piece) -> float:
    """How far two pieces overlap along the direction along which they do so least: a face's of
    either, or one across an edge of each.
    """
    faces = np.concatenate((one.planes[:, :3], -other.planes[:, :3]))
    least = least_overlap(one, other, faces)
    if least < 2 * SHEET:
        return least
    edges = [(p.triangles - np.roll(p.triangles, 1, axis=1)).reshape(-1, 3) for p in (one, other)]
    across = np.cross(edges[0][:, None], edges[1][None]).reshape(-1, 3)
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    across = (across / np.maximum(lengths, 1e-300))[lengths[:, 0] > 1e-9]
    return least_overlap(one, other, np.concatenate((across, -across)))


def least_overlap(one: Piece, other: Piece, directions: Floats) -> float:
    ends = (one.vertices @ directions.T).max(axis=0) - (other.vertices @ directions.T).min(axis=0)
    return float(ends.min())


@pytest.mark.slow
@examples(40)
@given(SEEDS)
def test_fitted_pieces_overlap_nowhere(seed) -> None:
    rng = np.random.default_rng(seed)
    items = [
        [(random_piece(rng), float(rng.choice((0, 0.01, 0.02)))) for _ in range(2)]
        for _ in range(3)
    ]
    pieces = FittedItems.of(items, surfaces(items)).pieces
    for i in range(3):
        assert sum(p.volume for p in pieces[i]) <= sum(p.volume for p, _ in items[i]) + 1e-3
        for j in range(i):
            assert all(overlap(a, b) < 2 * SHEET for a in pieces[i] for b in pieces[j])


def surfaces(items: Sequence[Sequence[Piece]]) -> list[Floats]:
    """Return the surfaces of items that are identical to their pieces."""
    return [np.concatenate([piece.triangles for piece, _ in parts]) for parts in items]


def test_what_is_as_large_as_its_shape_stays_whole() -> None:
    left, right = block((0, 0, 0), (1, 1, 1)), block((0.992, 0, 0), (2, 1, 1))
    touching = block((1, 0, 0), (2, 1, 1))
    for outs, items, volumes in (
        ((0.0, 0.1), (left, right), (1, 1)),
        ((0.3, 0.1), (left, right), (1 - 0.006, 1.008 - 0.002)),
        ((0.0, 0.1), (left, touching), (1, 1)),
    ):
        parts = [[part] for part in zip(items, outs, strict=True)]
        (first,), (second,) = FittedItems.of(parts, surfaces(parts)).pieces
        assert (first.volume, second.volume) == pytest.approx(volumes)
    assert (first, second) == (left, touching)


def test_what_is_hollow_where_another_stands_is_divided() -> None:
    pan = [block(low, high) for low, high in pan_sides()]
    walls = np.concatenate([side.triangles for side in pan])
    inside = block((0.4, 0.4, 0.4), (0.6, 0.6, 0.6))
    filled = [(block((0, 0, 0), (1, 1, 1)), 0.0)]
    parts = [filled, [(inside, 0.0)]]
    sides, kept = FittedItems.of(parts, [walls, inside.triangles]).pieces
    assert kept == [inside] and len(sides) > 5
    assert all(overlap(side, inside) < 2 * SHEET for side in sides)
    seen = walls.reshape(-1, 3)
    assert np.any([is_in(seen, side) for side in sides], axis=0).all()
    outside = block((2, 0, 0), (3, 1, 1))
    apart = FittedItems.of([filled, [(outside, 0.0)]], [walls, outside.triangles])
    assert apart.pieces[0] == [filled[0][0]]


@pytest.mark.parametrize("corner", [(0.4, 0.4, 0.4), (0.93, 0.2, 0.2), (1.5, 0.0, 0.0)])
def test_one_more_item_is_fitted_as_if_all_were_fitted_together(corner) -> None:
    walls = np.concatenate([block(low, high).triangles for low, high in pan_sides()])
    near = block((0.995, 0, 0), (1.4, 1, 1))
    new = block(corner, np.array(corner) + 0.2)
    items = [[(block((0, 0, 0), (1, 1, 1)), 0.0)], [(near, 0.1)], [(new, 0.1)]]
    surfaces = [walls, near.triangles, new.triangles]
    together = FittedItems.of(items, surfaces).pieces
    before = FittedItems.of(items[:2], surfaces[:2])
    kept = [list(own) for own in before.pieces]
    after = before.with_one(items, new.triangles).pieces
    for ours, theirs in zip(after, together, strict=True):
        for one, other in zip(ours, theirs, strict=True):
            assert np.array_equal(one.vertices, other.vertices)
    assert before.pieces == kept


def pan_sides() -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Low and high corners of a unit cube's bottom and four walls, 0.1 thick; it is open above."""
    return [
        ((0, 0, 0), (1, 1, 0.1)),
        ((0, 0, 0), (0.1, 1, 1)),
        ((0.9, 0, 0), (1, 1, 1)),
        ((0, 0, 0), (1, 0.1, 1)),
        ((0, 0.9, 0), (1, 1, 1)),
    ]


def test_pieces_are_enlarged_to_a_surface_that_they_fall_short_of() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    triangles = np.asarray(ball.triangles)
    halves = [ball.vertices[ball.vertices[:, 0] * side > 0.2] * 0.95 for side in (1, -1)]
    short = [Piece.around(points) for points in halves]
    whole = covering(short, triangles)
    samples = np.concatenate((ball.vertices, triangles.mean(axis=1)))
    assert farthest_out(samples, short) > 0.04
    assert farthest_out(samples, whole) < 2 * SHEET
    for before, after in zip(short, whole, strict=True):
        assert farthest_out(before.vertices, [after]) < 1e-9


def test_pieces_that_reach_to_the_surface_stay_as_they_are() -> None:
    cube = trimesh.creation.box()
    pieces = [block((-0.5, -0.5, -0.5), (0, 0.5, 0.5)), block((0, -0.5, -0.5), (0.5, 0.5, 0.5))]
    assert all(
        after is before
        for before, after in zip(pieces, covering(pieces, np.asarray(cube.triangles)), strict=True)
    )


def farthest_out(points: Floats, pieces: list[Piece]) -> float:
    """How far the farthest point is from the nearest piece, at least."""
    out = [(points @ p.planes[:, :3].T + p.planes[:, 3]).max(axis=1) for p in pieces]
    return float(np.min(out, axis=0).max())
