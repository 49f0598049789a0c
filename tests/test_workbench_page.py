"""The workbench's page in a real browser, headless Chromium."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest
from trimesh import creation

from packit_sim.parts.results import exports
from packit_sim.parts.workbench.workbench import Workbench

LONG = 120_000
"""Milliseconds that a busy machine may take."""


@pytest.fixture(name="page")
def _page(chromium, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    errors: list[str] = []
    requests: list[str] = []
    with Workbench() as bench:
        page = chromium.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(LONG)
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(bench.address)
        yield page
        assert errors == []
        assert all(url.startswith((bench.address, "data:")) for url in requests)
        page.close()


def test_parts_are_sent_packed_locked_and_packed_again(page) -> None:
    files = [("cube", creation.box((40, 40, 40))), ("plate", creation.box((90, 60, 10)))]
    page.locator("#choose").set_input_files(
        [
            {"name": f"{name}.stl", "mimeType": "", "buffer": mesh.export(file_type="stl")}
            for name, mesh in files
        ]
    )
    rows = page.locator("#files tbody tr")
    rows.nth(1).wait_for()
    assert "90 x 60 x 10 mm" in rows.nth(1).inner_text()
    rows.nth(0).locator("input").fill("3")
    page.locator("[name=seconds]").fill("1")
    page.locator("#pack").click()
    page.locator("#downloads a", has_text="packing.3mf").wait_for()
    assert page.locator("#locks li").count() == 4
    assert "no problems" in page.locator("#summary").inner_text()
    assert int(page.locator("#scene").get_attribute("data-drawn")) > 0
    with page.expect_download() as download:
        page.locator("#downloads a", has_text="packing.3mf").click()
    assert download.value.suggested_filename == "packing.3mf"

    canvas = page.locator("#scene").bounding_box()
    for x, y in product((0.5, 0.4, 0.6, 0.3, 0.7), (0.6, 0.5, 0.7)):  # a click on a part locks it
        page.mouse.click(canvas["x"] + x * canvas["width"], canvas["y"] + y * canvas["height"])
        if page.locator("#locks input:checked").count():
            break
    assert page.locator("#locks input:checked").count() == 1
    with page.expect_response(lambda answer: '"locked": 1' in answer.text()):
        page.locator("#pack").click()
    page.locator("#pack:enabled").wait_for()
    assert page.locator("#locks input:checked").count() == 1

    page.locator("[name=z]").fill("5")
    page.locator("#pack").click()
    page.locator("#message.error").wait_for()
    assert "5 beyond the box's top wall, in mm" in page.locator("#message").inner_text()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
