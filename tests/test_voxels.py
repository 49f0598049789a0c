"""Outer and inner fine cells compared with their definitions in numpy and scipy."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from packit_sim.geometry import rotations, voxels
from packit_sim.geometry.lattice import CELL, CONTACT_TOLERANCE, FINE, STEP
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.geometry.voxelization import lattice_cells, solid_volume_bounds
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from packit_sim.geometry.voxels import Voxels
from packit_sim.libraries.library import ShapeLibrary
from tests.zoo import BALL, BOWL, CUBE, HOLLOW, PLATE, RING, ZOO, cube_of


def plain_touched(item: Item) -> np.ndarray:
    """Every triangle against every fine cell, by the separating-axis theorem."""
    shape = tuple(4 * c for c in item.cells)
    half = FINE / 2 + CONTACT_TOLERANCE / 2
    centers = [(np.arange(n) + 0.5 - n / 2) * FINE for n in shape]
    grid = np.stack(np.meshgrid(*centers, indexing="ij"), axis=-1)
    touched = np.zeros(shape, dtype=bool)
    for triangle in item.mesh.triangles:
        edges = triangle[[1, 2, 0]] - triangle
        axes = [*np.eye(3), np.cross(edges[0], edges[1])]
        axes += [np.cross(unit, edge) for unit, edge in itertools.product(np.eye(3), edges)]
        meets = np.ones(shape, dtype=bool)
        for axis in axes:
            spans = triangle @ axis
            at, reach = grid @ axis, half * np.abs(axis).sum()
            meets &= (at + reach >= spans.min()) & (at - reach <= spans.max())
        touched |= meets
    return touched


def plain_enclosed(touched: np.ndarray) -> np.ndarray:
    return ndimage.binary_fill_holes(touched) & ~touched


@pytest.mark.parametrize("shape", ZOO, ids=lambda s: s.id)
def test_fine_cells_are_those_of_the_definition(shape) -> None:
    item = Item(shape, scale=0.07**3)
    touched = plain_touched(item)
    enclosed = plain_enclosed(touched)
    assert (item.voxels.outer_fine == (touched | enclosed)).all()
    assert (item.voxels.inner_fine == enclosed).all()


@pytest.mark.parametrize("shape", ZOO, ids=lambda s: s.id)
def test_enclosed_cells_of_a_larger_item(shape) -> None:
    found = Item(shape, scale=0.5**3).voxels
    touched = found.outer_fine & ~found.inner_fine
    assert (found.inner_fine == plain_enclosed(touched)).all()


@given(st.sampled_from(ZOO), st.floats(0.05, 0.4))
def test_cells_follow_from_fine_cells(shape, size) -> None:
    item = Item(shape, size**3)
    x, y, z = item.cells
    by_cell = (x, 4, y, 4, z, 4)
    assert item.outer.shape == item.inner.shape == item.cells
    assert (item.outer == item.voxels.outer_fine.reshape(by_cell).any(axis=(1, 3, 5))).all()
    assert (item.inner == item.voxels.inner_fine.reshape(by_cell).all(axis=(1, 3, 5))).all()


@pytest.mark.slow
@given(st.sampled_from(ZOO), st.floats(0.05, 0.4), st.integers(0, 23))
def test_cells_turn_with_the_item(shape, size, rotation) -> None:
    upright, turned = Item(shape, size**3), Item(shape, size**3, rotation)
    anew = Voxels.of(turned.mesh.triangles, turned.cells)
    for kind in ("outer_fine", "inner_fine", "outer_cells", "inner_cells"):
        expected = rotations.turn_array(getattr(upright.voxels, kind), rotation)
        assert (getattr(turned.voxels, kind) == expected).all()
        assert (getattr(anew, kind) == expected).all()


def test_a_cube_of_whole_cells_fills_them() -> None:
    item = cube_of(8)
    assert item.cells == (8, 8, 8)
    assert item.outer.all()
    assert item.inner.sum() == 6**3
    assert item.voxels.inner_fine.sum() == 30**3


def bits(words: np.ndarray) -> np.ndarray:
    """The fine cells of words [x, y, z]."""
    cells = np.unpackbits(words.view(np.uint8), bitorder="little").reshape(*words.shape, 4, 4, 4)
    return cells.transpose(0, 3, 1, 4, 2, 5).reshape([4 * n for n in words.shape]).astype(bool)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 4), (4, 3, 2), (3, 5, 3)], ids=str)
def test_the_flood_from_outside_finds_its_way_through_a_maze(shape) -> None:
    """In random cells, ways go to all six sides within words and between them."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        masks = rng.integers(2**64, size=(3, *shape), dtype=np.uint64)
        touched = masks[0] & (masks[1] | masks[2]) | masks[1] & masks[2]
        touched |= rng.integers(2**64, size=shape, dtype=np.uint64) & masks[0]
        labels, _ = ndimage.label(~bits(touched))
        border = np.concatenate([labels.take((0, -1), axis).ravel() for axis in range(3)])
        expected = np.isin(labels, border[border > 0])
        assert (bits(reached_cells(touched)) == expected).all()
        assert not (touched & reached_cells(touched)).any()


