"""Estimates of how deep items overlap: fields of voxels, and points in signed distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage, signal
from trimesh import creation

from packit_sim import ItemType
from packit_sim.core.compilation import kernel
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.rotations import MATRICES
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.distance_kernels import STEPS, least_distance
from packit_sim.parts.nesting.field_kernels import BIAS, REACH, decoded, fill_field
from packit_sim.parts.nesting.pose_kernels import list_near
from packit_sim.parts.nesting.problem import Distances, state_of


@kernel
def field(one, other, clearance, out, distances):
    """Fill a field, and decode it."""
    fill_field(one, other, clearance, out)
    for x in range(out.shape[0]):
        for y in range(out.shape[1]):
            for z in range(out.shape[2]):
                distances[x, y, z] = decoded(np.int64(out[x, y, z]))


@kernel
def least(distances, first, other, turn, place):
    return least_distance(distances, first, other, turn, place[0], place[1], place[2])


@pytest.mark.parametrize("clearance", [0.0, 2.3])
def test_a_field_has_the_distances_to_the_boundary_of_all_overlaps(clearance: float) -> None:
    rng = np.random.default_rng(0)
    one, other = (ndimage.binary_dilation(rng.random(n) < 0.02) for n in ((9, 7, 70), (5, 8, 11)))
    around = math.ceil(clearance) + REACH
    shape = tuple(a + b - 1 + 2 * around for a, b in zip(one.shape, other.shape, strict=True))
    found = np.empty(shape)
    bits = [np.ascontiguousarray(each, np.uint8) for each in (one, other)]
    field(*bits, clearance, np.empty(shape, np.int16), found)
    mirrored = other[::-1, ::-1, ::-1].astype(float)
    overlap = np.pad(signal.fftconvolve(one.astype(float), mirrored) > 0.5, around)
    inside, outside = (ndimage.distance_transform_edt(each) for each in (overlap, ~overlap))
    true = np.where(overlap, 0.5 - inside, np.minimum(outside, around + 1) - 0.5)
    assert np.abs(found - (true + BIAS - clearance)).max() < 0.01
    assert inside.max() > 3


def estimated(distances: Distances, turn: Floats, place: Floats) -> float:
    """Return the least distance of the points of two types, by an interpolation of SciPy."""
    turns = (turn, place), (turn.T, -turn.T @ place)
    lowest = [distances.margin]
    for around, (rotation, shift) in enumerate(turns):
        dims, start = distances.dims[around], distances.starts[around]
        values = distances.values[start : start + dims.prod()].reshape(dims)
        cell, inside = distances.cells[around], 1 - around
        first, last = distances.point_starts[inside : inside + 2]
        points = distances.points[first:last] @ rotation.T + shift
        at = (points / cell + (dims - 1) / 2).T
        own = ndimage.map_coordinates(values.astype(float), at, order=1, cval=np.inf)
        lowest.append(float(own[np.isfinite(own)].min(initial=np.inf)) * cell / STEPS)
    return min(lowest)


def test_the_least_distance_of_points_and_its_gradient() -> None:
    ring = creation.annulus(r_min=0.8, r_max=1.4, height=0.9, sections=24)
    meshes = ring, creation.cone(radius=0.9, height=2.2, sections=16)
    types = [ItemType(f"{n}", mesh.vertices, mesh.faces) for n, mesh in enumerate(meshes)]
    distances = build(types, 6.0, 0.1, by_cells=True).distances
    rng = np.random.default_rng(1)
    signs = set()
    for _ in range(60):
        turn = MATRICES[rng.integers(24)].astype(float)
        place = rng.uniform(-1.4, 1.4, 3)
        found, *gradient = least(distances, 0, 1, turn, place)
        assert found == pytest.approx(estimated(distances, turn, place), abs=1e-6)
        signs.add(found < 0)
        step = 1e-6
        for axis, slope in enumerate(gradient):
            shift = np.eye(3)[axis] * step
            more, less = (least(distances, 0, 1, turn, place + s)[0] for s in (shift, -shift))
            if abs(more + less - 2 * found) < 1e-9:  # the same cell and point on both sides
                assert slope == pytest.approx((more - less) / (2 * step), abs=1e-4)
    assert signs == {True, False}


@kernel
def _near(state, bounds, i, low, high):
    return list_near(state, bounds, i, (low[0], low[1], low[2]), (high[0], high[1], high[2]))


@pytest.mark.parametrize("kind", [float, np.int32])
@pytest.mark.parametrize("count", [1, 7, 8, 100])
def test_near_items_are_all_others_whose_bounds_share_space_with_a_box(count, kind) -> None:
    rng = np.random.default_rng(count)
    low = rng.integers(0, 10, (count, 3))
    bounds = np.asfortranarray(np.hstack((low, low + rng.integers(1, 5, (count, 3)))), dtype=kind)
    bounds[count // 2 :: 5] = np.array([1e9] * 3 + [-1e9] * 3)  # taken out
    found = 0
    for i in range(count):
        start = rng.integers(0, 10, 3)
        box = np.array((start, start + rng.integers(1, 5, 3)), dtype=kind)
        shared = (bounds[:, 3:] > box[0]) & (bounds[:, :3] < box[1])
        expected = [j for j in np.flatnonzero(shared.all(axis=1)).tolist() if j != i]
        state = state_of([0] * count, count)
        number = _near(state, bounds, i, *box)
        assert state.near[:number].tolist() == expected == np.flatnonzero(state.meets).tolist()
        found += number
    assert found > 0 or count == 1
