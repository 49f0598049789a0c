"""The viewer's page in a real browser, headless Chromium: requests, contents and controls."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from packit_sim.game.datasets.pack_files import dataset_file, read_packs
from packit_sim.game.explorer.collection import PackCollection
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.web.box_view import corners, reach

pytest.importorskip("viser")
from packit_sim.game.explorer.explorer import Explorer

REFERENCES = Path(__file__).parent / "pages"
WINDOW = {"width": 640, "height": 480}
SMALL = 4
"""Pixels to one of a reference, an axis: edges are blurred away, places and colours stay."""

NEAR = 3.0
"""Mean difference of 255 that two renderings of the same may have."""

LONG = 120_000
"""Milliseconds that a busy machine may take to draw a page."""


@dataclass
class Opened:
    """A page, what it said, and what it asked for."""

    explorer: Explorer
    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def image(self) -> npt.NDArray[np.float64]:
        """The scene, (H, W, 3) of 255, once it stands still."""
        before = None
        deadline = time.monotonic() + LONG / 1000
        while time.monotonic() < deadline:
            canvas = self.page.locator("canvas").first.bounding_box()
            png = self.page.screenshot(timeout=LONG, clip=canvas)
            image = np.asarray(Image.open(io.BytesIO(png)).convert("RGB").reduce(SMALL), float)
            if before is not None and np.abs(image - before).max() < 1:
                return image
            before = image
            time.sleep(0.5)
        raise TimeoutError("the page does not stand still")

    def wait(self, holds: Callable[[], bool]) -> None:
        deadline = time.monotonic() + LONG / 1000
        while not holds():
            assert time.monotonic() < deadline, "the page did not do it"
            self.page.wait_for_timeout(100)
        self.explorer.wait()


@pytest.fixture(name="opened", scope="module")
def _opened(chromium) -> Iterator[Opened]:
    """One page for all tests: to start a browser and its WebGL takes seconds."""
    packs = read_packs(dataset_file("starter"))[:2]
    collection = PackCollection(packs, ShapeLibrary.open("everyday"))
    with Explorer(collection) as explorer:
        page = chromium.new_page(viewport=WINDOW)
        page.set_default_timeout(LONG)
        opened = Opened(explorer, page)
        page.on("console", lambda m: opened.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: opened.errors.append(str(error)))
        page.on("request", lambda request: opened.requests.append(request.url))
        page.on("websocket", lambda socket: opened.requests.append(socket.url))
        page.goto(explorer.address)
        page.locator(".mantine-Notification-closeButton").click()  # it tells that there is no GPU
        page.get_by_text("Why not here?").wait_for()
        yield opened
        page.close()


@pytest.fixture(autouse=True)
def _as_at_first(opened: Opened) -> None:
    """What the tests may have set: they stand by themselves."""
    opened.page.mouse.move(1, 1)  # what is under it is outlined
    controls = opened.explorer.controls
    controls.set_step(len(opened.explorer.views[0].placed))
    controls.item.value = controls.axis.value = controls.wanted.value = "nothing"
    controls.second.value = "nothing"
    controls.explode.value = 0.0
    opened.explorer.wait()


def pixels(opened: Opened, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(n, 2) where in the window points (n, 3) of the scene are."""
    (client,) = opened.explorer.page.server.get_clients().values()
    camera = client.camera
    import viser

    turn = viser.transforms.SO3(camera.wxyz).as_matrix()
    x, y, z = ((points - camera.position) @ turn).T
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    canvas = opened.page.locator("canvas").first.bounding_box()
    middle = canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2
    return np.stack((focal * x / z, focal * y / z), axis=1) + middle


def settled_like(opened: Opened, name: str) -> npt.NDArray[np.float64]:
    """The scene once it looks like the reference, which is made where there is none.

    What was asked for may be drawn seconds later on a busy machine, and stand still until then.
    """
    path = REFERENCES / f"{name}.png"
    image = opened.image()
    if not path.exists():
        REFERENCES.mkdir(exist_ok=True)
        Image.fromarray(image.astype(np.uint8)).save(path)
        pytest.fail(f"{path} was created: inspect it, and run again")
    reference = np.asarray(Image.open(path), dtype=float)
    deadline = time.monotonic() + LONG / 1000
    while (distance := np.abs(image - reference).mean()) >= NEAR:
        assert time.monotonic() < deadline, f"{distance} away from {path}"
        image = opened.image()
    return image


def test_the_page_loads_without_errors_and_asks_nothing_outside(opened: Opened) -> None:
    settled_like(opened, "whole")
    assert opened.errors == []
    address = opened.explorer.address
    own = (address, f"blob:{address}", address.replace("http", "ws"), "data:")
    assert [url for url in opened.requests if not url.startswith(own)] == []
    assert any(url.startswith("ws") for url in opened.requests)


def in_view(opened: Opened, points: npt.NDArray[np.float64]) -> bool:
    """Whether all points (n, 3) are."""
    canvas = opened.page.locator("canvas").first.bounding_box()
    places = pixels(opened, points)
    low = np.array((canvas["x"], canvas["y"]))
    high = low + np.array((canvas["width"], canvas["height"]))
    return bool((places > low).all() and (places < high).all())


def test_the_whole_box_is_in_view(opened: Opened) -> None:
    assert in_view(opened, corners((100, 100, 100)))


@pytest.mark.slow
def test_what_moves_apart_stays_in_view(opened: Opened) -> None:
    first = opened.explorer.views[0]
    apart = reach(first.contents(), 1.5)
    assert not in_view(opened, apart)
    opened.explorer.controls.explode.value = 1.5
    opened.explorer.wait()
    assert in_view(opened, apart)


