"""An independent check: the shared volume of placed solids by exact boolean intersection."""

import itertools

import numpy as np
import pytest
import trimesh

from packit_sim.box import Box
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.placement import PlacedItem
from tests.zoo import BALL, CUBE, RING, TILTED, cube_of


def solid(placed: PlacedItem) -> trimesh.Trimesh:
    mesh = placed.item.mesh.copy()
    mesh.apply_translation(placed.center)
    return mesh


def overlap_depth(a: PlacedItem, b: PlacedItem) -> float:
    """Mean thickness of what two solids share, in box units: twice its volume over its area."""
    shared = trimesh.boolean.intersection([solid(a), solid(b)], engine="manifold")
    return 0.0 if shared.is_empty or shared.area == 0 else 2 * abs(shared.volume) / shared.area


def assert_at_most_touching(box: Box) -> int:
    """Returns how many pairs have bounding boxes that meet, and so were really compared."""
    compared = 0
    for a, b in itertools.combinations(box.placed, 2):
        if all(
            s < t and u < v for s, t, u, v in zip(a.start, b.stop, b.start, a.stop, strict=True)
        ):
            assert overlap_depth(a, b) <= CONTACT_TOLERANCE, (a, b)
            compared += 1
    return compared


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_solids_of_a_dense_box_share_no_more_than_the_tolerance(seed) -> None:
    library = ShapeLibrary.open("everyday")
    solids = [i for i in library.ids if library.info(i).solid]
    shapes = [library[i] for i in solids] + [BALL, RING, TILTED, CUBE]
    rng = np.random.default_rng(seed)
    box = Box()
    for _ in range(60):
        shape = shapes[rng.integers(len(shapes))]
        item = Item(shape, rng.uniform(0.2, 0.7) ** 3, int(rng.integers(24)))
        location = box.blbf(item)
        if location is not None:
            box.place(item, location)
    assert len(box.placed) >= 15
    assert assert_at_most_touching(box) >= 20


def test_cubes_that_overlap_by_the_tolerance_share_that_and_the_witness_sees_it() -> None:
    almost = cube_of(24.009)
    box = Box()
    box.place(almost, (0, 0, 0))
    box.place(almost, (6, 0, 0))
    assert overlap_depth(*box.placed) == pytest.approx(0.9e-4, rel=0.02)
    deeper = [PlacedItem(cube_of(24.1), (0, 0, 0)), PlacedItem(cube_of(24.1), (6, 0, 0))]
    assert overlap_depth(*deeper) > 5 * CONTACT_TOLERANCE
