"""The workbench's page in a real browser, headless Chromium: one page, packed once, for all."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest
from trimesh import creation

from packit_sim.parts.results import exports
from packit_sim.parts.workbench.workbench import Workbench

LONG = 20_000
"""Milliseconds that a busy machine may take."""

CHECKED = "#locks input:checked"


def _file(name: str, *sides: float) -> dict[str, Any]:
    data = creation.box(sides).export(file_type="stl")
    return {"name": f"{name}.stl", "mimeType": "", "buffer": data}


@pytest.fixture(name="page", scope="module")
def _page(chromium) -> Iterator[Any]:
    errors: list[str] = []
    requests: list[str] = []
    with pytest.MonkeyPatch.context() as patch, Workbench() as bench:
        patch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
        page = chromium.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(LONG)
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(bench.address)
        page.locator("#choose").set_input_files(
            [_file("cube", 40, 40, 40), _file("plate", 90, 60, 10)]
        )
        page.locator("#files tbody tr").nth(1).wait_for()
        page.locator("#files tbody tr").nth(0).locator("input").fill("3")
        page.locator("[name=seconds]").fill("1")
        _pack(page)
        yield page
        assert errors == []
        assert all(url.startswith((bench.address, "data:")) for url in requests)
        page.close()


def _pack(page: Any) -> None:
    page.locator("#pack").click()
    page.locator("#stop:enabled").or_(page.locator("#message.done")).first.wait_for()
    page.locator("#pack:enabled").wait_for()


def _points(page: Any) -> Iterator[tuple[float, float]]:
    """Points of the window at which a part may be."""
    page.locator("#scene").scroll_into_view_if_needed()
    canvas = page.locator("#scene").bounding_box()
    for x, y in product((0.5, 0.4, 0.6, 0.3, 0.7), (0.6, 0.5, 0.7)):
        yield canvas["x"] + x * canvas["width"], canvas["y"] + y * canvas["height"]


@pytest.mark.slow
def test_box_and_parts_are_visible_before_packing(chromium) -> None:
    with Workbench() as bench:
        page = chromium.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(LONG)
        page.goto(bench.address)
        page.locator("#scene[data-drawn]").wait_for()
        empty = page.locator("#scene").screenshot()
        with page.expect_response("**/order"):
            page.locator("#choose").set_input_files([_file("cube", 90, 90, 90)])
        assert page.locator("#scene").screenshot() != empty
        page.locator("[name=z]").fill("0")
        page.locator("[name=z]").blur()
        page.locator("#fault", has_text="Each side of the box must be a number above 0.").wait_for()
        page.close()


def test_the_result_is_shown_with_its_numbers_and_files(page) -> None:
    assert "90 x 60 x 10 mm" in page.locator("#files tbody tr").nth(1).inner_text()
    assert page.locator("#locks li").count() == 4
    assert "no problems" in page.locator("#summary").inner_text()
    assert page.locator("#message").inner_text().startswith("done in")
    assert "4 of 4 parts" in page.locator("#message").inner_text()
    assert int(page.locator("#scene").get_attribute("data-drawn")) > 0
    for name in ("packing.3mf", "all files"):
        with page.expect_download() as download:
            page.locator("#downloads a", has_text=name).click()
        assert download.value.suggested_filename == name.replace("all files", "packing.zip")


def test_the_list_and_the_box_point_at_each_other(page) -> None:
    page.locator("#locks li").nth(2).hover()
    assert page.locator("#tip").inner_text() in ("cube", "plate")
    page.locator("#locks input").nth(1).focus()
    assert page.locator("#locks li.pointed input:focus").count() == 1
    for x, y in _points(page):
        page.mouse.move(x, y)
        if page.locator("#locks li.pointed").count():
            break
    pointed = page.locator("#locks li.pointed")
    assert pointed.inner_text().strip() == page.locator("#tip").inner_text()
    for name in ("apart", "cut"):
        before = page.locator("#scene").screenshot()
        page.locator(f"#{name}").focus()
        page.keyboard.press("End")
        assert page.locator("#scene").screenshot() != before, name
        page.keyboard.press("Home")


@pytest.mark.slow
def test_locks_survive_files_errors_and_searches_and_results_are_undone(page) -> None:
    for x, y in _points(page):  # a click on a part locks it
        with page.expect_response("**/state*"):
            page.mouse.click(x, y)
        if page.locator(CHECKED).count():
            break
    page.locator(CHECKED).wait_for()
    page.locator("#choose").set_input_files([_file("other", 20, 20, 20)])
    page.locator("#files tbody tr").nth(2).wait_for()
    assert page.locator(CHECKED).count() == 1
    page.locator("[name=z]").fill("5")
    page.locator("#pack").click()
    page.locator("#message.error").wait_for()
    assert page.locator(CHECKED).count() == 1
    page.locator("[name=z]").fill("100")
    _pack(page)
    page.locator("#locks li").nth(4).wait_for()
    page.locator(CHECKED).wait_for()
    assert page.locator("#undo:enabled").count() == 1

    page.keyboard.press("Control+z")
    page.locator("#write:visible").wait_for()
    assert page.locator("#locks li").count() == 4
    page.reload()
    page.locator("#locks li").nth(3).wait_for()
    assert page.locator(CHECKED).count() == 1
    counts = page.locator("#files td input").evaluate_all("all => all.map(one => one.value)")
    assert counts == ["3", "1", "1"]
    assert page.locator("[name=seconds]").input_value() == "1"
    page.locator("#redo").click()
    page.locator("#locks li").nth(4).wait_for()


def test_a_file_is_read_in_another_unit(page) -> None:
    row = page.locator("#files tbody tr").nth(1)
    row.locator(".unit select").select_option("in")
    page.locator("#files tbody tr", has_text="90 x 60 x 10 in").wait_for()


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_scrolls_sideways(page, width) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
