import pickle

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.core.errors import MeshError
from packit_sim.geometry.shapes import Item, Shape
from tests.zoo import BALL, BOWL, CUBE, RING, SOUP, TILTED, ZOO

shapes = st.sampled_from(ZOO)
scales = st.sampled_from([0.25, 0.5, 1.0, 2.0, 4.0])
rotations = st.integers(0, 23)


@pytest.mark.parametrize("shape", ZOO, ids=lambda s: s.id)
def test_a_canonical_shape_is_centred_with_diagonal_1(shape: Shape) -> None:
    assert np.allclose(shape.mesh.bounds.sum(axis=0), 0, atol=1e-12)
    assert np.linalg.norm(shape.extents) == pytest.approx(1, abs=1e-12)


@given(shapes, scales, rotations)
def test_volume_and_extents_follow_scale_and_rotation(shape, scale, rotation) -> None:
    upright, item = Item(shape), Item(shape, scale, rotation)
    assert item.volume == pytest.approx(scale * upright.volume)
    assert np.allclose(item.extents, item.mesh.extents)
    assert sorted(item.extents) == pytest.approx(sorted(upright.extents * scale ** (1 / 3)))
    assert all(c >= e * 100 - 1e-6 for c, e in zip(item.cells, item.extents, strict=True))
    assert all(c < e * 100 + 1 for c, e in zip(item.cells, item.extents, strict=True))
    if shape.is_solid:
        assert item.mesh.volume == pytest.approx(item.volume)


@given(shapes, scales, rotations)
def test_an_item_is_its_shape_under_the_linear_map(shape, scale, rotation) -> None:
    item = Item(shape, scale, rotation)
    assert np.allclose(item.mesh.vertices, shape.mesh.vertices @ item.linear.T, atol=1e-15)


def test_y_up_meshes_are_turned() -> None:
    bottle = creation.box((1, 5, 2))
    bottle.vertices[bottle.vertices[:, 1] > 0, 0] *= 0.5  # narrower at the top, along y
    turned = Shape.from_mesh(bottle, "bottle", up="y")
    assert np.allclose(turned.extents * np.sqrt(30), (1, 2, 5))
    top = turned.mesh.vertices[turned.mesh.vertices[:, 2] > 0]
    assert np.ptp(top[:, 0]) == pytest.approx(np.ptp(turned.mesh.vertices[:, 0]) / 2)
    assert turned.mesh.volume > 0
    lying = trimesh.Trimesh(bottle.vertices[:, [1, 2, 0]], bottle.faces, process=False)
    assert np.allclose(Shape.from_mesh(lying, "bottle", up="x").extents, turned.extents[[1, 0, 2]])
    with pytest.raises(ValueError, match="up axis 'w' is not known: choose from x, y, z"):
        Shape.from_mesh(bottle, "bottle", up="w")


def test_solid_means_one_closed_body() -> None:
    assert CUBE.is_solid and BALL.is_solid and RING.is_solid and TILTED.is_solid
    assert not BOWL.is_solid and not SOUP.is_solid
    far = creation.box((1, 1, 1))
    far.apply_translation((3, 0, 0))
    assert not Shape.from_mesh(creation.box((1, 1, 1)) + far, "two").is_solid


def test_an_inside_out_body_is_turned_right_and_overlaps_count_once() -> None:
    inverted = creation.icosphere(subdivisions=3)
    inverted.invert()
    assert Shape.from_mesh(inverted, "ball").volume == pytest.approx(BALL.volume)
    twice = Shape.from_mesh(
        trimesh.util.concatenate([creation.box((1, 1, 1)), creation.box((0.9, 0.9, 1))]), "twice"
    )
    assert twice.volume == pytest.approx(CUBE.volume, rel=0.02)


def test_loose_triangle_soup_of_a_closed_body_is_merged() -> None:
    ball = creation.icosphere(subdivisions=2)
    loose = trimesh.Trimesh(
        ball.triangles.reshape(-1, 3), np.arange(3 * len(ball.faces)).reshape(-1, 3), process=False
    )
    assert not loose.is_watertight
    assert Shape.from_mesh(loose, "ball").is_solid