def drag(opened: Opened, share: float) -> None:
    """Moves the step slider by a share of its length; keys would turn the camera as well."""
    track = opened.page.locator(".mantine-Slider-root").first.bounding_box()
    thumb = opened.page.locator('[role="slider"]').first.bounding_box()
    x, y = (thumb[start] + thumb[size] / 2 for start, size in (("x", "width"), ("y", "height")))
    mouse = opened.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + share * track["width"], y, steps=5)
    mouse.up()
    mouse.move(1, 1)


@pytest.mark.slow
def test_the_step_slider_moves_items(opened: Opened) -> None:
    whole = settled_like(opened, "whole")
    controls = opened.explorer.controls
    placed = len(opened.explorer.views[0].placed)
    drag(opened, -0.25)
    opened.wait(lambda: 0 < controls.request.step < placed)
    drag(opened, -1.0)
    opened.wait(lambda: controls.request.step == 0)
    empty = settled_like(opened, "empty")
    assert np.abs(empty - whole).mean() > 3 * NEAR


@pytest.mark.slow
def test_a_click_chooses_an_item_and_another_lets_it_go(opened: Opened) -> None:
    controls = opened.explorer.controls
    last = len(opened.explorer.views[0].placed) - 1
    handle = opened.explorer.boxes[0].items[last]
    settled_like(opened, "whole")  # all items are drawn: they can be hit
    ((x, y),) = pixels(opened, handle.position[None])
    opened.page.mouse.click(x, y, delay=100)
    opened.wait(lambda: controls.request.chosen is not None)
    chosen = controls.request.chosen
    assert chosen is not None
    text = f"{chosen} {opened.explorer.views[0].items[chosen].shape.id}"
    fields = opened.page.locator("input:visible")
    opened.wait(lambda: text in [one.input_value() for one in fields.all()])
    opened.image()
    opened.page.mouse.click(x, y, delay=100)
    opened.wait(lambda: controls.request.chosen != chosen)


@pytest.mark.slow
def test_a_cut_and_an_explosion_look_different(opened: Opened) -> None:
    whole = settled_like(opened, "whole")
    opened.explorer.controls.axis.value = "y"
    opened.explorer.wait()
    cut = settled_like(opened, "cut")
    opened.explorer.controls.axis.value = "nothing"
    opened.explorer.controls.explode.value = 0.4
    opened.explorer.wait()
    apart = settled_like(opened, "apart")
    for one, other in ((whole, cut), (whole, apart), (cut, apart)):
        assert np.abs(one - other).mean() > 2 * NEAR


@pytest.mark.slow
def test_why_an_item_can_not_stand_somewhere(opened: Opened) -> None:
    explorer, controls = opened.explorer, opened.explorer.controls
    controls.set_step(3)
    explorer.wait()
    controls.wanted.value = controls.wanted.options[1]
    explorer.wait()
    controls.set_query(0, (6, 6, 4))
    explorer.wait()
    settled_like(opened, "blocked")
    opened.page.get_by_text("Why not here?").click()
    opened.page.get_by_text("is in its way").wait_for()
    opened.page.get_by_text("To the first free place").click()
    opened.page.get_by_text("it fits").wait_for()
    settled_like(opened, "free")


@pytest.mark.slow
def test_two_stand_side_by_side_with_their_titles(opened: Opened) -> None:
    opened.explorer.controls.second.value = opened.explorer.controls.second.options[1]
    opened.explorer.wait()
    settled_like(opened, "beside")
    scene = opened.explorer.page.server.scene
    for node, view in zip(("/first", "/second"), opened.explorer.views, strict=True):
        title = scene.get_handle_by_name(f"{node}/title")
        assert title.text == view.name
        place = title.position + scene.get_handle_by_name(node).position
        assert in_view(opened, place[None])


@pytest.mark.slow
@pytest.mark.parametrize("window", [(390, 844), (1280, 800)])
def test_the_panel_does_not_cover_the_box(chromium, window: tuple[int, int]) -> None:
    collection = PackCollection(
        read_packs(dataset_file("starter"))[:1], ShapeLibrary.open("everyday")
    )
    with Explorer(collection) as explorer:
        width, height = window
        page = chromium.new_page(viewport={"width": width, "height": height}, color_scheme="dark")
        page.set_default_timeout(LONG)
        page.goto(explorer.address)
        page.get_by_text("Play", exact=True).wait_for()
        assert page.locator("html").get_attribute("data-mantine-color-scheme") == "dark"
        own = Opened(explorer, page)

        def is_free() -> bool:
            low, high = np.quantile(pixels(own, corners((100, 100, 100))), (0, 1), axis=0)
            panel = page.get_by_text("PackIt-Sim", exact=True).bounding_box()
            is_beside = high[0] < panel["x"] or high[1] < panel["y"]
            return bool(is_beside and (low > 0).all() and (high < window).all())

        own.wait(lambda: len(explorer.page.server.get_clients()) == 1)
        own.wait(is_free)
        (client,) = explorer.page.server.get_clients().values()
        initial = explorer.page.server.initial_camera
        client.camera.position = initial.position  # as a slow browser, or at "Reset View"
        client.camera.look_at = initial.look_at
        page.wait_for_timeout(500)
        own.wait(is_free)
        page.close()


def test_no_error_came_up_in_the_end(opened: Opened) -> None:
    assert opened.errors == []
