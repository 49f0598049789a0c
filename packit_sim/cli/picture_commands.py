"""`packit render`, `film` and `export`: pictures, films and files of packed boxes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import typer
from PIL import ImageColor

from packit_sim.cli.console import (
    DatasetArgument,
    DatasetLibraryOption,
    SplitOption,
    checked_dataset,
    decompose_shown,
    open_library,
    prepare_folder,
    progress_bars,
)
from packit_sim.cli.output import NOTHING_WRITTEN, print_written, stoppable
from packit_sim.cli.shape_commands import CategoryOption, selection
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.pack_files import DEFAULT_LIBRARY, dataset_file, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Played
from packit_sim.geometry.items import BoxState, Contents, PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, CELL
from packit_sim.geometry.shapes import UP_AXES, Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import DISTANCE
from packit_sim.physics.settling import settle
from packit_sim.render import export, films, video
from packit_sim.render.cameras import CAMERAS, Camera
from packit_sim.render.coloring import COLORINGS, ByNumber, ByShare, Coloring, by_item
from packit_sim.render.image_files import MAX_SIDE, RGBImage, save_png
from packit_sim.render.layouts import Layout
from packit_sim.render.legends import add_legend
from packit_sim.render.looks import BACKGROUND, RGB, BoxStyle, Cut, Look
from packit_sim.scene import Scene

USUAL_BACKGROUND = f"#{bytes(BACKGROUND).hex()}"

TURNTABLE = "turntable"
"""The name of the camera that moves around the box."""

VIEWS = 8
"""The number of views in a picture by that camera, in two rows."""

ColoringName = Literal["item", "category", "order", "share", "stability"]
assert set(get_args(ColoringName)) == {*COLORINGS, "stability"}

PackOption = Annotated[
    int, typer.Option("--pack", min=0, help="Number of the pack in the dataset.")
]
CameraOption = Annotated[
    str,
    typer.Option(help="iso, top, front, turntable (all round), or AZIMUTH,ELEVATION in degrees."),
]
SizeOption = Annotated[str, typer.Option(help="Size in pixels: SIDE or WIDTHxHEIGHT.")]
BackgroundOption = Annotated[str, typer.Option(help="Background: a colour's name, or #rrggbb.")]
BoxStyleOption = Annotated[BoxStyle | None, typer.Option(help="Style of the box; ghost: of glass.")]
ExplodeOption = Annotated[
    float, typer.Option(min=0.0, help="Move the items apart by this share of their distances.")
]
CutOption = Annotated[
    str | None, typer.Option(help="Cut away everything beyond a plane, such as y=0.6.")
]
ColorOption = Annotated[ColoringName, typer.Option(help="Meaning of the items' colours.")]


def render_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Output file: .png, or .npz of arrays.")],
    dataset: Annotated[
        str | None,
        typer.Argument(
            metavar="[DATASET]",
            callback=checked_dataset,
            help="Dataset or results: a name (see `packit datasets list`), a folder or a file.",
        ),
    ] = None,
    split: SplitOption = None,
    pack: PackOption = 0,
    as_task: Annotated[
        bool, typer.Option("--as-task", help="Draw the items next to the empty box.")
    ] = False,
    library: DatasetLibraryOption = None,
    category: CategoryOption = None,
    id: Annotated[
        list[str] | None, typer.Option("--id", help="Only this shape; may be repeated.")
    ] = None,
    camera: CameraOption = "iso",
    size: SizeOption = "512",
    background: BackgroundOption = USUAL_BACKGROUND,
    box_style: BoxStyleOption = None,
    explode: ExplodeOption = 0.0,
    cut: CutOption = None,
    color: ColorOption = "item",
    legend: Annotated[bool, typer.Option(help="Explain the colours at the right.")] = True,
) -> None:
    """Draw a pack, a task or a result, or without DATASET shapes of a library side by side.

    A .npz file contains the image, depth, segmentation and the camera's projection as arrays.

    Example: packit render starter --pack 2 --camera 30,45 --out pack.png
    """
    if out.suffix.lower() not in (".png", ".npz"):
        raise PackItError(f"{out} is not a picture: choose a name that ends in .png or .npz")
    around = camera == TURNTABLE
    if around and out.suffix.lower() == ".npz":
        raise PackItError(f"{out} can't contain {VIEWS} views: choose another camera for arrays")
    width, height = _size(size)
    opened = _opened(library, dataset, split)
    shown, layout, coloring = _shown(dataset, split, pack, as_task, opened, category, id, color)
    style: BoxStyle = box_style or ("none" if dataset is None else "edges")
    look = _look(camera, background, style, explode, cut, coloring)
    prepare_folder(out, dataset)
    with stoppable(NOTHING_WRITTEN), Scene(shown) as scene:
        if around:
            frames = list(films.turning(shown, VIEWS, look))
            if layout is not None:
                layout = layout.all_round(np.array(shown.cells) * CELL)
            shots = [scene.snapshot(width, height, at, layout or way) for at, way in frames]
        else:
            shots = [scene.snapshot(width, height, look, layout)]
        if out.suffix.lower() == ".npz":
            shots[0].save_arrays(out)
        else:
            half = -(-len(shots) // 2)
            rows = [shots[:half], shots[half:]] if around else [shots]
            image = np.concatenate([np.concatenate([s.image for s in row], axis=1) for row in rows])
            if legend and shots[0].legend is not None:
                image = add_legend(image, shots[0].legend, look.background)
            save_png(image, out, scene.renderer)
        print_written(out, f" by the {scene.renderer} renderer")


def film_command(
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Output file: .mp4 or .gif.")],
    split: SplitOption = None,
    pack: PackOption = 0,
    library: DatasetLibraryOption = None,
    camera: CameraOption = "iso",
    seconds: Annotated[
        float | None,
        typer.Option(min=0.1, help="Length in seconds; default: by the number of items."),
    ] = None,
    fps: Annotated[int, typer.Option(min=1, max=100, help="Frames per second.")] = 25,
    size: SizeOption = "960x540",
    background: BackgroundOption = USUAL_BACKGROUND,
    box_style: BoxStyleOption = None,
    explode: ExplodeOption = 0.0,
    cut: CutOption = None,
    color: ColorOption = "item",
) -> None:
    """Film how a pack is packed, item by item, or with the camera turntable a turn around it.

    --cut and --explode need the camera turntable.

    Example: packit film starter --pack 2 --out pack.mp4
    """
    video.require(out)
    width, height = _size(size)
    opened = _opened(library, dataset, split)
    shown, _, coloring = _shown(dataset, split, pack, False, opened, None, None, color)
    look = _look(camera, background, box_style or "edges", explode, cut, coloring)
    if camera == TURNTABLE:
        frames = list(films.turning(shown, max(1, round((seconds or 8.0) * fps)), look))
    else:
        if cut or explode:
            raise PackItError(
                "--cut and --explode are not possible while a box is packed: choose --camera "
                f"{TURNTABLE}, which films a turn around it, or leave them out"
            )
        pace = films.Pace(fps)
        if seconds is not None:
            pace = films.Pace.lasting(seconds, len(shown.placed), fps)
        frames = list(films.packing(shown, look, pace))
    prepare_folder(out, dataset)
    with stoppable(NOTHING_WRITTEN), progress_bars() as progress:
        bar = progress.add_task("filming", total=len(frames), note="")

        def pictures() -> Iterator[RGBImage]:
            for picture in films.shot(shown, frames, width, height):
                yield picture
                progress.advance(bar)

        video.write(out, pictures(), fps)
    print_written(out, f": {len(frames)} frames")


def export_command(
    dataset: DatasetArgument,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Output file: .glb, .3mf, .stl or .json.")
    ],
    split: SplitOption = None,
    pack: PackOption = 0,
    library: DatasetLibraryOption = None,
    unit_mm: Annotated[
        float, typer.Option("--unit-mm", help="Millimetres per box unit, in .3mf and .stl.")
    ] = export.UNIT_MM,
    color: ColorOption = "item",
) -> None:
    """Write a packed box for other tools, with names, poses and colours of its items.

    A .json file has a folder of meshes next to it; `packit verify` checks both.

    Example: packit export results.jsonl --pack 1 --out box.3mf
    """
    export.require(out)
    opened = _opened(library, dataset, split)
    shown, _, coloring = _shown(dataset, split, pack, False, opened, None, None, color)
    prepare_folder(out, dataset, field="items" if out.suffix.lower() == ".json" else None)
    with stoppable(NOTHING_WRITTEN):
        export.export(shown, out, coloring=coloring, unit_mm=unit_mm)
    print_written(out, f": {len(shown.placed)} items")


def _opened(library: str | None, dataset: str | None, split: str | None) -> ShapeLibrary:
    """Open the chosen library, or that of a dataset, or else the built-in one."""
    if dataset is None:
        return ShapeLibrary.open(library or DEFAULT_LIBRARY)
    return open_library(library, dataset, split)


def _shown(
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


def _look(
    camera: str,
    background: str,
    box: BoxStyle,
    explode: float,
    cut: str | None,
    coloring: Coloring,
) -> Look:
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


def _size(text: str) -> tuple[int, int]:
    """Parse width and height, in pixels."""
    found = re.fullmatch(r"(\d+)(?:x(\d+))?", text)
    if found:
        width, height = int(found[1]), int(found[2] or found[1])
        if all(16 <= side <= MAX_SIDE for side in (width, height)):
            return width, height
    raise PackItError(
        f"size {text!r} is not possible: choose 16 to {MAX_SIDE} pixels, such as 512, or 1280x720"
    )