def test_the_given_mesh_is_left_alone() -> None:
    mesh = creation.box((2, 3, 4))
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    Shape.from_mesh(mesh, "box", up="y")
    assert (mesh.vertices == vertices).all() and (mesh.faces == faces).all()


def _with_vertex(value: float) -> trimesh.Trimesh:
    mesh = creation.box((1, 1, 1))
    mesh.vertices[3, 1] = value
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def _line() -> trimesh.Trimesh:
    return trimesh.Trimesh([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [[0, 1, 2]], process=False)


def _dangling() -> trimesh.Trimesh:
    mesh = creation.box((1, 1, 1))
    mesh.faces[0, 0] = 9
    return mesh


def test_stray_vertices_and_huge_coordinates_do_no_harm() -> None:
    box = creation.box((1, 2, 3))
    stray = np.concatenate([box.vertices, [(1e12, 0, 0), (np.nan, 0, 0)]])
    assert Shape.from_mesh(trimesh.Trimesh(stray, box.faces, process=False), "box").is_solid
    for factor in (1e300, 1e-300):
        far = trimesh.Trimesh(box.vertices * factor, box.faces, process=False)
        assert np.allclose(Shape.from_mesh(far, "box").extents * 14**0.5, (1, 2, 3))


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (trimesh.Trimesh(), "empty"),
        (trimesh.Trimesh(vertices=np.eye(3), faces=np.zeros((0, 3))), "0 triangles"),
        (_with_vertex(np.nan), "not finite.*number 3"),
        (_with_vertex(np.inf), "not finite"),
        (trimesh.Trimesh(np.ones((3, 3)), [[0, 1, 2]], process=False), "no extent along x and y"),
        (trimesh.Trimesh(np.eye(3)[:, [0, 1, 1]] * (1, 1, 0), [[0, 1, 2]]), "no extent along z"),
        (trimesh.Trimesh(np.eye(3)[[0, 0, 1]], [[0, 1, 2]], process=False), "no extent along z"),
        (_line(), "none of its 1 triangles has an area"),
        (_dangling(), "refer to vertices 0 to 9, the mesh has 0 to 7"),
        ("a path", "expected a trimesh.Trimesh, not str"),
        (trimesh.Scene(), "not Scene"),
    ],
)
def test_what_is_no_shape_is_refused_by_name(mesh, message) -> None:
    with pytest.raises(MeshError, match=f"'bad'.*{message}"):
        Shape.from_mesh(mesh, "bad")


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_impossible_scales_are_refused(scale) -> None:
    with pytest.raises(ValueError, match="scale"):
        Item(CUBE, scale)


@pytest.mark.parametrize("rotation", [-1, 24, 0.5, "up"])
def test_impossible_rotations_are_refused(rotation) -> None:
    with pytest.raises(ValueError, match="0 to 23"):
        Item(CUBE, 1.0, rotation)


def test_items_are_values() -> None:
    again = Shape.from_mesh(creation.box((1, 1, 1)), "cube")
    assert Item(CUBE, 1.0, 3) == Item(again, 1, np.int64(3)) != Item(CUBE, 1.0, 4)
    assert hash(Item(CUBE, 1.0, 3)) == hash(Item(again, 1.0, 3))
    assert CUBE != BALL and CUBE != "cube"


def test_a_pickled_shape_does_not_grow_with_what_was_derived_from_it() -> None:
    shape = Shape.from_mesh(creation.icosphere(subdivisions=3), "ball")
    small = len(pickle.dumps(shape))
    assert shape.is_solid and shape.parts and len(shape.mesh.face_adjacency) > 1000
    state = pickle.dumps(shape)
    assert len(state) < small + 1000
    again = pickle.loads(state)
    assert again == shape and again.volume == shape.volume
    assert (again.parts.closed == shape.parts.closed).all()
