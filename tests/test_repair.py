"""Repairs: each is counted, and the rest of the mesh is unchanged."""

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.geometry.repair import MAX_HOLE, Repairs, repair_mesh
from packit_sim.geometry.shapes import Shape


def turned(mesh: trimesh.Trimesh, triangles: list[int]) -> trimesh.Trimesh:
    faces = mesh.faces.copy()
    faces[triangles] = faces[triangles, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def repaired(mesh: trimesh.Trimesh) -> tuple[Shape, Repairs]:
    return Shape.repaired(mesh, "it", "thing")


def test_a_good_mesh_is_left_alone() -> None:
    ball = creation.icosphere(subdivisions=2)
    shape, repairs = repaired(ball)
    assert not repairs and repairs == Repairs()
    assert shape.digest == Shape.from_mesh(ball, "it").digest


def test_what_is_cleaned_away_is_counted() -> None:
    block = creation.box((1, 2, 3))
    loose = trimesh.Trimesh(
        block.triangles.reshape(-1, 3), np.arange(36).reshape(12, 3), process=False
    )
    shape, repairs = repaired(loose)
    assert repairs == Repairs(merged_vertices=28) and shape.is_solid
    faces = np.concatenate([block.faces, block.faces[:3, [1, 2, 0]], [[0, 0, 1], [4, 5, 4]]])
    shape, repairs = repaired(trimesh.Trimesh(block.vertices, faces, process=False))
    assert repairs == Repairs(duplicate_triangles=3, flat_triangles=2) and shape.is_solid


@pytest.mark.parametrize("count", [1, 5, 100, 315])
def test_flipped_triangles_are_turned_back(count: int) -> None:
    ball = creation.icosphere(subdivisions=2)
    chosen = np.random.default_rng(count).permutation(len(ball.faces))[:count].tolist()
    shape, repairs = repaired(turned(ball, chosen))
    assert shape.is_solid and repairs.flipped_triangles == count
    assert shape.volume == pytest.approx(Shape.from_mesh(ball, "it").volume)
    assert not Shape.from_mesh(turned(ball, chosen), "it").is_solid


def test_each_part_is_turned_by_itself() -> None:
    ball, sheet = creation.icosphere(subdivisions=1), creation.box((1, 2, 3))
    sheet.update_faces(np.arange(12) > 1)
    mesh = trimesh.util.concatenate(
        [turned(ball, [3]), turned(sheet.apply_translation((5, 0, 0)), [4, 5])]
    )
    whole, repairs = repair_mesh(mesh)
    assert repairs.flipped_triangles == 3 and whole.is_winding_consistent
    assert (whole.faces[80:] == sheet.faces + ball.vertices.shape[0]).all()


def test_a_moebius_strip_has_no_two_sides_to_choose_from() -> None:
    turns = np.linspace(0, np.pi, 40, endpoint=False)
    middle = np.column_stack([np.cos(2 * turns), np.sin(2 * turns), 0 * turns])
    across = 0.3 * np.column_stack(
        [np.cos(turns) * np.cos(2 * turns), np.cos(turns) * np.sin(2 * turns), np.sin(turns)]
    )
    vertices = np.concatenate([middle - across, middle + across])
    n, after = np.arange(40), (np.arange(40) + 1) % 40
    low, high = after.copy(), after + 40
    low[-1], high[-1] = 40, 0
    faces = np.concatenate(
        [np.column_stack([n, low, n + 40]), np.column_stack([low, high, n + 40])]
    )
    strip = trimesh.Trimesh(vertices, faces, process=False)
    assert not strip.is_winding_consistent
    whole, repairs = repair_mesh(strip)
    assert not repairs and (whole.faces == strip.faces).all()


def test_small_holes_are_filled_and_large_ones_are_not() -> None:
    ball = creation.icosphere(subdivisions=6)
    near_pole = (ball.faces == 0).any(axis=1)
    holed = ball.copy()
    holed.update_faces(~near_pole)
    shape, repairs = repaired(holed)
    assert repairs == Repairs(filled_holes=1) and shape.is_solid
    assert shape.volume == pytest.approx(Shape.from_mesh(ball, "it").volume, rel=1e-3)
    assert near_pole.sum() == 5

    open_box = creation.box((1, 1, 1))
    open_box.update_faces(open_box.face_normals[:, 2] < 0.5)
    shape, repairs = repaired(open_box)
    assert not repairs and not shape.mesh.is_watertight
    whole, repairs = repair_mesh(open_box, max_hole=1.0)
    assert repairs == Repairs(filled_holes=1) and whole.is_volume
    assert MAX_HOLE < 0.1