INTERPRETED = """
import numpy as np
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from tests.zoo import ZOO
assert not hasattr(touched_cells, "py_func")
for shape in ZOO[::3]:
    touched = touched_cells(shape.mesh.triangles[:20] * 0.04, np.array((4, 4, 4)), 0.01, 1e-5)
    print(touched.tolist(), reached_cells(touched).tolist())
"""


@pytest.mark.slow
def test_kernels_stay_within_their_arrays() -> None:
    """Compiled code does not check indices; the same code, interpreted, does."""
    run = subprocess.run(
        [sys.executable, "-c", INTERPRETED],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    for shape, line in zip(ZOO[::3], run.stdout.splitlines(), strict=True):
        touched = touched_cells(shape.mesh.triangles[:20] * 0.04, np.array((4, 4, 4)), 0.01, 1e-5)
        assert line == f"{touched.tolist()} {reached_cells(touched).tolist()}"


def test_cells_on_the_lattice_begin_at_the_node_below_the_lowest_corner() -> None:
    """A single triangle: each axis has its lowest coordinate in another corner."""
    triangle = np.array([[[0.11, 0.95, 0.78], [0.31, 0.53, 0.93], [0.27, 0.73, 0.61]]])
    start, touched, _ = lattice_cells(triangle)
    assert start.tolist() == [8, 52, 60]
    assert touched[:STEP].any() and touched[:, :STEP].any() and touched[:, :, :STEP].any()
    just_above = triangle - triangle.min(axis=1) + STEP * CELL + 0.4 * CONTACT_TOLERANCE
    assert lattice_cells(just_above)[0].tolist() == [0, 0, 0]  # cells are grown by half of it


def test_cells_can_not_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Item(BALL, 0.1).voxels.outer_fine[0, 0, 0] = True


def test_what_is_open_encloses_nothing_and_a_cavity_does() -> None:
    assert not Item(BOWL, 0.02).inner.any()
    assert not Item(PLATE, 0.02).inner.any()
    hollow = Item(HOLLOW, 0.02)
    assert hollow.outer.all() and hollow.inner[tuple(c // 2 for c in hollow.cells)]
    ring = Item(RING, 0.02)
    assert not ring.outer[tuple(c // 2 for c in ring.cells)]


@pytest.mark.parametrize("shape", [CUBE, BALL, RING], ids=lambda s: s.id)
def test_volume_by_voxels_is_near_the_exact_one(shape) -> None:
    exact = shape.mesh.volume
    assert sum(shape.volume_bounds) / 2 == pytest.approx(exact, rel=0.005)


@pytest.mark.slow
def test_volumes_by_voxels_of_real_closed_bodies_are_within_their_bounds() -> None:
    """Off by half the touched voxels at most, and by very little unless walls are thin."""
    library = ShapeLibrary.open("everyday")
    solids = [library[id] for id in library if library.info(id).solid]
    assert len(solids) >= 50
    errors = []
    for shape in solids:
        low, high = solid_volume_bounds(shape.mesh.triangles)
        assert low <= shape.mesh.volume <= high, shape
        errors.append(abs((low + high) / 2 / shape.mesh.volume - 1))
    assert np.median(errors) < 0.003 and np.quantile(errors, 0.85) < 0.03


def test_parts_that_overlap_count_once() -> None:
    ball, block = BALL.mesh.copy(), CUBE.mesh.copy()
    ball.apply_translation((0.2, 0.1, 0))
    union = trimesh.boolean.union([ball, block], engine="manifold")
    both = Shape.from_mesh(trimesh.util.concatenate([ball, block]), "both")
    assert not both.is_solid
    scale = np.linalg.norm(union.extents)
    assert both.volume == pytest.approx(union.volume / scale**3, rel=0.005)
    assert both.volume < 0.9 * (ball.volume + block.volume) / scale**3


def test_a_closed_cavity_counts_as_solid() -> None:
    """But for half the voxels that its walls touch: less than 1%."""
    assert HOLLOW.volume == pytest.approx(3**-1.5, rel=0.01)


def test_an_item_too_large_to_voxelise_is_refused_before_any_work() -> None:
    with pytest.raises(ValueError, match="at most 512"):
        _ = Item(CUBE, 1000.0).outer


def test_centred_keeps_what_is_inside_and_refuses_what_is_too_large() -> None:
    cells = np.ones((2, 3, 4), dtype=bool)
    padded = voxels.centred(cells, (6, 6, 6))
    assert padded.sum() == 24 and padded[2:4, 1:4, 1:5].all()
    with pytest.raises(ValueError, match="do not fit"):
        voxels.centred(cells, (3, 3, 3))
