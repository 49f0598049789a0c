"""Parts that fill a box with nothing to spare are packed, at once."""

from __future__ import annotations

from itertools import product
from time import perf_counter

import pytest
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.results.check import check

QUICK = PackSettings(workers=1, iterations=1)


def block(*sides: float, name: str = "block", count: int = 1, rotations: str = "cube") -> Part:
    return Part(name, creation.box(sides), count=count, rotations=rotations)


def packed_exactly(parts: list[Part], size: tuple[float, ...], **settings: float) -> PackedParts:
    packed = pack(parts, size, settings=PackSettings(workers=1, iterations=1, **settings))
    assert packed.left_out == () and check(packed).problems == ()
    found = check(packed).distance
    assert found is None or found >= settings.get("clearance", 0.0) - 1e-6
    return packed


def test_plates_fill_a_box_with_their_clearance() -> None:
    packed_exactly([block(20, 20, 2, name="plate", count=6)], (62, 42, 2), clearance=1.0)
    packed_exactly([block(20, 20, 2, name="plate", count=6)], (62, 42, 10), clearance=1.0)


@pytest.mark.parametrize(("clearance", "wall"), list(product((0.0, 0.3, 1.0), (0.0, 0.7, 2.0))))
def test_grids_in_three_dimensions_keep_both_clearances(clearance: float, wall: float) -> None:
    numbers, sides = (3, 2, 2), (10.1, 20.3, 5.7)
    size = [
        n * side + (n - 1) * clearance + 2 * wall for n, side in zip(numbers, sides, strict=True)
    ]
    part = block(*sides, count=12)
    packed_exactly([part], tuple(size), clearance=clearance, wall_clearance=wall)
    turned = (size[2], size[0], size[1])
    packed_exactly([part], turned, clearance=clearance, wall_clearance=wall)


def test_one_and_two_parts_fit_exactly() -> None:
    packed_exactly([block(30, 20, 10)], (34, 24, 14), wall_clearance=2.0)
    two = [block(30, 20, 10, name="a"), block(20, 20, 10, name="b")]
    packed_exactly(two, (51 + 4, 24, 14), clearance=1.0, wall_clearance=2.0)
    layers = [block(20, 20, 4, name="a", count=4), block(10, 10, 8, name="b", count=16)]
    packed_exactly(layers, (40, 40, 12))


def test_single_precision_is_no_obstacle(tmp_path) -> None:
    creation.box((10.1, 10.1, 10.1)).export(tmp_path / "cube.stl")
    part = f"{tmp_path / 'cube.stl'}=8"
    settings = PackSettings(workers=1, iterations=1, clearance=0.3, wall_clearance=0.1)
    packed = pack([part], (20.7, 20.7, 20.7), settings=settings)
    assert packed.count == 8 and check(packed).problems == ()


@pytest.mark.parametrize(("count", "number"), [(100, 5), (1000, 10)])
def test_many_cubes_are_packed_within_seconds(count: int, number: int) -> None:
    start = perf_counter()
    size = (11 * number - 1, 11 * number - 1, 11 * (count // number**2) - 1)
    packed = pack([block(10, 10, 10, count=count)], size, settings=PackSettings(clearance=1.0))
    assert packed.count == count and perf_counter() - start < 20
    assert packed.packings[0].problems() == []


def test_as_many_as_fit_exactly_are_packed_if_there_are_more() -> None:
    packed = pack(
        [block(20, 20, 2, count=7)],
        (62, 42, 2),
        settings=PackSettings(workers=1, iterations=1, clearance=1.0),
    )
    assert packed.count == 6 and check(packed).problems == ()


def test_boxes_are_filled_exactly_one_after_the_other() -> None:
    packed = pack([block(10, 10, 10, count=24)], (20, 20, 20), "boxes", settings=QUICK)
    assert len(packed.packings) == 3 and packed.count == 24 and check(packed).problems == ()


def test_what_is_too_large_by_a_little_is_left_out() -> None:
    settings = PackSettings(workers=1, iterations=1, clearance=1.0)
    packed = pack([block(20, 20, 2, count=6)], (61.99, 42, 2), settings=settings)
    assert packed.count < 6
