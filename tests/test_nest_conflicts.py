"""Conflicts of equal items, whose surfaces coincide in part or whole."""

from __future__ import annotations

import pytest
import trimesh
from trimesh import creation

from packit_sim.core.compilation import kernel
from packit_sim.nesting import overlap_kernels
from packit_sim.nesting.build import build
from packit_sim.nesting.item_types import ItemType

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

in_conflict = overlap_kernels.in_conflict


@kernel
def conflict(problem, kind, identity, x, y, z):
    """Return whether an item is in conflict with an equal one at an offset."""
    return in_conflict(problem, kind, kind, identity, x, y, z, True)


@pytest.fixture(scope="module")
def problem():
    types = [ItemType(name, mesh.vertices, mesh.faces) for name, mesh in MESHES.items()]
    return build(types, 10.0, 0.0)


@pytest.mark.parametrize("kind", range(len(MESHES)), ids=list(MESHES))
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0, 1.001])
def test_equal_items_are_in_conflict_until_they_are_beside_each_other(problem, kind, share) -> None:
    extents = list(MESHES.values())[kind].extents
    for offset in share * extents * [[1, 0, 0], [0, 1, 0], [0, 0, 1]]:
        assert conflict(problem, kind, problem.lookup.identity, *offset) == (share < 1)
