"""Poses and their conversions."""

import numpy as np
import pytest
from trimesh import transformations

from packit_sim.geometry import rotations
from packit_sim.geometry.poses import Pose

POSITION = np.array((0.1, 0.2, 0.3))


@pytest.mark.parametrize("seed", range(5))
def test_matrices_and_quaternions_agree(seed: int) -> None:
    matrix = transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    matrix[:3, 3] = POSITION
    pose = Pose.from_matrix(matrix)
    points = np.random.default_rng(seed).random((4, 3))
    expected = points @ matrix[:3, :3].T + POSITION
    assert np.allclose(pose.axes, matrix[:3, :3]) and np.array_equal(pose.position, POSITION)
    assert np.allclose(pose.apply(points), expected)
    w, x, y, z = pose.wxyz
    assert pose.xyzw == (x, y, z, w)
    assert Pose.from_xyzw(POSITION, pose.xyzw).wxyz == pose.wxyz


def test_a_scaled_matrix_has_the_same_rotation() -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = 2.5 * rotations.MATRICES[7]
    assert np.allclose(Pose.from_matrix(matrix, 2.5).axes, rotations.MATRICES[7])


@pytest.mark.parametrize("rotation", range(rotations.COUNT))
def test_the_24_rotations(rotation: int) -> None:
    pose = Pose.from_rotation(POSITION, rotation)
    assert np.allclose(pose.axes, rotations.MATRICES[rotation], atol=1e-12)


def test_interpolation_is_straight_and_turns_evenly() -> None:
    start = Pose(np.zeros(3))
    quarter = transformations.rotation_matrix(np.pi / 2, (0, 0, 1))
    end = Pose.from_axes(POSITION, quarter[:3, :3])
    middle = start.interpolate(end, 0.5)
    eighth = transformations.rotation_matrix(np.pi / 4, (0, 0, 1))
    assert np.allclose(middle.position, POSITION / 2) and np.allclose(middle.axes, eighth[:3, :3])
    for share, pose in ((0, start), (1, end)):
        there = start.interpolate(end, share)
        assert np.allclose(there.position, pose.position) and np.allclose(there.wxyz, pose.wxyz)
