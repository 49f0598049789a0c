"""Contact sheets: contents and positions of tiles and labels, and errors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh import creation

from packit_sim.core.errors import MeshError, RenderError
from packit_sim.geometry.shapes import Shape
from packit_sim.render import contact_sheets, lettering
from packit_sim.render.contact_sheets import contact_sheet, picture
from packit_sim.render.defaults import BACKGROUND
from packit_sim.render.image_files import RGBImage
from tests.examples import OFTEN_OPENED
from tests.zoo import BALL, BOWL, CUBE, PLATE, RING, ZOO

SIDE = 96
ROD = Shape.from_mesh(creation.box((1, 0.04, 0.04)), "rod")
POLE = Shape.from_mesh(creation.box((0.04, 0.04, 1)), "pole")
CONE = Shape.from_mesh(creation.cone(0.5, 1), "cone")


pytestmark = pytest.mark.usefixtures("software")


def inked(image: RGBImage) -> np.ndarray:
    """Bool (H, W): pixels that differ from the background so that one can see it."""
    return np.abs(image.astype(int) - BACKGROUND).max(axis=2) > 16


def tile(image: RGBImage, row: int, column: int, side: int = SIDE) -> tuple[RGBImage, RGBImage]:
    """The picture and the label of one tile of a sheet."""
    gap, strip = side // 20, len(contact_sheets.label_image("", side))
    y, x = gap + row * (side + strip + gap), gap + column * (side + gap)
    return image[y : y + side, x : x + side], image[y + side : y + side + strip, x : x + side]


@pytest.mark.parametrize("shape", [*ZOO, ROD, POLE, CONE], ids=lambda shape: shape.id)
def test_a_picture_is_filled_in_one_direction_and_centred(shape: Shape) -> None:
    image = picture(shape, SIDE)
    assert (image.shape, image.dtype) == ((SIDE, SIDE, 3), np.uint8)
    rows, columns = (np.flatnonzero(inked(image).any(axis=axis)) for axis in (1, 0))
    spans = [int(line[-1] - line[0]) + 1 for line in (rows, columns)]
    assert 0.9 * SIDE <= max(spans) <= 0.98 * SIDE
    for line in (rows, columns):
        assert abs(line[0] + line[-1] - (SIDE - 1)) <= 0.1 * SIDE


def test_how_much_of_a_picture_shapes_cover() -> None:
    shares = {shape.id: inked(picture(shape, SIDE)).mean() for shape in (CUBE, BALL, RING, POLE)}
    assert 0.45 < shares["cube"] < 0.75
    assert np.pi / 4 * 0.9**2 < shares["ball"] < np.pi / 4
    assert 0.2 < shares["ring"] < 0.6
    assert 0.02 < shares["pole"] < 0.12


def test_a_cube_shows_three_faces_of_which_the_top_is_brightest(renderer: str) -> None:
    image = picture(CUBE, SIDE).astype(int)
    top, front, right = (image[y, x].sum() for y, x in ((20, 50), (60, 30), (60, 75)))
    assert top > 1.05 * front > 1.1 * right


def test_the_front_is_in_front() -> None:
    step = [creation.box((1, 1, 0.5)), creation.box((1, 0.5, 1)).apply_translation((0, 0.25, 0.25))]
    seat = Shape.from_mesh(trimesh.util.concatenate(step), "seat")
    back = Shape(seat.mesh.copy().apply_scale((1, -1, 1)), "back", "")
    seen, hidden = (inked(picture(shape, SIDE))[: SIDE // 2].sum() for shape in (seat, back))
    assert seen < 0.9 * hidden


def test_both_sides_of_an_open_mesh_are_drawn(renderer: str) -> None:
    bowl, upside_down = BOWL, Shape(BOWL.mesh.copy(), "inverted", "")
    upside_down.mesh.invert()
    ours, theirs = inked(picture(bowl, SIDE)), inked(picture(upside_down, SIDE))
    assert (ours != theirs).mean() < 0.01
    middle = ours[:, SIDE // 2]
    assert middle.sum() > 0.6 * SIDE


def test_tiles_stand_in_their_places(renderer: str) -> None:
    shapes = (CUBE, BALL, RING, ROD, PLATE)
    sheet = contact_sheet(((shape.id, shape) for shape in shapes), side=SIDE)
    assert sheet.renderer == renderer
    for n, shape in enumerate(shapes):
        image, label = tile(sheet.image, *divmod(n, 3))
        assert inked(image).any() and inked(label).any()
        assert np.array_equal(label, contact_sheets.label_image(shape.id, SIDE))
        if shape in (CUBE, ROD):
            assert np.array_equal(image, picture(shape, SIDE))
    image, label = tile(sheet.image, 1, 2)
    assert not inked(image).any() and not inked(label).any()


@pytest.mark.parametrize(
    ("count", "columns", "grid"),
    [
        *((1, None, (1, 1)), (4, None, (2, 2)), (5, None, (2, 3)), (12, None, (3, 4))),
        *((5, 1, (5, 1)), (5, 4, (2, 4)), (5, 9, (1, 5))),
    ],
)
def test_the_size_of_the_grid(count: int, columns: int | None, grid: tuple[int, int]) -> None:
    sheet = contact_sheet([(str(n), "none") for n in range(count)], columns, side=40)
    strip = len(contact_sheets.label_image("", 40))
    rows, across = grid
    assert sheet.image.shape == (rows * (42 + strip) + 2, across * 42 + 2, 3)
    assert inked(tile(sheet.image, *divmod(count - 1, across), side=40)[0]).any()


def test_labels_are_shortened_in_the_middle() -> None:
    font = contact_sheets.sheet_font(SIDE)
    assert lettering.shortened("mug", font, 80) == "mug"
    short = lettering.shortened("category/a-very-long-name-0017", font, 80)
    start, end = short.split(lettering.ELLIPSIS)
    assert start and "category/a-very-long-name-0017".startswith(start)
    assert end and "category/a-very-long-name-0017".endswith(end)
    assert 65 < font.getlength(short) <= 80
    assert lettering.shortened("mug", font, 1) == lettering.ELLIPSIS
    assert not inked(contact_sheets.label_image("m" * 500, SIDE))[:, [0, 1, -2, -1]].any()


@pytest.mark.parametrize("side", [16, 33, 160, 600])
@pytest.mark.parametrize(
    "text", ["", " ", "a\nb\tc", "Käse für 2 €", "杯子", "👍", "\udce9\x00\u202e", "x" * 10_000]
)
def test_any_text_can_be_a_label_or_a_message(text: str, side: int) -> None:
    label, other = (contact_sheets.label_image(one, side) for one in (text, "mug"))
    assert label.shape == other.shape
    assert contact_sheets.message_image(text, side).shape == (side, side, 3)


def test_what_the_font_does_not_have() -> None:
    assert lettering.plain("Käse\n à  la carte") == "Kase a la carte"
    assert lettering.plain("杯子-1\udce9\x00") == "??-1??"


def test_messages_are_wrapped_at_spaces_and_within_long_words() -> None:
    font = contact_sheets.sheet_font(SIDE)
    text = "the file ends early: /data/" + "deep/" * 12 + "mug.stl holds nothing"
    lines = list(lettering.lines_of(text, font, 90))
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert all(font.getlength(line) <= 90 and line == line.strip() for line in lines)
    assert lines[0].split() == text.split()[: len(lines[0].split())]
    shown = inked(contact_sheets.message_image(text, SIDE))
    assert 3 < np.count_nonzero(np.diff(shown.any(axis=1).astype(int)) == 1) < len(lines) + 3
    assert not shown[[0, -1]].any() and not shown[:, [0, -1]].any()
    ends = (
        contact_sheets.message_image("too long " * 100, SIDE),
        contact_sheets.message_image("too long " * 9, SIDE),
    )
    assert not np.array_equal(*ends)


def test_a_message_replaces_a_failed_shape_and_the_rest_is_drawn() -> None:
    tiles = [("broken", str(MeshError("no triangles"))), ("cube", CUBE), ("gone", "no file")]
    sheet = contact_sheet(tiles, columns=3, side=SIDE)
    messages = [tile(sheet.image, 0, n)[0] for n in (0, 2)]
    for message in messages:
        red, green, blue = message[inked(message)].mean(axis=0)
        assert red > green + 30 and red > blue + 30
    assert not np.array_equal(*messages)
    assert np.array_equal(tile(sheet.image, 0, 1)[0], picture(CUBE, SIDE))


def test_tiles_are_taken_one_at_a_time() -> None:
    events = []

    def tiles() -> Iterator[tuple[str, Shape | str]]:
        for shape in (CUBE, BALL):
            events.append(shape.id)
            yield shape.id, shape

    contact_sheet(tiles(), side=32, on_tile=lambda: events.append("drawn"))
    assert events == ["cube", "drawn", "ball", "drawn"]


def test_the_same_again_and_in_another_order() -> None:
    tiles = [(shape.id, shape) for shape in ZOO]
    first, again = (contact_sheet(tiles, columns=1, side=40).image for _ in range(2))
    assert np.array_equal(first, again)
    backwards = contact_sheet(tiles[::-1], columns=1, side=40).image
    for n in range(len(tiles)):
        ours, theirs = tile(first, n, 0, 40), tile(backwards, len(tiles) - 1 - n, 0, 40)
        assert np.array_equal(ours[0], theirs[0]) and np.array_equal(ours[1], theirs[1])


@pytest.mark.parametrize("renderer", OFTEN_OPENED, indirect=True)
def test_many_shapes_need_more_than_one_world(
    renderer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiles = [(shape.id, shape) for shape in ZOO[:3]]
    in_one = contact_sheet(tiles, side=SIDE)
    monkeypatch.setattr("packit_sim.render.scene.MAX_SHAPES", 1)
    in_three = contact_sheet(tiles, side=SIDE)
    assert np.array_equal(in_one.image, in_three.image)


def test_save_names_the_renderer_and_leaves_no_rest(tmp_path: Path) -> None:
    sheet = contact_sheet([("cube", CUBE)], side=32)
    path = tmp_path / "sheet.png"
    assert sheet.save(path) == "software"
    with Image.open(path) as image:
        assert (image.format, image.info["Renderer"]) == ("PNG", "software")
        assert np.array_equal(np.asarray(image), sheet.image)
    with pytest.raises(RenderError, match="can't be written to"):
        sheet.save(tmp_path / "missing" / "sheet.png")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("side", [-1, 0, 15, 2049])
def test_impossible_sides(side: int) -> None:
    for draw in (lambda: picture(CUBE, side), lambda: contact_sheet([("cube", CUBE)], side=side)):
        with pytest.raises(ValueError, match=f"side {side} is not possible: 16 to 2048"):
            draw()


def test_impossible_sheets() -> None:
    for columns in (0, -3):
        with pytest.raises(ValueError, match=f"columns {columns} .*at least 1"):
            contact_sheet([("cube", CUBE)], columns)
    with pytest.raises(ValueError, match=r"0 tiles .*at least 1"):
        contact_sheet([])
