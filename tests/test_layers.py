"""Layers of packings, and the powder that a build takes."""

import numpy as np
import pytest
from trimesh import creation

from packit_sim import BoxContainer, ItemType, Packing, PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.motions import Motion
from packit_sim.parts import summary
from packit_sim.parts.packings.layers import cut_area, layers
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.powder import Powder, read_powder


@pytest.mark.parametrize("height", [0.1, 0.5, 0.9])
def test_the_area_of_a_cut(height: float) -> None:
    box = creation.box(bounds=((1, 1, 0), (4, 3, 1)))
    cone = creation.cone(2, 1, sections=256).apply_translation((5, 5, 0))
    ring = creation.annulus(1, 2, 2, sections=256)
    assert cut_area(box.triangles, height) == pytest.approx(6)
    assert cut_area(cone.triangles, height) == pytest.approx(np.pi * 4 * (1 - height) ** 2, 1e-3)
    assert cut_area(ring.triangles, height) == pytest.approx(np.pi * 3, 1e-3)
    assert cut_area(box.triangles, 2.0) == 0


def test_layers_of_a_packing() -> None:
    mesh = creation.box((10, 10, 10))
    cube = ItemType("cube", mesh.vertices, mesh.faces, demand=3)
    places = ((5, 5, 5), (15, 5, 5), (5, 5, 15))
    placed = tuple(Placement(0, Motion.shift(np.array(each, float))) for each in places)
    found = layers(Packing((cube,), BoxContainer((20, 20, 40)), placed, 0.0, "knapsack"))
    assert found.counts.tolist() == [2] * 25 + [1] * 25
    assert found.areas == pytest.approx([200] * 25 + [100] * 25)
    assert found.variation == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (4, "4 g, 100% of it parts; 0.8 g fresh at 20%"),
        (3, "3.5 g, 85.71% of it parts; 0.7 g fresh at 20%"),
    ],
)
def test_the_powder_of_a_build(count: int, text: str) -> None:
    part = Part("cube", creation.box((10, 10, 10)), count, rotations="fixed", density=1.0)
    settings = PackSettings(workers=1, iterations=20, powder=Powder(0.5, 0.2))
    packed = pack([part], (20, 20, 30), settings=settings)
    assert packed.height == pytest.approx(10)
    assert summary(packed)["powder"] == text
    with pytest.raises(ArgumentError, match="a powder needs masses: part 'cube' has no mass"):
        pack([Part("cube", part.mesh)], (20, 20, 30), settings=settings)


def test_texts_of_powders() -> None:
    assert read_powder("0.45:20%") == read_powder("0.45 g/cm3:20 %") == Powder(0.45, 0.2)
    for wrong in ("20%", "0.45", "0.45:20", "-1:20%"):
        with pytest.raises(ArgumentError, match=r"such as 0\.45:20%"):
            read_powder(wrong)
    for wrong in ("0.45:0%", "0.45:101%", "0:20%"):
        with pytest.raises(ArgumentError, match="the powder's"):
            read_powder(wrong)
