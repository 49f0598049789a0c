"""The report in a browser: self-contained, with sortable tables and rotatable boxes."""

from __future__ import annotations

import io
import re
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from packit_sim.game.reports.examples import SOLUTION, gallery
from packit_sim.game.reports.page import page
from packit_sim.game.reports.runs import Runs
from packit_sim.render.image_files import RGBImage
from tests.runs import everyday, results, tasks, training

REFERENCE = Path(__file__).parent / "references" / "report-model.png"
"""A box of the gallery, from the usual side. To make it anew, delete it and run the tests."""

TOLERANCE = 4.0
"""Of 255, in the mean over a picture: renderers round unlike, a turn by one key is more."""

NO_WEBGL = """
const plain = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : plain.call(this, kind, ...rest);
};
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    agents = {"good/aligned/blbf": [34, 9], "bad/random/blbf": [3, 14]}
    played = results(folder / "played.jsonl", agents)
    runs = Runs.read([played, training(folder / "run", [0.5, 0.7])])
    known = {task.digest: task for task in tasks()[:2]}
    shown = gallery(runs, everyday(), 1, agent="good/aligned/blbf", tasks=known)
    out = folder / "report.html"
    out.write_text(page("A report", runs, shown, "packit report"), encoding="utf-8")
    return out


@pytest.fixture(scope="module")
def opened(chromium, file) -> Iterator[tuple[Any, list[str]]]:
    """The page in a small window, with its console messages, errors and requests."""
    shown = chromium.new_page(viewport={"width": 360, "height": 420}, color_scheme="light")
    shown.set_default_timeout(120_000)
    events: list[str] = []
    shown.on("console", lambda message: events.append(message.text))
    shown.on("pageerror", lambda error: events.append(str(error)))
    shown.on("request", lambda request: events.append(request.url))
    shown.goto(file.as_uri())
    yield shown, events
    shown.close()


@pytest.fixture
def shown(opened) -> Any:
    return opened[0]


@pytest.fixture
def card(shown) -> Any:
    """The first of the gallery, drawn, as it was at first."""
    found = shown.locator(".card").first
    found.scroll_into_view_if_needed()
    found.locator("canvas[data-drawn]").wait_for()
    return found


def picture(card: Any) -> RGBImage:
    """What a card's canvas shows once it is drawn as it stands, before white: (H, W, 3) of 255."""
    card.page.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
    data = card.locator("canvas").evaluate("(canvas) => canvas.toDataURL().split(',')[1]")
    drawn = Image.open(io.BytesIO(b64decode(data)))
    canvas = Image.new("RGBA", drawn.size, "white")
    return np.asarray(Image.alpha_composite(canvas, drawn).convert("RGB"), dtype=float)


def difference(one: RGBImage, other: RGBImage) -> float:
    return float(np.abs(one - other).mean())


def slide(card: Any, slider: str, value: int) -> None:
    card.locator(slider).evaluate(
        "(input, value) => { input.value = value; input.dispatchEvent(new Event('input')); }",
        value,
    )


def column(table: Any) -> list[str]:
    return table.locator("tbody th").all_inner_texts()


def test_it_loads_without_a_word_and_asks_for_nothing_but_itself(opened, card, file) -> None:
    assert opened[1] == [file.as_uri()]


def test_a_model_is_as_it_was_when_it_was_looked_at(card) -> None:
    now = picture(card)
    if not REFERENCE.exists():
        Image.fromarray(now.astype(np.uint8)).quantize(64).save(REFERENCE, optimize=True)
        pytest.fail(f"created {REFERENCE}: inspect it")
    with Image.open(REFERENCE) as kept:
        before = np.asarray(kept.convert("RGB"), dtype=float)
    assert now.shape == before.shape and difference(now, before) < TOLERANCE
    assert now.std() > 20  # not an empty canvas


def test_dragging_and_keys_turn_a_model_and_no_other(shown, card) -> None:
    other = shown.locator(".card").nth(1)
    at = other.locator("canvas").get_attribute("data-drawn")
    before = picture(card)
    frame = card.locator("canvas").bounding_box()
    x, y = frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2
    shown.mouse.move(x, y)
    assert re.fullmatch(r"\d+ .*: \d+\.\d% of the reward", card.locator(".tip").inner_text())
    shown.mouse.down()
    shown.mouse.move(x + 90, y, steps=2)
    shown.mouse.up()
    dragged = picture(card)
    assert difference(before, dragged) > 2 * TOLERANCE
    card.locator("canvas").focus()
    shown.keyboard.press("ArrowRight")
    turned = picture(card)
    assert difference(dragged, turned) > TOLERANCE
    shown.keyboard.press("ArrowLeft")
    assert difference(dragged, picture(card)) < TOLERANCE / 4
    assert other.locator("canvas").get_attribute("data-drawn") == at


