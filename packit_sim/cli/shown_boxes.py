"""What is drawn, filmed or exported, and how it looks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from PIL import ImageColor

from packit_sim.cli.inputs import decompose_shown, open_library
from packit_sim.cli.shape_tables import selection
from packit_sim.core.choices import BoxStyle, ColoringName
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.builtin import DEFAULT_LIBRARY
from packit_sim.game.datasets.pack_files import dataset_file, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Played
from packit_sim.geometry.items import BoxState, Contents, PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, CELL
from packit_sim.geometry.shapes import UP_AXES, Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import DISTANCE
from packit_sim.physics.settling import settle
from packit_sim.render.cameras import CAMERAS, Camera
from packit_sim.render.coloring import COLORINGS, ByNumber, ByShare, Coloring, by_item
from packit_sim.render.defaults import MAX_SIDE, RGB
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import Cut, Look

TURNTABLE = "turntable"
"""The name of the camera that moves around the box."""


VIEWS = 8
"""The number of views in a picture by that camera, in two rows."""

assert set(get_args(ColoringName)) == {*COLORINGS, "stability"}


def opened_library(library: str | None, dataset: str | None, split: str | None) -> ShapeLibrary:
    """Open the chosen library, or that of a dataset, or else the built-in one."""
    if dataset is None:
        return ShapeLibrary.open(library or DEFAULT_LIBRARY)
    return open_library(library, dataset, split)


def shown_box(
    dataset: str | None,
    split: str | None,
    number: int,
    task: bool,
    library: ShapeLibrary,
    categories: Sequence[str] | None,
    ids: Sequence[str] | None,
    color: ColoringName,
) -> tuple[Contents[Any], Layout | None, Coloring]:
    """Return what to draw, its layout unless it is in its box, and its colours."""
    if color == "stability" and (dataset is None or task):
        raise PackItError(
            "--color stability needs a packed box: leave it out, or give DATASET without --as-task"
        )
    rule = COLORINGS.get(color, by_item)
    if dataset is None:
        if not (categories or ids):
            raise PackItError("nothing to draw: give DATASET, or shapes by --category or --id")
        items = [Item(library[name]) for name in selection(library, categories, ids)]
        layout = Layout.standing(items)
        return BoxState(BOX_CELLS, layout.posed(items)), layout, rule
    if categories or ids:
        raise PackItError(
            f"--category and --id select from a library: leave them out, or {dataset!r}"
        )
    pack = picked(dataset, split, number)
    size = np.array(pack.cells) * CELL
    if task:
        items = list(pack.task(library).items)
        layout = Layout.standing(items, size)
        return BoxState(pack.cells, layout.posed(items)), layout, rule
    played = pack.provenance
    if color == "share" and isinstance(played, Played) and played.total > 0:
        rule = ByShare(pack.counted_volume / played.total)
    if not pack.is_on_grid and color != "stability":
        settled = pack.placed(library)
        return BoxState(pack.cells, settled), Layout.packed(settled, size), rule
    box = pack.contents(library)
    return box, None, _by_stability(box) if color == "stability" else rule


def _by_stability(box: Contents[PlacedItem]) -> Coloring:
    """Colour items by the largest movement of their points under gravity."""
    decompose_shown([placed.item.shape for placed in box.placed])
    farthest = {n: item.farthest for n, item in enumerate(settle(box).items)}
    return ByNumber("moves under gravity", farthest, low=0.0, high=4 * DISTANCE, spec=".2f")


def picked(dataset: str, split: str | None, number: int) -> Pack:
    """Read a pack of a dataset by its number. Raises PackItError if there is none."""
    read = read_packs(dataset_file(dataset, split))
    if number >= len(read):
        raise PackItError(f"{dataset} has no pack {number}: choose 0 to {len(read) - 1}")
    return read[number]


def read_look(
    camera: str,
    background: str,
    box: BoxStyle,
    explode: float,
    cut: str | None,
    coloring: Coloring,
) -> Look:
    """Read the texts of options as a look."""
    return Look(
        _camera(camera),
        _background(background),
        box,
        explode,
        None if cut is None else _cut(cut),
        coloring,
    )


def _camera(text: str) -> Camera:
    if text in CAMERAS or text == TURNTABLE:
        return CAMERAS.get(text, CAMERAS["iso"])
    try:
        azimuth, elevation = map(float, text.split(","))
        return Camera(azimuth, elevation)
    except ValueError as error:
        why = f": {error}" if str(error).startswith("camera") else ""
        raise PackItError(
            f"camera {text!r} is not known{why}: choose {', '.join(CAMERAS)}, {TURNTABLE}, "
            "or AZIMUTH,ELEVATION in degrees, such as 30,45"
        ) from None


def _background(text: str) -> RGB:
    try:
        red, green, blue = ImageColor.getrgb(text)[:3]
    except ValueError:
        raise PackItError(
            f"background {text!r} is not a colour: choose a name, such as white, or #rrggbb"
        ) from None
    return red, green, blue


def _cut(text: str) -> Cut:
    try:
        axis, at = text.split("=")
        (known,) = (name for name in UP_AXES if name == axis)
        return Cut(known, float(at))
    except ValueError:
        raise PackItError(
            f"cut {text!r} is not possible: choose an axis and where on it, in box units above 0, "
            "such as y=0.6"
        ) from None


def read_size(text: str) -> tuple[int, int]:
    """Parse width and height, in pixels."""
    found = re.fullmatch(r"(\d+)(?:x(\d+))?", text)
    if found:
        width, height = int(found[1]), int(found[2] or found[1])
        if all(16 <= side <= MAX_SIDE for side in (width, height)):
            return width, height
    raise PackItError(
        f"size {text!r} is not possible: choose 16 to {MAX_SIDE} pixels, such as 512, or 1280x720"
    )
