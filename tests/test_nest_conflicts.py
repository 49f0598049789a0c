"""Conflicts and distances of two items by their surfaces."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from trimesh import creation
from trimesh.collision import CollisionManager

from packit_sim.core.compilation import kernel
from packit_sim.parts.nesting import overlap_kernels
from packit_sim.parts.nesting.build import build
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.item_types import ItemType

BOWL = trimesh.boolean.difference(
    [
        creation.cylinder(1, 1),
        creation.cylinder(
            0.8, 1, transform=trimesh.transformations.translation_matrix((0, 0, 0.2))
        ),
    ],
    engine="manifold",
)

MESHES = {
    "box": creation.box((1, 2, 3)),
    "prism": creation.cylinder(1, 4, sections=7),
    "plate": creation.box((2, 1, 0.01)),
    "ball": creation.icosphere(2),
    "bowl": BOWL,
}

TRIES = 15

UNIT = 10.0

in_conflict = overlap_kernels.in_conflict
cross = overlap_kernels.cross_at_shift
distance = overlap_kernels.distance_at_shift


@kernel
def conflict(problem, kind, identity, x, y, z):
    """Return whether an item is in conflict with an equal one at an offset."""
    return in_conflict(problem, kind, kind, identity, x, y, z, True)


@kernel
def gap(problem, first, other, rel, x, y, z, limit):
    """Return the distance of two surfaces at an offset, at most the limit; 0 if they cross."""
    problem.shift[0], problem.shift[1], problem.shift[2] = x, y, z
    if cross(problem, first, other, rel):
        return 0.0
    return distance(problem, first, other, rel, limit)


@pytest.fixture(scope="module")
def problem():
    types = [ItemType(name, mesh.vertices, mesh.faces) for name, mesh in MESHES.items()]
    return build(types, UNIT, 0.0)


@pytest.mark.parametrize("kind", range(len(MESHES)), ids=list(MESHES))
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0, 1.001])
def test_equal_items_are_in_conflict_until_they_are_beside_each_other(problem, kind, share) -> None:
    extents = list(MESHES.values())[kind].extents
    for offset in share * extents * [[1, 0, 0], [0, 1, 0], [0, 0, 1]]:
        assert conflict(problem, kind, problem.lookup.identity, *offset) == (share < 1)


@pytest.mark.parametrize("first", range(len(MESHES)), ids=list(MESHES))
@pytest.mark.parametrize("other", range(len(MESHES)), ids=list(MESHES))
def test_distances_are_those_of_fcl_and_at_most_the_limit(problem, first, other) -> None:
    meshes = list(MESHES.values())
    one, two = meshes[first], meshes[other]
    drawn_in = 2 * checked_items.tolerance(UNIT, max(one.extents.max(), two.extents.max()))
    rng = np.random.default_rng([first, other])
    crossing = 0
    for _ in range(TRIES):
        rel = int(rng.integers(len(problem.relative_turns)))
        shift = rng.uniform(-0.6, 0.6, 3) * (one.extents + two.extents)
        pose = np.eye(4)
        pose[:3, :3] = problem.relative_turns[rel]
        pose[:3, 3] = shift - pose[:3, :3] @ two.bounds.mean(axis=0)
        manager = CollisionManager()
        manager.add_object("one", one.copy().apply_translation(-one.bounds.mean(axis=0)))
        expected = max(0.0, manager.min_distance_single(two, pose))
        found = gap(problem, first, other, rel, *shift, 1e9)
        assert found == pytest.approx(expected, abs=drawn_in)
        assert gap(problem, first, other, rel, *shift, 0.5) == pytest.approx(min(found, 0.5))
        crossing += found == 0
    assert 0 < crossing < TRIES