@pytest.mark.slow
def test_sliders_and_choices_change_what_is_seen(shown, card) -> None:
    whole = picture(card)
    slide(card, ".step", 0)
    empty = picture(card)
    slide(card, ".step", 34)
    assert card.locator("output", has_text="34 of 34").count() == 1
    assert difference(whole, picture(card)) < TOLERANCE / 4 < difference(whole, empty)
    slide(card, ".apart", 100)
    assert difference(whole, picture(card)) > TOLERANCE
    slide(card, ".apart", 0)
    shown.locator("#coloring").select_option("order")
    assert shown.locator("#ramp").is_visible()
    assert difference(whole, picture(card)) > TOLERANCE
    shown.locator("#coloring").select_option("item")
    card.locator("select").select_option(label="bad/random/blbf")
    assert card.locator(".summary").inner_text().startswith("3 of ")
    assert difference(whole, picture(card)) > TOLERANCE
    card.locator("select").select_option(label=SOLUTION)
    assert card.locator(".total").inner_text() == "1.000"
    assert card.locator("output", has_text="35 of 35").count() == 1
    card.locator("select").select_option(label="good/aligned/blbf")
    assert difference(whole, picture(card)) < TOLERANCE / 4


def test_at_1280_pixels_nothing_scrolls_sideways(chromium, tmp_path) -> None:
    """Long names of agents wrap: neither the page nor a table has a horizontal scroll bar."""
    names = (
        "largest-fitting-first/lowest/maximal-contact+beam=4",
        "largest-first/aligned/blbf+beam=4",
        "random/random/random",
    )
    played = results(tmp_path / "played.jsonl", {name: [34, 9] for name in names})
    text = page("A report", Runs.read([played]), None, "packit report")
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    wide = chromium.new_page(viewport={"width": 1280, "height": 900})
    wide.goto((tmp_path / "report.html").as_uri())
    sizes = wide.evaluate(
        """[document.documentElement, ...document.querySelectorAll(".scroll")]
        .map((part) => [part.scrollWidth, part.clientWidth, part.innerText.length])"""
    )
    assert wide.locator("tbody th").first.inner_text() == names[0]
    wide.close()
    assert len(sizes) >= 3 and all(length for _, _, length in sizes)
    assert all(needed <= there for needed, there, _ in sizes), sizes


def test_tables_are_sorted_by_their_headings(shown) -> None:
    table = shown.locator("#scores table")
    reward = table.locator("thead th", has_text="reward")
    shown.locator("#scores").scroll_into_view_if_needed()
    reward.locator("button").click()
    assert reward.get_attribute("aria-sort") == "descending"
    falling = column(table)
    reward.locator("button").click()
    assert reward.get_attribute("aria-sort") == "ascending"
    assert column(table) == falling[::-1] and len(set(falling)) == 2
    rewards = [
        float(t.split()[0]) for t in table.locator("tbody td:nth-child(3)").all_inner_texts()
    ]
    assert rewards == sorted(rewards)


def test_one_agent_at_a_time_is_compared_with(shown) -> None:
    visible = shown.locator(".against:visible")
    assert visible.count() == 1 and column(visible) == ["bad/random/blbf"]
    shown.locator("#against").select_option(label="bad/random/blbf")
    assert visible.count() == 1 and column(visible) == ["good/aligned/blbf"]


def test_dark_is_dark_and_text_stands_out_in_both(shown) -> None:
    def contrast() -> float:
        colors = shown.evaluate(
            "(({ color, backgroundColor }) => [color, backgroundColor])"
            "(getComputedStyle(document.body))"
        )
        light = []
        for color in colors:
            channels = np.array([int(n) for n in re.findall(r"\d+", color)[:3]]) / 255
            light.append(float(channels**2.2 @ (0.2126, 0.7152, 0.0722)))
        low, high = sorted(light)
        assert (light[1] < 0.05) == (scheme == "dark")
        return (high + 0.05) / (low + 0.05)

    for scheme in ("dark", "light"):
        shown.emulate_media(color_scheme=scheme)
        assert contrast() > 7


@pytest.mark.slow
def test_without_webgl_it_says_so_and_the_rest_works(chromium, file) -> None:
    shown = chromium.new_page(viewport={"width": 360, "height": 420})
    shown.add_init_script(NO_WEBGL)
    shown.goto(file.as_uri())
    card = shown.locator(".card").first
    assert "no WebGL" in card.inner_text()
    card.locator("select").select_option(label=SOLUTION)
    assert card.locator(".total").inner_text() == "1.000"
    shown.close()
