"""The workbench's page in a real browser, headless Chromium: one page, packed once, for all."""

from collections import Counter
from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest
from trimesh import creation

from packit_sim.parts.results import exports
from packit_sim.parts.workbench.workbench import Workbench

LONG = 60_000
"""Milliseconds that a busy machine may take, kernels included."""

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
        page.locator("#files tr.file").nth(1).wait_for()
        page.locator("#files tr.file").nth(0).locator("input").fill("3")
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
        text = "Each side of the box must be a number above 0."
        page.locator("#fault-box", has_text=text).wait_for()
        page.close()


def test_the_result_is_shown_with_its_numbers_and_files(page) -> None:
    assert "90 x 60 x 10 mm" in page.locator("#files tr.file").nth(1).inner_text()
    assert page.locator("#locks li").count() == 4
    summary = page.locator("#summary").inner_text()
    assert "no problems" in summary and "246,000 mm³ (0.246 l)" in summary
    assert page.locator("#message").inner_text().startswith("done in")
    assert "4 of 4 parts" in page.locator("#message").inner_text()
    assert int(page.locator("#scene").get_attribute("data-drawn")) > 0
    for name in ("packing.3mf", "all files"):
        with page.expect_download() as download:
            page.locator("#downloads a", has_text=name).click()
        assert download.value.suggested_filename == name.replace("all files", "packing.zip")


@pytest.mark.slow
def test_no_worse_packing_replaces_the_one_that_is_shown(page) -> None:
    names = page.locator("#locks label").all_inner_texts()
    page.locator("#locks input").nth(0).check()
    _pack(page)
    page.locator("#message", has_text="nothing better was found").wait_for()
    assert sorted(page.locator("#locks label").all_inner_texts()) == sorted(names)
    assert page.locator(CHECKED).count() == 1
    page.locator(CHECKED).uncheck()


def test_the_list_and_the_box_point_at_each_other(page) -> None:
    page.locator("#locks li").nth(2).hover()
    assert page.locator("#tip").inner_text() in ("cube", "plate")
    page.locator("#locks input").nth(1).focus()
    assert page.locator("#locks li.pointed input:focus").count() == 1
    for x, y in _points(page):
        page.mouse.move(x, y)
        if page.locator("#locks li.pointed").count():
            break
    pointed = page.locator("#locks li.pointed label")
    assert pointed.inner_text().strip() == page.locator("#tip").inner_text()
    for name in ("apart", "cut"):
        before = page.locator("#scene").screenshot()
        page.locator(f"#{name}").focus()
        page.keyboard.press("End")
        assert page.locator("#scene").screenshot() != before, name
        page.keyboard.press("Home")


def test_colours_are_by_part_or_by_kind_with_a_legend(page) -> None:
    page.locator("#coloring").select_option("kind")
    legend = page.locator("#legend")
    counts = Counter(page.locator("#locks label").all_inner_texts())
    found = [f"{name.strip()} \u00d7 {count}" for name, count in counts.items()]
    assert sorted(legend.locator("button").all_inner_texts()) == sorted(found)
    swatches = "all => all.map(one => one.style.background)"
    by_kind = page.locator("#locks .swatch").evaluate_all(swatches)
    assert len(set(by_kind)) == len(counts) >= 2
    before = page.locator("#scene").screenshot()
    legend.locator("button").first.focus()
    assert page.locator("#scene").screenshot() != before  # its parts are lit
    page.locator("#coloring").select_option("part")
    assert len(set(page.locator("#locks .swatch").evaluate_all(swatches))) > len(counts)
    assert legend.locator("button").count() == 0


def test_keys_are_listed(page) -> None:
    page.locator("#scene").focus()
    page.keyboard.press("?")
    assert page.locator("dialog[open] tr").count() > 9
    page.keyboard.press("Escape")
    page.locator("#help").click()
    page.locator("dialog[open] button").click()
    assert page.locator("dialog[open]").count() == 0


