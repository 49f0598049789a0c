"""`packit render`, `film` and `export`: pictures, films and files of packed boxes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import (
    DatasetArgument,
    DatasetLibraryOption,
    SplitOption,
    checked_dataset,
)
from packit_sim.cli.shape_commands import CategoryOption
from packit_sim.cli.stopping import NOTHING_WRITTEN, stoppable
from packit_sim.core.choices import BoxStyle, ColoringName
from packit_sim.core.errors import PackItError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.geometry.lattice import CELL
from packit_sim.render.defaults import BACKGROUND, UNIT_MM

with lazy_imports():
    import numpy as np

    from packit_sim.cli import output, shown_boxes, terminal
    from packit_sim.render import export, films, image_files, legends, video

USUAL_BACKGROUND = f"#{bytes(BACKGROUND).hex()}"

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
            autocompletion=completion.datasets,
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
    """Draw a pack, a task or a result; without DATASET, shapes of a library side by side.

    A .npz file contains the image, depth, segmentation and the camera's projection as arrays.

    Example: packit render starter --pack 2 --camera 30,45 --out pack.png
    """
    if out.suffix.lower() not in (".png", ".npz"):
        raise PackItError(f"{out} is not a picture: choose a name that ends in .png or .npz")
    around = camera == shown_boxes.TURNTABLE
    if around and out.suffix.lower() == ".npz":
        raise PackItError(
            f"{out} can't contain {shown_boxes.VIEWS} views: choose another camera for arrays"
        )
    width, height = shown_boxes.read_size(size)
    opened = shown_boxes.opened_library(library, dataset, split)
    shown, layout, coloring = shown_boxes.shown_box(
        dataset, split, pack, as_task, opened, category, id, color
    )
    style: BoxStyle = box_style or ("none" if dataset is None else "edges")
    look = shown_boxes.read_look(camera, background, style, explode, cut, coloring)
    output.prepare_folder(out, dataset)
    with stoppable(NOTHING_WRITTEN), packit_sim.Scene(shown) as scene:
        if around:
            frames = list(films.turning(shown, shown_boxes.VIEWS, look))
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
                image = legends.add_legend(image, shots[0].legend, look.background)
            image_files.save_png(image, out, scene.renderer)
        output.print_written(out, f" by the {scene.renderer} renderer")


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
    """Film how a pack is packed, item by item, or a turn around it (camera turntable).

    --cut and --explode need the camera turntable.

    Example: packit film starter --pack 2 --out pack.mp4
    """
    video.require(out)
    width, height = shown_boxes.read_size(size)
    opened = shown_boxes.opened_library(library, dataset, split)
    shown, _, coloring = shown_boxes.shown_box(
        dataset, split, pack, False, opened, None, None, color
    )
    look = shown_boxes.read_look(camera, background, box_style or "edges", explode, cut, coloring)
    if camera == shown_boxes.TURNTABLE:
        frames = list(films.turning(shown, max(1, round((seconds or 8.0) * fps)), look))
    else:
        if cut or explode:
            raise PackItError(
                "--cut and --explode are not possible while a box is packed: choose --camera "
                f"{shown_boxes.TURNTABLE}, which films a turn around it, or leave them out"
            )
        pace = films.Pace(fps)
        if seconds is not None:
            pace = films.Pace.lasting(seconds, len(shown.placed), fps)
        frames = list(films.packing(shown, look, pace))
    output.prepare_folder(out, dataset)
    with stoppable(NOTHING_WRITTEN), terminal.progress_bars() as progress:
        bar = progress.add_task("filming", total=len(frames), note="")

        def pictures() -> Iterator[image_files.RGBImage]:
            for picture in films.shot(shown, frames, width, height):
                yield picture
                progress.advance(bar)

        video.write(out, pictures(), fps)
    output.print_written(out, f": {len(frames)} frames")


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
    ] = UNIT_MM,
    color: ColorOption = "item",
) -> None:
    """Write a packed box for other tools, with names, poses and colours of its items.

    A .json file has a folder of meshes next to it; `packit verify` checks both.

    Example: packit export results.jsonl --pack 1 --out box.3mf
    """
    export.require(out)
    opened = shown_boxes.opened_library(library, dataset, split)
    shown, _, coloring = shown_boxes.shown_box(
        dataset, split, pack, False, opened, None, None, color
    )
    output.prepare_folder(out, dataset, field="items" if out.suffix.lower() == ".json" else None)
    with stoppable(NOTHING_WRITTEN):
        export.export(shown, out, coloring=coloring, unit_mm=unit_mm)
    output.print_written(out, f": {len(shown.placed)} items")
