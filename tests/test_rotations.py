import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.geometry import rotations

indices = st.integers(0, rotations.COUNT - 1)


def test_they_are_24_distinct_proper_rotations() -> None:
    assert len({m.tobytes() for m in rotations.MATRICES}) == 24
    for matrix in rotations.MATRICES:
        assert round(np.linalg.det(matrix)) == 1
        assert (matrix @ matrix.T == np.eye(3)).all()


def test_index_0_is_the_identity_and_turns_are_about_z() -> None:
    assert (rotations.MATRICES[0] == np.eye(3)).all()
    quarter = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for index in range(24):
        face, turn = divmod(index, 4)
        expected = np.linalg.matrix_power(quarter, turn) @ rotations.MATRICES[4 * face]
        assert (rotations.MATRICES[index] == expected).all()


def test_each_face_looks_down_for_its_four_turns() -> None:
    normals = [(0, 0, -1), (0, 0, 1), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    for index, matrix in enumerate(rotations.MATRICES):
        assert (matrix @ normals[index // 4] == (0, 0, -1)).all()


@given(indices, indices)
def test_they_are_closed(a: int, b: int) -> None:
    product = rotations.MATRICES[a] @ rotations.MATRICES[b]
    assert (product == rotations.MATRICES).all(axis=(1, 2)).sum() == 1


@given(indices)
def test_vectors_extents_and_arrays_turn_alike(index: int) -> None:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(9, 3))
    assert (rotations.turn_vectors(vectors, index) == vectors @ rotations.MATRICES[index].T).all()
    extents = np.array([1.0, 2.0, 3.0])
    assert (
        rotations.turn_extents(extents, index) == np.abs(rotations.MATRICES[index]) @ extents
    ).all()

    array = np.zeros((3, 4, 5), dtype=int)
    array[2, 0, 1] = 7
    turned = rotations.turn_array(array, index)
    middle = (np.array(array.shape) - 1) / 2
    new_middle = (np.array(turned.shape) - 1) / 2
    place = rotations.MATRICES[index] @ (np.array([2, 0, 1]) - middle) + new_middle
    assert turned[tuple(place.astype(int))] == 7


@given(st.permutations([0.3, 0.5, 0.7]))
def test_aligned_puts_the_smallest_up_and_the_largest_along_y(extents: list[float]) -> None:
    index = rotations.aligned(extents)
    assert rotations.turn_extents(np.array(extents), index).tolist() == [0.5, 0.7, 0.3]
    turned = [rotations.turn_extents(np.array(extents), n).tolist() for n in range(index)]
    assert [0.5, 0.7, 0.3] not in turned


def test_aligned_takes_the_lowest_index_where_extents_tie() -> None:
    assert rotations.aligned([0.5, 0.5, 0.5]) == 0
    assert rotations.aligned([0.5, 0.5 + 1e-12, 0.5 - 1e-12]) == 0
