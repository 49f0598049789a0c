"""Packing instructions: their words, their order, and the page."""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.rotations import MATRICES
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.removal import Route
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.results import instructions
from packit_sim.parts.results.instructions import NEW, packing_instructions
from packit_sim.parts.results.wording import place_in_words, turn_in_words, way_in_words
from tests.packed_parts import BAR, CAGE, cuboid, packed, turned, u_profile


@pytest.mark.parametrize(
    ("axis", "degrees", "words"),
    [
        ((0, 0, 1), 0, "Leave it as it is in its file."),
        ((0, 0, 1), 90, "Upright, turned 90° to the left (anticlockwise seen from above): "
         "its front faces the right wall."),
        ((0, 0, 1), -90, "Upright, turned 90° to the right (clockwise seen from above): "
         "its front faces the left wall."),
        ((0, 0, 1), 180, "Upright, turned half round: its front faces the back wall."),
        ((0, 0, 1), 30, "Upright, turned 30° to the left (anticlockwise seen from above)."),
        ((0, 1, 0), 180, "Upside down; its front faces the front wall."),
        ((1, 0, 0), 90, "Tipped over: its top faces the front wall, its front faces down."),
        ((1, 0, 0), -90, "Tipped over: its top faces the back wall, its front faces up."),
        ((0, 1, 0), 90, "Tipped over: its top faces the right wall, its front faces the front "
         "wall."),
        ((1, 0, 0), 30, "Turned freely, see the pictures: its top leans 30° from the vertical "
         "towards the front wall (a turn by 30° about (1.00, 0.00, 0.00))."),
    ],
)  # fmt: skip
def test_turns_are_said_in_words(axis, degrees, words) -> None:
    assert turn_in_words(turned(axis, np.radians(degrees))) == words


def test_a_rotation_may_be_rounded() -> None:
    assert turn_in_words(np.eye(3) * (1 + 1e-12)) == "Leave it as it is in its file."
    half = np.diag((1.0, -1.0, -1.0)) * (1 + 1e-12)
    assert turn_in_words(half) == "Upside down; its front faces the back wall."


def test_each_of_the_24_rotations_has_its_own_words() -> None:
    assert len({turn_in_words(turn.astype(float)) for turn in MATRICES}) == 24


def test_a_way_in_is_the_way_out_reversed() -> None:
    assert way_in_words(Route((), "up"), "mm") == "Lower it straight down."
    route = Route((("up", 15.0), ("+x", 30.25)), "up")
    assert way_in_words(route, "mm") == (
        "Lower it straight down, then push it to the left by 30.2 mm, then lower it by 15 mm."
    )
    assert way_in_words(Route((), "-y"), "mm") == "Push it in through the front."


def test_places_are_measured_from_the_walls() -> None:
    assert place_in_words(np.array((12.0, 0.0, 30.0)), "mm") == (
        "12 mm from the left wall, 0 mm from the front wall, 30 mm up."
    )
    words = "1 in from the left wall, 2 in from the front wall, on the floor."
    assert place_in_words(np.array((1.0, 2.0, -1e-9)), "in") == words


@pytest.fixture(autouse=True, scope="module")
def _small_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(instructions, "LARGE", (250, 180))
        patch.setattr(instructions, "SMALL", (105, 85))
        patch.setenv("PACKIT_RENDERER", "software")  # starts at once
        yield


@pytest.fixture(name="page", scope="module")
def _page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The U around the bar, which has to be slid in, and a cube with a hostile name."""
    cube = cuboid((0, 60, 0), (20, 80, 20))
    packing = packed(u_profile(), BAR, cube, names=("U", "bar", "<img src=x>"))
    file = tmp_path_factory.mktemp("pages") / "instructions.html"
    return packing_instructions(file, [("Box A", packing)]).read_text(encoding="utf-8")


def test_a_page_has_a_step_for_each_part_in_an_order_that_works(page) -> None:
    names = [
        html.unescape(name) for name in re.findall(r"<h2>.*?</span>(.*?)</h2>", page, flags=re.S)
    ]
    assert sorted(names) == ["<img src=x>", "U", "bar"]
    assert "<img src=x>" not in page
    assert re.findall(r"step (\d) of 3", page) == ["1", "2", "3"]
    later = max(("U", "bar"), key=names.index)
    words = {"U": "then push it to the", "bar": "then push it to the"}[later]
    steps = page.split('class="sheet step"')[1:]
    assert words in steps[names.index(later)]
    assert "Lower it straight down." in steps[names.index("<img src=x>")]


def test_a_page_loads_nothing_from_outside(page) -> None:
    assert "default-src 'none'" in page
    assert set(re.findall(r'(?:src|href)="(\w+):', page)) == {"data"}


def test_the_new_part_is_orange_and_alone_so(page) -> None:
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", page)
    assert len(pictures) == 1 + 3 * 4
    share = [_orange(picture) for picture in pictures[1:]]
    assert all(each > 0.003 for each in share)
    assert all(each > 0.02 for each in share[1::4] + share[2::4])


def _orange(picture: str) -> float:
    """The share of a picture's pixels that have the hue of new parts."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("HSV")
    hue, saturation, _ = np.asarray(image).astype(int).transpose(2, 0, 1)
    pixel = Image.new("RGB", (1, 1), tuple(round(255 * c) for c in NEW)).convert("HSV")
    wanted = pixel.getpixel((0, 0))
    assert isinstance(wanted, tuple)
    return float(((abs(hue - wanted[0]) < 8) & (saturation > 120)).mean())


def test_parts_without_a_way_in_and_several_boxes_are_said(tmp_path: Path) -> None:
    ball = cuboid((38, 38, 38), (62, 62, 62))
    packing = packed(ball, CAGE, names=("ball", "cage"))
    both = replace(
        packing,
        objective="bins",
        placements=(*packing.placements, Placement(0, box=1)),
    )
    page = packing_instructions(tmp_path / "a.html", [("Crate", both)]).read_text(encoding="utf-8")
    assert "<h1>Crate, 1 of 2</h1>" in page and "<h1>Crate, 2 of 2</h1>" in page
    assert page.count("No straight way in was found") == 2


def test_fixed_parts_are_in_the_box_from_the_start(tmp_path: Path) -> None:
    packing = packed(cuboid((0, 0, 0), (20, 20, 20)), CAGE, names=("cube", "cage"))
    drawn: list[tuple[str, int, int]] = []
    file = packing_instructions(
        tmp_path / "a.html",
        [("Box", packing)],
        constraints=Constraints(fixed=frozenset({1})),
        progress=lambda *step: drawn.append(step),
    )
    assert drawn == [("drawing the instructions", 0, 1)]
    page = file.read_text(encoding="utf-8")
    assert "step 1 of 1" in page and "</span>cage" not in page


def test_a_packing_without_parts_is_one_clear_error(tmp_path: Path) -> None:
    empty = replace(packed(CAGE), placements=())
    with pytest.raises(ArgumentError, match="without parts"):
        packing_instructions(tmp_path / "a.html", [("Box", empty)])
    assert not (tmp_path / "a.html").exists()
