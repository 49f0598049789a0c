"""Colours of items, and their legends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.geometry.shapes import Item, Shape
from packit_sim.render import coloring
from packit_sim.render.coloring import (
    COLORINGS,
    PALETTE,
    UNKNOWN_COLOR,
    ByNumber,
    ByShare,
    ColorKey,
    ColorScale,
    by_category,
    by_item,
    by_order,
    ramp,
)
from packit_sim.render.legends import add_legend
from tests.zoo import BALL, CUBE, RING


def named(shape: Shape, category: str) -> Item:
    return Item(Shape(shape.mesh, shape.id, category), 0.1)


def lightness(color: tuple[float, float, float]) -> float:
    """Relative luminance."""
    linear = np.array(color) ** 2.2
    return float(linear @ (0.2126, 0.7152, 0.0722))


@given(st.floats(0, 1), st.floats(0, 1))
def test_more_is_lighter(one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert lightness(ramp(low)) <= lightness(ramp(high)) + 1e-12
    if high - low > 0.02:
        assert lightness(ramp(low)) < lightness(ramp(high))


@pytest.mark.parametrize(
    ("red", "shift"), [(0.293, -0.022), (0.112, 0.004)], ids=["deuteranope", "protanope"]
)
def test_the_palette_s_colours_differ_for_those_who_see_no_red_or_green(red, shift) -> None:
    """By Viénot, Brettel and Mollon's projection, in linear light."""
    linear = np.array(PALETTE) ** 2.2
    projection = np.array(((red, 1 - red, 0), (red, 1 - red, 0), (shift, -shift, 1)))
    seen = np.clip(linear @ projection.T, 0, 1) ** (1 / 2.2)
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + np.eye(len(PALETTE))
    assert apart.min() > 0.05


def test_a_category_has_one_colour_and_the_most_frequent_the_first() -> None:
    items = [named(CUBE, "mug"), named(BALL, "lamp"), named(RING, "mug"), named(CUBE, "")]
    found = by_category(items)
    assert found.of[0] == found.of[2] == PALETTE[0]
    assert len(set(found.of)) == 3
    assert found.legend == ColorKey(
        "category", (("mug", found.of[0]), ("none", found.of[3]), ("lamp", found.of[1]))
    )


def test_there_are_colours_for_any_number_of_categories() -> None:
    found = by_category([named(CUBE, f"{n}") for n in range(100)])
    assert len(found.of) == 100 and len(set(found.of)) == 36


def test_order_and_share_by_hand() -> None:
    items = [Item(CUBE, 0.1), Item(CUBE, 0.3)]
    assert by_order(items).of == (ramp(0), ramp(1))
    assert by_order(items[:1]).of == (ramp(0),)
    assert by_order(items).legend == ColorScale("order of placing", "first", "last")
    assert ByShare()(items).legend == ColorScale("share of the reward", "0.0%", "75.0%")
    assert ByShare()(items).of == (ramp(1 / 3), ramp(1))
    whole = 0.8 * CUBE.volume
    assert ByShare(whole)(items).legend == ColorScale("share of the reward", "0.0%", "37.5%")


def test_numbers_that_are_not_there_equal_or_out_of_range() -> None:
    items = [Item(CUBE, 0.1)] * 3
    assert ByNumber("score", {1: 5.0})(items).of == (UNKNOWN_COLOR, ramp(0), UNKNOWN_COLOR)
    assert ByNumber("score", {})(items).of == (UNKNOWN_COLOR,) * 3
    found = ByNumber("score", {0: -1, 1: 0.5, 2: 9}, low=0, high=1, spec=".0%")(items)
    assert found.of == (ramp(0), ramp(0.5), ramp(1))
    assert found.legend == ColorScale("score", "0%", "100%")


def test_an_item_s_own_colour_is_its_shape_s() -> None:
    items = [Item(CUBE, 0.1), Item(BALL, 0.1), Item(CUBE, 0.7, 5)]
    found = by_item(items)
    assert found.of[0] == found.of[2] == coloring.color_of(CUBE) != found.of[1]
    assert found.legend is None


@pytest.mark.parametrize("name", COLORINGS)
def test_nothing_to_colour(name: str) -> None:
    assert COLORINGS[name]([]).of == ()


@pytest.mark.parametrize("side", [16, 120, 800])
@pytest.mark.parametrize("count", [0, 3, 300])
@pytest.mark.parametrize("text", ["mug", "x" * 400, "Käse\n杯子"])
def test_any_legend_fits(side: int, count: int, text: str) -> None:
    picture = np.full((side, side, 3), 77, dtype=np.uint8)
    entries = tuple((f"{text} {n}", PALETTE[n % 12]) for n in range(count))
    for legend in (ColorKey(text, entries), ColorScale(text, "0", text)):
        for background in ((255, 255, 255), (0, 0, 0)):
            image = add_legend(picture, legend, background)
            assert image.shape[0] == side and side < image.shape[1] <= 2.5 * side + 120
            assert np.array_equal(image[:, :side], picture)
            assert (image[:, -1] == background).all()


def test_a_legend_shows_its_colours() -> None:
    picture = np.zeros((300, 10, 3), dtype=np.uint8)
    image = add_legend(
        picture, ColorKey("what", (("a", (1, 0, 0)), ("b", (0, 0, 1)))), (255, 255, 255)
    )
    pixels = image.reshape(-1, 3)
    for color in ((255, 0, 0), (0, 0, 255)):
        assert (pixels == color).all(axis=1).sum() > 50
    scale = add_legend(picture, ColorScale("how much", "0", "1"), (255, 255, 255)).reshape(-1, 3)
    for share in (0, 0.5, 1):
        wanted = np.round(255 * np.array(ramp(share)))
        assert (np.abs(scale - wanted).max(axis=1) <= 3).any()
