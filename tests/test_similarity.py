"""Which shapes are the same object."""

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.geometry import rotations
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.similarity import SAME, near_duplicates


def _table(leg: float = 0.08, height: float = 0.7) -> trimesh.Trimesh:
    """A table whose four legs stand at odd places: no rotation or mirror image is another."""
    top = creation.box((1.2, 0.8, 0.06))
    parts = [top]
    for x, y in ((-0.5, -0.3), (0.5, -0.35), (0.45, 0.3), (-0.2, 0.3)):
        part = creation.box((leg, leg, height))
        part.apply_translation((x, y, -height / 2))
        parts.append(part)
    return trimesh.util.concatenate(parts)


def shape(mesh: trimesh.Trimesh) -> Shape:
    return Shape.from_mesh(mesh, "shape")


def turned(mesh: trimesh.Trimesh, rotation: int) -> trimesh.Trimesh:
    vertices = rotations.turn_vectors(mesh.vertices, rotation)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


TABLE = _table()
RING = creation.torus(0.5, 0.15, major_sections=48, minor_sections=24)
BALL = creation.icosphere(subdivisions=4)
CONE = creation.cone(0.5, 1.0, sections=48)
STEPS = trimesh.util.concatenate(
    [creation.box(bounds=[(0, 0, 0), (1 - 0.25 * n, 0.6, 0.2 * (n + 1))]) for n in range(4)]
)
OBJECTS = (TABLE, RING, BALL, CONE, STEPS)


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [TABLE, STEPS])
def test_rotations_and_mirror_images_are_the_same(mesh: trimesh.Trimesh) -> None:
    copies = [turned(mesh, rotation) for rotation in range(rotations.COUNT)]
    mirrored = mesh.copy().apply_transform(np.diag((-1, 1, 1, 1)))
    copies += [turned(mirrored, rotation) for rotation in (0, 7, 22)]
    assert set(near_duplicates([shape(copy) for copy in copies])) == {0}


@pytest.mark.parametrize(
    "copy",
    [
        TABLE.subdivide().subdivide(),
        TABLE.copy().apply_transform(np.diag((1.01, 1, 0.99, 1))),
        TABLE.copy().apply_scale(17),
        _table(leg=0.085),
    ],
    ids=["finer", "stretched", "larger", "thicker legs"],
)
def test_slightly_other_copies_are_the_same(copy: trimesh.Trimesh) -> None:
    assert near_duplicates([shape(TABLE), shape(copy)]) == [0, 0]


def test_coarser_copies_are_the_same() -> None:
    coarse = creation.torus(0.5, 0.15, major_sections=32, minor_sections=16)
    assert near_duplicates([shape(RING), shape(coarse)]) == [0, 0]
    assert near_duplicates([shape(BALL), shape(creation.icosphere(subdivisions=3))]) == [0, 0]


def test_others_are_not() -> None:
    assert near_duplicates([shape(mesh) for mesh in OBJECTS]) == [0, 1, 2, 3, 4]


def test_the_same_extents_are_not_enough() -> None:
    block = creation.box(STEPS.extents)
    assert near_duplicates([shape(STEPS), shape(block)]) == [0, 1]
    assert near_duplicates([shape(creation.box((1, 1, 1))), shape(BALL)]) == [0, 1]


def test_flat_shapes_are_not_the_same_for_being_flat() -> None:
    """Both of their surfaces are within the limit for others, everywhere."""
    height = 2 * SAME
    plate = creation.box((1, 0.7, height))
    wedge = trimesh.convex.convex_hull(
        [(x, y, z) for x in (0, 1) for y in (0, 0.7) for z in (0, height * (1 - 0.9 * x))]
    )
    assert near_duplicates([shape(plate), shape(wedge)]) == [0, 1]


def test_groups_are_what_is_connected() -> None:
    chain = [shape(TABLE.copy().apply_transform(np.diag((s, 1, 1, 1)))) for s in (1, 1.02, 1.04)]
    assert near_duplicates(chain) == [0, 0, 0]


def test_the_order_does_not_matter() -> None:
    meshes = [copy for mesh in OBJECTS for copy in (mesh, turned(mesh, 9), turned(mesh, 14))]
    order = np.random.default_rng(0).permutation(len(meshes))
    found = near_duplicates([shape(meshes[n]) for n in order])
    assert list(dict.fromkeys(found)) == list(range(len(OBJECTS)))
    assert {frozenset(order[np.array(found) == number] // 3) for number in found} == {
        frozenset([n]) for n in range(len(OBJECTS))
    }


def test_none_and_one() -> None:
    assert near_duplicates([]) == []
    assert near_duplicates([shape(TABLE)]) == [0]
