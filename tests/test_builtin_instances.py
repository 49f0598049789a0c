"""The built-in strip-packing instances: always the same, closed, and as good as they claim."""

import hashlib
import math
import re
from functools import cache

import numpy as np
import pytest
import trimesh

from packit_sim import NestSettings, nest
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.packings import builtin_instances
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES
from packit_sim.parts.packings.instances import read_instance, write_instance
from packit_sim.parts.packings.item_types import ItemType
from tests.doc_pages import DOCS

PAGE = DOCS / "reference" / "instances.md"

builtin_instance = cache(builtin_instances.builtin_instance)

DIGESTS = {
    "polytopes-20": "ae9a53d7e2ff407c",
    "polytopes-60": "4626d513d851859f",
    "brackets-24": "7177cb5fd8995e51",
    "gears-12": "2d51cca17139a434",
    "rings-12": "0566803afe9b9371",
    "cuboids-16": "87a1f69183f78d1d",
    "cut-cube-8": "528f177c11f67b5c",
    "cut-cube-16": "56e1b8b03afde110",
}
"""Digests of the rounded vertices of all types, by instance."""


def mesh(item_type: ItemType) -> trimesh.Trimesh:
    return trimesh.Trimesh(item_type.vertices, item_type.faces, process=False)


@pytest.mark.parametrize("name", BUILTIN_NAMES)
def test_a_name_always_gives_the_same_meshes(name) -> None:
    sha = hashlib.sha256()
    for item_type in builtin_instance(name).types:
        corners = np.round(item_type.vertices, 6) + 0.0  # no negative zero
        sha.update(np.unique(corners, axis=0).tobytes())
    assert sha.hexdigest()[:16] == DIGESTS[name]


@pytest.mark.parametrize("name", BUILTIN_NAMES)
def test_items_are_closed_bodies_from_the_origin_as_many_as_the_name_says(name) -> None:
    types, container, _ = builtin_instance(name, "axis-4")
    assert container.is_strip and sum(t.demand for t in types) == int(name.rpartition("-")[2])
    assert len({t.digest for t in types}) == len(types)
    for item_type in types:
        body = mesh(item_type)
        assert body.is_watertight and body.is_winding_consistent and body.body_count == 1
        assert item_type.volume == pytest.approx(body.volume) and body.volume > 0
        assert np.allclose(item_type.low, 0, atol=1e-9) and item_type.rotations == "axis-4"


def test_volumes_are_those_of_the_formulas() -> None:
    ring, pin = builtin_instance("rings-12").types
    area = 16 * math.sin(math.pi / 16)  # of a polygon with 32 corners on the unit circle
    assert ring.volume == pytest.approx(area * (5**2 - 2**2))
    assert pin.volume == pytest.approx(area * 1.9**2 * 2)
    for name in ("polytopes-20", "polytopes-60", "cut-cube-8", "cut-cube-16", "cuboids-16"):
        for item_type in builtin_instance(name).types:
            assert mesh(item_type).convex_hull.volume == pytest.approx(item_type.volume)
    for item_type in builtin_instance("cuboids-16").types:
        assert item_type.volume == pytest.approx(np.prod(item_type.extents.round()))
    for item_type, legs in zip(builtin_instance("brackets-24").types, (1, 2, 1) * 2, strict=True):
        wide, deep, high = item_type.extents
        thick = np.unique(item_type.vertices[:, 2])[1]
        assert item_type.volume == pytest.approx(deep * thick * (wide + legs * (high - thick)))


@pytest.mark.parametrize(
    ("name", "height", "density"),
    [("cut-cube-8", 10, 1), ("cut-cube-16", 10, 1), ("cuboids-16", 10, 1), ("rings-12", 8, None)],
)
def test_an_optimal_packing_has_all_items_no_problems_and_the_optimum(
    name, height, density
) -> None:
    optimal = builtin_instance(name).optimal
    assert optimal.problems() == [] and not any(optimal.left_out)
    assert optimal.height == pytest.approx(height)
    if density:
        assert optimal.density == pytest.approx(density)  # nothing can be lower


@pytest.mark.parametrize("name", ["cut-cube-8", "rings-12"])
def test_an_instance_is_packed(name) -> None:
    types, container, optimal = builtin_instance(name)
    settings = NestSettings(workers=1, iterations=30)
    packing = nest(types, container, settings=settings)
    assert packing.problems() == [] and not any(packing.left_out)
    assert packing.height >= optimal.height * 0.999


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    known = re.escape(", ".join(BUILTIN_NAMES))
    with pytest.raises(ArgumentError, match=f"no built-in instance 'cubes': choose from {known}"):
        builtin_instance("cubes")


def test_the_files_of_an_instance_hold_the_same_items(tmp_path) -> None:
    types, container, _ = builtin_instance("brackets-24")
    write_instance(types, container, tmp_path / "brackets.json")
    again, strip = read_instance(tmp_path / "brackets.json")
    assert strip == container
    assert [(t.name, t.demand) for t in again] == [(t.name, t.demand) for t in types]
    assert [t.digest for t in again] == [t.digest for t in types]


@pytest.mark.parametrize("name", BUILTIN_NAMES)
def test_the_reference_has_the_numbers_of_each_instance(name) -> None:
    types, container, optimal = builtin_instance(name)
    x, y, _ = container.size
    volume = sum(t.demand * t.volume for t in types)
    numbers = (sum(t.demand for t in types), len(types), f"{x:g} x {y:g}", f"{volume:.1f}")
    optimum = "-" if optimal is None else f"{optimal.height:g}"
    row = " | ".join(map(str, (f"`{name}`", *numbers, optimum)))
    assert row in PAGE.read_text()