def test_a_part_is_moved_by_keys_with_its_conflicts(page) -> None:
    page.locator("#locks button").nth(1).click()
    assert page.locator("#hand").get_attribute("aria-pressed") == "true"
    own = page.locator("#locks li").nth(1)
    with page.expect_response("**/moves") as answer:
        for _ in range(12):
            page.keyboard.press("Shift+PageUp")
    page.locator("#conflict", has_text="mm beyond").wait_for()
    assert answer.value.status == 200
    assert "conflict" in own.get_attribute("class")
    assert page.locator("#legend", has_text="in conflict").count() == 1
    assert page.locator("#pack").is_disabled() and not page.locator("#downloads").is_visible()
    page.keyboard.press("Enter")
    page.keyboard.press("Escape")  # puts it back
    page.locator("#conflict:empty").wait_for(state="attached")
    assert page.locator("#downloads").is_visible()
    page.keyboard.press("Escape")
    assert page.locator("#hand").get_attribute("aria-pressed") == "false"
    assert page.locator("#message").inner_text() != ""


@pytest.mark.slow
def test_locks_survive_files_errors_and_searches_and_results_are_undone(page) -> None:
    for x, y in _points(page):  # a click on a part locks it
        with page.expect_response("**/state*"):
            page.mouse.click(x, y)
        if page.locator(CHECKED).count():
            break
    page.locator(CHECKED).wait_for()
    page.locator("#choose").set_input_files([_file("other", 20, 20, 20)])
    page.locator("#files tr.file").nth(2).wait_for()
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
    counts = page.locator("#files tr.file td input").evaluate_all(
        "all => all.map(one => one.value)"
    )
    assert counts == ["3", "1", "1"]
    assert page.locator("[name=seconds]").input_value() == "1"
    page.locator("#redo").click()
    page.locator("#locks li").nth(4).wait_for()


def test_a_file_is_read_in_another_unit(page) -> None:
    row = page.locator("#files tr.file").nth(1)
    row.locator(".unit select").select_option("in")
    page.locator("#files tr.file", has_text="90 x 60 x 10 in").wait_for()


@pytest.mark.slow
def test_a_part_that_is_dragged_snaps_and_stays_where_it_is_free(page) -> None:
    page.locator("#hand").click()
    for x, y in _points(page):
        page.mouse.move(x, y)
        if page.locator("#locks li.pointed").count():
            break
    page.mouse.down()
    page.mouse.move(x + 40, y + 30, steps=4)
    with page.expect_response("**/moves"):
        page.mouse.move(x + 90, y + 60, steps=4)
    page.mouse.up()
    done = page.locator("#message", has_text="done: 1 part moved and locked")
    done.or_(page.locator("#conflict:not(:empty)")).first.wait_for()
    while not done.count():  # it is on others: drag it on
        page.keyboard.press("Shift+PageUp")
        with page.expect_response("**/moves"):
            page.keyboard.press("Enter")
        page.wait_for_timeout(500)
    page.locator(CHECKED).wait_for()
    packing = page.evaluate("fetch('/state?seen=0').then((one) => one.json())")
    (box,) = packing["result"]["boxes"]
    corner = box["low"][packing["locked"][0]]
    assert all(abs(each - round(each)) < 1e-6 for each in corner)  # on whole millimetres
    page.locator("#write").click()
    page.locator("#message", has_text="done: the files are written").wait_for()
    page.locator("#hand").click()
    page.locator("#undo").click()
    page.locator("#redo:enabled").wait_for()
    page.locator("#write").click()
    page.locator("#downloads a").first.wait_for()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("seconds", "0", "Choose 1 to 86,400 seconds."),
        ("clearance", "-1", "Choose a number of at least 0."),
        ("clearance_z", "3", "both above 0"),
        ("wall_clearance", "90", "leave no space"),
        ("stable", "0", "Choose a number above 0."),
        ("boxes", "1.5", "Choose a whole number from 1 on."),
        ("max_mass", "3", "has no mass"),
        ("max_parts", "0", "Choose a whole number from 1 on."),
        ("max_tilt", "200", "Choose 0 to 180 degrees."),
        ("balance", "60", "Choose 0.1 to 50 percent."),
        ("powder", "0.45", "has no mass"),
    ],
)
def test_messages_are_next_to_their_fields(page, field, value, sentence) -> None:
    page.locator("#more").evaluate("one => { one.open = true; }")
    own = page.locator(f"[name={field}]")
    before = own.input_value()
    own.fill(value)
    own.blur()
    page.locator(f"#fault-{field}", has_text=sentence).wait_for()
    assert own.get_attribute("aria-invalid") == "true"
    assert f"fault-{field}" in own.get_attribute("aria-describedby")
    page.locator("#pack").click()
    page.locator("#message.error", has_text="some fields need another value").wait_for()
    page.locator(f"[name={field}]:focus").wait_for()
    own.fill(before)
    own.blur()
    page.locator(f"#fault-{field}:empty").wait_for(state="attached")


