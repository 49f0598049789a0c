"""Motions and their conversions."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import transformations

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry import motions, rotations
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import IDENTITY, Motion

PLACE = np.array((0.1, 0.2, 0.3))

LENGTHS = st.tuples(*[st.floats(-100, 100)] * 3).map(np.array)


@st.composite
def moves(draw: st.DrawFn) -> Motion:
    turns: npt.NDArray[np.float64] = np.array(draw(st.tuples(*[st.floats(0, 1)] * 3)))
    matrix = transformations.random_rotation_matrix(turns)
    matrix[:3, 3] = draw(LENGTHS)
    return Motion.from_matrix(matrix)


def by_matrix(matrix: Floats, point: Floats) -> Floats:
    """Map a point by a matrix of 4 x 4, the plain way."""
    return np.asarray((matrix @ np.append(point, 1))[:3])


@given(moves(), moves(), LENGTHS)
def test_motions_agree_with_matrices(one: Motion, other: Motion, point: Floats) -> None:
    assert np.array_equal((one @ other).matrix, one.matrix @ other.matrix)
    assert np.allclose(one.inverse().matrix, np.linalg.inv(one.matrix), atol=1e-9)
    assert np.allclose(other.seen_from(one).matrix, (one.inverse() @ other).matrix, atol=1e-9)
    assert np.allclose(one.apply(point), by_matrix(one.matrix, point), atol=1e-9)
    assert np.allclose(one.inverse().apply(one.apply(point)), point, atol=1e-9)
    assert np.allclose((one @ other).apply(point), one.apply(other.apply(point)), atol=1e-9)
    assert np.allclose(one.direction(point), one.apply(point) - one.translation, atol=1e-9)
    assert np.allclose(one.apply(np.array((point, PLACE)))[0], one.apply(point), atol=1e-9)
    assert np.array_equal(one.shifted(point).translation, one.translation + point)
    assert one.at(point).translation.tolist() == point.tolist()
    assert one.at(one.translation) == one and hash(one.at(one.translation)) == hash(one)


@given(moves(), st.floats(1e-3, 1e3))
def test_a_scale_is_separate(motion: Motion, scale: float) -> None:
    found, factor = motions.motion_and_scale(motion.scaled(scale))
    assert math.isclose(factor, scale, rel_tol=1e-9)
    assert np.allclose(found.matrix, motion.matrix, atol=1e-9)
    again = Motion.from_matrix(motion.scaled(scale), scale)
    assert np.allclose(again.matrix, motion.matrix, atol=1e-9)
    assert motions.matrix_fault(motion.scaled(scale)) is None


@given(moves())
def test_without_a_scale_a_matrix_is_kept(motion: Motion) -> None:
    found, scale = motions.motion_and_scale(motion.matrix)
    assert found == motion and scale == 1


@given(moves())
def test_quaternions(motion: Motion) -> None:
    w, x, y, z = motion.wxyz
    assert motion.xyzw == (x, y, z, w)
    back = Motion.from_xyzw(motion.xyzw, motion.translation)
    assert back.wxyz == motion.wxyz and back.at(PLACE).wxyz == motion.wxyz
    assert np.allclose(back.matrix, motion.matrix, atol=1e-9)


def test_a_quaternion_that_is_given_is_kept() -> None:
    rounded = (0.7071, 0.7071, 0.0, 0.0)
    assert Motion.from_wxyz(rounded, PLACE).at(2 * PLACE).wxyz == rounded
    with pytest.raises(ArgumentError, match="of length 2 is no rotation"):
        Motion.from_wxyz((2.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("rotation", range(rotations.COUNT))
def test_the_24_rotations_are_exact(rotation: int) -> None:
    motion = Motion.turn(rotation, PLACE)
    assert np.array_equal(motion.rotation, rotations.MATRICES[rotation])
    assert np.array_equal(motion.direction(PLACE), rotations.turn_vectors(PLACE, rotation))
    assert motion.inverse() @ motion == IDENTITY
    assert np.array_equal(motion.inverse().rotation, rotations.MATRICES[rotation].T)
    w, x, y, z = motion.wxyz
    again = Motion.from_wxyz((w, x, y, z), PLACE)
    assert np.allclose(again.matrix, motion.matrix, atol=1e-12)


def test_motions_can_not_be_changed() -> None:
    place = PLACE.copy()
    motion = Motion.shift(place)
    place[0] = 5
    for array in (motion.matrix, motion.rotation, motion.translation):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    assert motion.translation.tolist() == PLACE.tolist()


@pytest.mark.parametrize(
    "linear", [2 * np.eye(3), np.diag((1, 1, -1)), np.full((3, 3), np.nan), np.eye(3) + 1e-3]
)
def test_other_matrices_are_no_rotations(linear: Floats) -> None:
    with pytest.raises(ArgumentError, match="is no rotation matrix"):
        Motion(linear)


def test_the_angle_is_in_degrees() -> None:
    slope = transformations.rotation_matrix(math.radians(15), (0, 1, 0))
    assert math.isclose(Motion.from_matrix(slope).angle, 15)
    assert IDENTITY.angle == 0
    tiny = Motion.from_wxyz((1.0, 1e-9, 0.0, 0.0), np.zeros(3))
    assert math.isclose(math.radians(tiny.angle), 2e-9)


def test_interpolation_is_straight_and_turns_evenly() -> None:
    quarter = transformations.rotation_matrix(np.pi / 2, (0, 0, 1))
    end = Motion.from_matrix(quarter).at(PLACE)
    middle = IDENTITY.interpolate(end, 0.5)
    eighth = transformations.rotation_matrix(np.pi / 4, (0, 0, 1))
    assert np.allclose(middle.matrix, Motion.from_matrix(eighth).at(PLACE / 2).matrix)
    for share, pose in ((0, IDENTITY), (1, end)):
        assert np.allclose(IDENTITY.interpolate(end, share).matrix, pose.matrix)
