"""`packit pack`: user-supplied parts, packed into boxes at their real sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import option_presets
from packit_sim.cli.options import (
    AddressOption,
    ContainersOption,
    FileUnitOption,
    SearchBackendOption,
    SeedOption,
    TimeOption,
    UpOption,
    WallClearanceOption,
    WorkersOption,
    read_seconds,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.choices import Door, Goal, LoadingOrder
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import output, terminal
    from packit_sim.parts.filling import setting_texts
    from packit_sim.parts.reading import files as part_files
    from packit_sim.parts.reading import turnings
    from packit_sim.parts.results import check, record, summary


def pack_command(
    ctx: typer.Context,
    parts: Annotated[
        list[str],
        typer.Argument(
            metavar="PARTS",
            help="Mesh files, folders, or manifests (.csv, .xlsx). FILE=4: four copies, FILE=max: "
            "as many as fit, FILE=fill: as many as fit after everything else.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the packing.")],
    box: Annotated[
        list[str] | None,
        typer.Option(
            "--box",
            help="Sides of the box, such as 300x200x150mm; A:300x200x150mm names one of several; "
            "or a list of boxes (.csv, .xlsx).",
        ),
    ] = None,
    container: ContainersOption = None,
    objective: Annotated[
        Goal,
        typer.Option(
            help="Most volume, count or value; or all parts: least height, or fewest boxes."
        ),
    ] = "volume",
    clearance: Annotated[
        str, typer.Option(help="Smallest distance between two parts, such as 1mm.")
    ] = "0",
    clearance_z: Annotated[
        str | None, typer.Option(help="The same along z, if it differs.")
    ] = None,
    wall_clearance: WallClearanceOption = "0",
    rotations: Annotated[
        str,
        typer.Option(
            help="Rotations of parts: fixed, upright, yaw-N, flip-N, axis-N, cube or free."
        ),
    ] = "cube",
    max_tilt: Annotated[
        str | None,
        typer.Option(help="Largest angle of a part's up axis to the vertical, such as 15deg."),
    ] = None,
    down: Annotated[
        str | None,
        typer.Option(help="Sides that may face down, of x-, x+, y-, y+, z-, z+, such as z-,z+."),
    ] = None,
    keep_out: Annotated[
        list[str] | None,
        typer.Option(help="Mesh file of a volume that stays free, in the box's coordinates."),
    ] = None,
    fixed: Annotated[
        list[str] | None,
        typer.Option(help="Mesh file of a part in the box already, in the box's coordinates."),
    ] = None,
    removable: Annotated[
        bool, typer.Option("--removable", help="Every part can be taken out by straight moves.")
    ] = False,
    insertable: Annotated[
        bool, typer.Option("--insertable", help="Every part can be put in by one straight move.")
    ] = False,
    door: Annotated[
        Door, typer.Option(help="Side of the box through which parts come in; z+ is the top.")
    ] = "z+",
    order: Annotated[
        LoadingOrder | None,
        typer.Option(
            help="delivery: parts of a later stop never stand between those of an earlier one and "
            "the door."
        ),
    ] = None,
    separable: Annotated[
        bool,
        typer.Option(
            "--separable", help="No parts interlock: each can be moved out without turning."
        ),
    ] = False,
    stable: Annotated[
        str | None,
        typer.Option(help="Distance that parts may move under gravity at any stage, such as 2mm."),
    ] = None,
    boxes: Annotated[
        int | None,
        typer.Option(min=1, help="Number of boxes of each size; default: one, or as needed."),
    ] = None,
    max_mass: Annotated[
        list[str] | None,
        typer.Option(help="Most mass of the parts in a box, such as 20kg; A:20kg for boxes A."),
    ] = None,
    max_parts: Annotated[
        list[str] | None,
        typer.Option(help="Most parts in a box, such as 12; A:12 for boxes A."),
    ] = None,
    balance: Annotated[
        list[str] | None,
        typer.Option(
            help="Largest distance of a box's centre of gravity from the middle, as a share of the "
            "sides, such as 10%; A:10% for boxes A."
        ),
    ] = None,
    groups: Annotated[
        list[str] | None,
        typer.Option(
            help="Rule for the groups of a manifest: together (each in one box), apart (never two "
            "in one box), kit (whole in one box, or not at all)."
        ),
    ] = None,
    even: Annotated[
        bool,
        typer.Option("--even", help="Spread the parts' area over the height, after the search."),
    ] = False,
    powder: Annotated[
        str | None,
        typer.Option(
            help="Density (g/cm3) and refresh rate of the powder, such as 0.45:20%, to print how "
            "much is used."
        ),
    ] = None,
    unit: FileUnitOption = "mm",
    up: UpOption = None,
    separate: Annotated[
        bool | None,
        typer.Option(
            "--separate/--joined",
            help="Pack each part of a file's scene separately; default for 3MF and STEP.",
        ),
    ] = None,
    accuracy: Annotated[
        str | None,
        typer.Option(
            help="Largest deviation of simplified meshes and STEP; default: 0.002 of a part."
        ),
    ] = None,
    instructions: Annotated[
        bool,
        typer.Option("--instructions", help="Also write printable packing instructions (HTML)."),
    ] = False,
    film: Annotated[
        bool, typer.Option("--film", help="Also write a film of each box as it is packed (GIF).")
    ] = False,
    force: Annotated[
        bool,
        typer.Option("--force", help="Also replace files in the folder that others wrote."),
    ] = False,
    require_all: Annotated[
        bool,
        typer.Option(
            "--require-all", help="Exit code 1 if a part is left out or a file is not read."
        ),
    ] = False,
    time: TimeOption = "60",
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1, help="Passes over the parts of each search, instead of --time; repeatable."
        ),
    ] = None,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    backend: SearchBackendOption = "threads",
    address: AddressOption = None,
    preset: Annotated[
        Path | None,
        typer.Option(
            is_eager=True,
            callback=option_presets.use_preset,
            help="File written by --save-preset; options given here override it.",
        ),
    ] = None,
    save_preset: Annotated[
        Path | None, typer.Option(help="File to keep these options in, for --preset.")
    ] = None,
) -> None:
    """Pack your own parts into boxes, at their real sizes.

    The folder gets packing.3mf, .glb, .stl, .png, .html (the report with a 3D view) and .json with
    the poses. Every distance applies to your files, which are reread and checked at the end.
    Ctrl-C writes the best packing so far; the same command resumes from it. The time includes
    reading and, as far as possible, the check and all files.

    A manifest has the columns file, count, value, rotations, priority, mass (g), density (g/cm3),
    no_stack (yes: nothing may rest on it), max_load (g), clearance, group, max_tilt, down, stop,
    unit and name. Parts of a higher priority are packed first. Parts that break a constraint are
    left out, with the reason.

    Example: packit pack parts/*.stl --box 300x200x150mm --out packed

    Example: packit pack bracket.stl=4 lid.3mf --box 12x8x6in --unit in --clearance 0.04in -o packed

    Example: packit pack parts/*.stl --container cylinder:220x300mm --out packed

    Example: packit pack parts/*.stl --container hp-jet-fusion-5200 --clearance 2mm --out packed

    Example: packit pack parts.csv --objective boxes --box 300x200x150mm --time 60s -o packed
    """
    boxes_asked = [*(box or ()), *(container or ())]
    if not boxes_asked:
        raise ArgumentError("there is no box: choose --box 300x200x150mm, or --container")
    settings = setting_texts.read_settings(
        boxes_asked,
        unit,
        clearance=clearance,
        clearance_z=clearance_z,
        wall_clearance=wall_clearance,
        accuracy=accuracy,
        removable=removable,
        insertable=insertable,
        door=door,
        order=order,
        separable=separable,
        stable=stable,
        boxes=boxes,
        keep_out=keep_out or (),
        fixed=fixed or (),
        reading=part_files.ReadSettings(
            unit,
            up,
            rotations,
            separate,
            turning=turnings.read_turning(max_tilt, down),
        ),
        workers=workers,
        backend=backend,
        address=address,
        iterations=iterations,
        max_mass=max_mass or (),
        max_parts=max_parts or (),
        balance=balance or (),
        groups=groups or (),
        even=even,
        powder=powder,
    )
    if save_preset is not None:
        output.prepare_folder(save_preset, *parts, *boxes_asked, field="options")
        option_presets.save_preset(ctx, save_preset)
    with stoppable(RESUMABLE), terminal.progress_bars() as progress:
        output.prepare_folder(out / "packing.json")
        bar = progress.add_task("reading", total=None, note="")

        def show(better: packit_sim.PackedParts, _: float) -> None:
            progress.update(bar, advance=1, note=_note(better))

        def show_step(step: str, done: int, total: int) -> None:
            what, _, note = step.partition(" ")
            progress.update(bar, description=what, completed=done, total=total or None, note=note)

        seconds = read_seconds(time)
        packed = packit_sim.pack(
            parts,
            boxes_asked,
            objective,
            seconds,
            seed,
            out,
            show,
            settings,
            show_step,
            force=force,
            instructions=instructions,
            film=film,
        )
        found = check.check(packed)
    terminal.console.print(
        summary.table(packed, found), markup=False, highlight=False, soft_wrap=True
    )
    output.print_written(out, f": {packed.count} parts")
    films = (f"{packed.stem(n)}{record.FILM}" for n in range(len(packed.packings)))
    for name in (*films, record.INSTRUCTIONS):
        if (out / name).exists():
            output.print_written(out / name)
    for problem in found.problems:
        terminal.console.print(problem, markup=False, style="red", soft_wrap=True)
    missing = _missing(packed) if require_all else ""
    if missing:
        terminal.console.print(missing, markup=False, style="red", soft_wrap=True)
    if found.problems or missing:
        raise typer.Exit(1)


def _missing(packed: packit_sim.PackedParts) -> str:
    """Return a sentence on what is not packed; none if all is."""
    parts, files = sum(each.count for each in packed.missed), len(packed.unread)
    what = [f"{parts} part{'s' * (parts > 1)} left out"] if parts else []
    what += [f"{files} file{'s' * (files > 1)} not read"] if files else []
    return f"not all is packed: {' and '.join(what)}" if what else ""


def _note(packed: packit_sim.PackedParts) -> str:
    text = f"{packed.packed_of_asked}, density {packed.density:.3f}"
    if packed.task.objective == "height":
        text += f", height {packed.height:.5g} {packed.task.unit}"
    return text + (f", {len(packed.packings)} boxes" if len(packed.packings) > 1 else "")