@pytest.mark.slow
def test_the_order_has_what_the_command_can_do_and_survives_a_reload(page) -> None:
    page.locator("#more").evaluate("one => { one.open = true; }")
    row = page.locator("#files tr.file").nth(0)
    row.locator("button", has_text="more").click()
    more = page.locator("#files tr.more").nth(0)
    values = {"group": "left", "value of one": "3", "mass of one in g": "20"}
    values |= {"leans at most": "30", "sides that may face down": "z- x+", "stop": "2"}
    for label, value in values.items():
        more.get_by_label(label).fill(value)
    more.get_by_label("How many of").select_option("max")
    numbers = {"wall_floor": "2", "max_mass": "5", "stable": "1", "boxes": "2", "max_tilt": "15"}
    numbers |= {"balance": "10", "powder": "0.45", "powder_refresh": "30"}
    for name, value in numbers.items():
        page.locator(f"[name={name}]").fill(value)
    for name in ("removable", "insertable", "separable", "order", "even"):
        page.locator(f"[name={name}]").check()
    for side in ("z-", "x+"):
        page.locator(f"[name=down][value='{side}']").check()
    page.locator("[name=door]").select_option("y-")
    page.locator("[name=groups][value=apart]").check()
    page.locator("[name=objective]").select_option("value")
    page.locator("#another").click()
    page.locator("#rows .box").nth(1).locator("select").first.select_option("cylinder")

    def is_whole(response: Any) -> bool:
        return "cylinder:120x" in (response.request.post_data or "")

    with page.expect_response(is_whole) as kept:
        page.locator("[name=diameter]").fill("120")
        page.locator("[name=diameter]").blur()
    job = kept.value.request.post_data_json
    assert [each["size"] for each in job["box"]] == ["200x150x100mm", "cylinder:120x100mm"]
    assert [each["name"] for each in job["box"]] == ["A", "B"]
    assert job["wall_clearance"] == "sides=0mm,floor=2mm,top=0mm"
    assert (job["max_mass"], job["stable"], job["boxes"]) == (["5kg"], "1mm", 2)
    assert job["removable"] and job["insertable"] and job["separable"] and job["even"]
    assert (job["max_tilt"], job["down"], job["door"]) == ("15deg", "z-,x+", "y-")
    assert (job["order"], job["balance"], job["powder"]) == ("delivery", ["10%"], "0.45:30%")
    assert (job["groups"], job["objective"]) == (["apart"], "value")
    (cube, *_) = job["files"]
    assert cube["count"] == "max"
    more_of_cube = {"max_tilt": "30", "down": "z- x+", "stop": "2"}
    assert cube["fields"] == {"group": "left", "value": "3", "mass": "20", **more_of_cube}
    page.reload()
    page.locator("[name=diameter]").wait_for()
    assert page.locator("[name=diameter]").input_value() == "120"
    with page.expect_request("**/order") as again:
        page.locator("[name=clearance]").dispatch_event("change")
    assert again.value.post_data_json == job
    page.locator("#rows .box").nth(1).locator("button").click()


def test_a_container_is_a_name_or_a_file(page) -> None:
    kind = page.locator("#rows .box select").first
    for value, found in (("named", "prusa-mk4"), ("file", "plate.stl")):
        with page.expect_response("**/order") as answer:
            kind.select_option(value)
        assert page.locator("#rows option", has_text=found).count() == 1
        assert answer.value.ok
    kind.select_option("box")


def test_a_step_shows_how_much_of_it_is_done(page) -> None:
    page.evaluate("import('/page.js').then((one) => one.say('writing packing.3mf, 2 of 7'))")
    bar = page.locator("#progress:visible")
    bar.wait_for()
    assert bar.evaluate("one => [one.value, one.max]") == [2, 7]
    page.evaluate("import('/page.js').then((one) => one.say('done'))")
    bar.wait_for(state="hidden")


NAMELESS = """() => [...document.querySelectorAll("input, select, button, canvas, progress")]
  .filter((one) => !(one.labels && one.labels.length) && !one.ariaLabel && !one.textContent.trim()
    && !one.getAttribute("aria-labelledby")).map((one) => one.outerHTML)"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_scrolls_sideways_and_all_has_a_name(page, width, scheme) -> None:
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.evaluate("document.querySelectorAll('tr.more').forEach((one) => { one.hidden = false; })")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate(NAMELESS) == []
