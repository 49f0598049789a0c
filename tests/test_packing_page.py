"""The page of a packing in a browser: a wide view, and a list that marks its parts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.parts.results.page import write_page
from tests.test_report_page import picture

DRAWN = "canvas[data-drawn]"


@pytest.fixture(name="file", scope="module")
def _file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    parts = [
        Part("block [x]", creation.box((10, 10, 10)), count=4),
        Part("деталь", creation.icosphere(radius=4), count=2),
    ]
    packed = pack(parts, (31, 21, 11), settings=PackSettings(workers=1, iterations=20))
    assert packed.count == 6
    return write_page(packed, None, tmp_path_factory.mktemp("page") / "packing.html")


@pytest.fixture(name="shown")
def _shown(chromium, file) -> Iterator[Any]:
    page = chromium.new_page(viewport={"width": 1200, "height": 800}, color_scheme="light")
    page.set_default_timeout(120_000)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(file.as_uri())
    page.locator(".card").scroll_into_view_if_needed()
    page.locator(DRAWN).wait_for()
    yield page
    assert errors == []
    page.close()


def test_one_box_is_as_wide_as_the_page(shown) -> None:
    width, page = shown.evaluate(
        "[document.querySelector('canvas').clientWidth, document.querySelector('main').clientWidth]"
    )
    assert width > 0.98 * page > 1000
    assert "not done" in shown.locator("#summary").inner_text()


def test_the_layers_are_plotted(shown) -> None:
    bars = shown.locator("#layers rect")
    assert bars.count() == 50
    assert bars.first.locator("title").text_content() == "62.1%, 6 parts"
    assert "at most 6 parts in a layer" in shown.locator("#layers").inner_text()


def test_in_a_narrow_window_nothing_scrolls_sideways(shown) -> None:
    shown.set_viewport_size({"width": 360, "height": 640})
    assert shown.evaluate("document.documentElement.scrollWidth") <= 360


def test_a_name_marks_its_parts(shown) -> None:
    card, names = shown.locator(".card"), shown.locator(".names button")
    assert names.all_inner_texts() == ["block [x] \u00d7 4", "деталь \u00d7 2"]
    whole = picture(card)
    names.nth(1).hover()
    marked = picture(card)
    assert difference(whole, marked) > 1
    shown.mouse.move(2, 2)
    assert difference(whole, picture(card)) < 0.5


def test_a_name_is_chosen_by_keys(shown) -> None:
    card, name = shown.locator(".card"), shown.locator(".names button").first
    whole = picture(card)
    name.focus()
    focused = picture(card)
    assert difference(whole, focused) > 1
    name.press("Enter")
    shown.locator("#coloring").focus()
    assert name.get_attribute("aria-pressed") == "true"
    assert difference(focused, picture(card)) < 0.5
    name.press("Escape")
    assert name.get_attribute("aria-pressed") == "false"
    shown.locator("#coloring").focus()
    assert difference(whole, picture(card)) < 0.5


def difference(one: Any, other: Any) -> float:
    return float(np.abs(one.astype(int) - other.astype(int)).mean())
