"""`packit nest`: the search for the lowest packing of an instance."""

from __future__ import annotations

import time as clock
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli.console import (
    AddressOption,
    SearchBackendOption,
    SeedOption,
    TimeOption,
    WorkersOption,
    console,
    prepare_folder,
    progress_bars,
    read_seconds,
)
from packit_sim.cli.output import NOTHING_WRITTEN, print_written, simple_table, stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import require_replaceable
from packit_sim.parts.handling.restacking import separated
from packit_sim.parts.handling.separability import links_of_items
from packit_sim.parts.nesting.nest import NestSettings, nest
from packit_sim.parts.packings import rotation_sets
from packit_sim.parts.packings.builtin_instances import builtin_instance, builtin_names
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.instances import (
    instances_in,
    read_instance,
    require_free_instance,
    write_instance,
    write_solution,
)
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.mesh_paths import MAX_LEVELS
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.packing_files import require_free_meshes

_SEPARATED = 5
"""Packings, the best ones, of which the lowest is chosen if parts interlock."""


def nest_command(
    instance: Annotated[
        str,
        typer.Argument(
            metavar="INSTANCE",
            help="Strip-packing instance: a .json file, or the name of a built-in one: "
            f"{', '.join(builtin_names())}.",
        ),
    ],
    rotations: Annotated[
        str,
        typer.Option(help="Rotations of the items: fixed, yaw-N, axis-N, cube or free."),
    ] = "cube",
    time: TimeOption = "60",
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1, help="Passes over the items of each search, instead of --time; repeatable."
        ),
    ] = None,
    seed: SeedOption = 0,
    clearance: Annotated[
        float, typer.Option(help="Smallest distance between two items, in the instance's unit.")
    ] = 0.0,
    separable: Annotated[
        bool,
        typer.Option(
            "--separable", help="No items interlock: each can be moved out without turning."
        ),
    ] = False,
    workers: WorkersOption = 0,
    backend: SearchBackendOption = "threads",
    address: AddressOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="File for the solution, in the instances' format."),
    ] = None,
    instance_out: Annotated[
        Path | None,
        typer.Option(help="File for the instance itself (.json), with its meshes next to it."),
    ] = None,
    packing: Annotated[
        Path | None,
        typer.Option(help="File for the packing, as `packit verify` reads it (.json)."),
    ] = None,
) -> None:
    """Pack meshes into a strip of least height, without a grid.

    The packing is checked by its meshes before it is printed or written. Ctrl-C ends the search
    early and keeps the best packing so far. With --separable, items that interlock are placed again
    on top of the others.

    The format is that of the ESICUP data sets. It, the built-in instances, and where those of the
    literature are published, are described at https://packit-sim.readthedocs.io (Reference,
    Strip-packing instances). In Python, `packit_sim.nest` also fills one box or several.

    Example: packit nest cut-cube-8 --time 10

    Example: packit nest parts.json --clearance 1 --out solution.json --packing packing.json
    """
    rotation_sets.check(rotations)
    seconds = read_seconds(time)
    outputs = ((out, "instancePath"), (instance_out, "item-types"), (packing, "items"))
    for file, field in outputs:
        if file is not None:
            if file.is_dir():
                raise ArgumentError(f"{file} is a folder: choose a file to write")
            prepare_folder(file, instance, field=field)
    for option, json_file in (("--packing", packing), ("--instance-out", instance_out)):
        if json_file is not None and json_file.suffix != ".json":
            raise ArgumentError(f"{option} {json_file} is not possible: choose a .json file")
    types, container = _read(instance, rotations)
    files = [file.absolute() for file, _ in outputs if file is not None]
    if len(set(files)) < len(files):
        raise ArgumentError("two outputs have the same name: choose a name for each")
    for file in files:
        require_replaceable(file, [each.file for each in types if each.file is not None])
    if instance_out is not None:
        require_free_instance(types, instance_out)
    if packing is not None:
        require_free_meshes(types, packing)
    settings = NestSettings(workers, backend, address, iterations)
    start = clock.perf_counter()
    with stoppable(NOTHING_WRITTEN), progress_bars() as progress:
        bar = progress.add_task("nesting", total=None, note="")

        last: deque[Packing] = deque(maxlen=_SEPARATED)

        def show(better: Packing, _: float) -> None:
            last.appendleft(better)
            note = f"height {better.height:.6g}, density {better.density:.3f}"
            progress.update(bar, advance=1, note=note)

        found = nest(
            types,
            container,
            time=seconds,
            seed=seed,
            clearance=clearance,
            callback=show,
            settings=settings,
        )
        if separable:
            found = _lowest_separated(last)
    table = simple_table("height", "density", "items", "seconds", "valid")
    table.add_row(
        f"{found.height:.6g}",
        f"{found.density:.4f}",
        f"{len(found.placements)}",
        f"{clock.perf_counter() - start:.1f}",
        "no" if found.problems() else "yes",
    )
    console.print(table)
    console.print(
        f"linked pairs: {links_of_items(found)}", markup=False, highlight=False, soft_wrap=True
    )
    solved = found
    if instance_out is not None:
        write_instance(types, container, instance_out)
        print_written(instance_out)
        named, _ = read_instance(instance_out, rotations)  # a solution has its names of meshes
        solved = replace(found, types=named)
    if out is not None:
        name = f"{instance}.json"  # of a built-in one that is not written
        if instance_out is not None or instance not in builtin_names():
            name = _instance_path(instance_out or Path(instance), out)
        write_solution(solved, out, name)
        print_written(out)
    if packing is not None:
        found.write(packing)
        print_written(packing)


def _read(instance: str, rotations: str) -> tuple[tuple[ItemType, ...], BoxContainer]:
    """Read an instance: a path, or the name of a built-in one."""
    if instance in builtin_names():
        built_in = builtin_instance(instance, rotations)
        return built_in.types, built_in.container
    path = Path(instance)
    if path.is_dir():
        found = instances_in(path)
        if not found:
            raise ArgumentError(f"{path} is a folder without a strip-packing instance")
        names = ", ".join(repr(file.relative_to(path).as_posix()) for file in found)
        raise ArgumentError(
            f"{path} is a folder: choose an instance in it, such as {str(found[0])!r}; there are "
            f"{len(found)}: {names}"
        )
    if path.suffix != ".json":
        raise ArgumentError(
            f"no instance {instance!r}: choose a .json file, or a built-in instance: "
            f"{', '.join(builtin_names())}"
        )
    return read_instance(path, rotations)


def _lowest_separated(packings: Iterable[Packing]) -> Packing:
    """Separate packings, the lowest first, until no other can be lower; return the lowest."""
    best: Packing | None = None
    for each in packings:
        found = separated(each)
        if best is None or found.height < best.height:
            best = found
        if found is each:  # the others are higher
            break
    assert best is not None
    return best


def _instance_path(path: Path, out: Path) -> str:
    """Return the path of an instance as its solution stores it."""
    folders = out.absolute().parents[: MAX_LEVELS + 1]
    near = (folder for folder in folders if path.absolute().is_relative_to(folder))
    folder = next(near, path.absolute().parent)
    return path.absolute().relative_to(folder).as_posix()
