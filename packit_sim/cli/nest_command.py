"""`packit nest`: the search for the lowest packing of an instance."""

from __future__ import annotations

import time as clock
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli import completion
from packit_sim.cli.options import (
    AddressOption,
    SearchBackendOption,
    SeedOption,
    TimeOption,
    WorkersOption,
    read_seconds,
)
from packit_sim.cli.stopping import NOTHING_WRITTEN, stoppable
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.core.suggestions import did_you_mean
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES

with lazy_imports():
    from packit_sim.cli import output, terminal
    from packit_sim.core import files as core_files
    from packit_sim.parts.handling import restacking, separability
    from packit_sim.parts.packings import (
        builtin_instances,
        instances,
        mesh_paths,
        packing_files,
        rotation_sets,
    )

_SEPARATED = 5
"""Packings, the best ones, of which the lowest is chosen if parts interlock."""


def nest_command(
    instance: Annotated[
        str,
        typer.Argument(
            metavar="INSTANCE",
            autocompletion=completion.instances,
            help="Strip-packing instance: a .json file, or the name of a built-in one: "
            f"{', '.join(BUILTIN_NAMES)}.",
        ),
    ],
    rotations: Annotated[
        str,
        typer.Option(help="Rotations of the items: fixed, yaw-N, flip-N, axis-N, cube or free."),
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

    The format is that of the ESICUP data sets. https://packit-sim.readthedocs.io (Reference,
    Strip-packing instances) describes the built-in instances and those of the literature. In
    Python, `packit_sim.nest` also fills one box or several.

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
            output.prepare_folder(file, instance, field=field)
    for option, json_file in (("--packing", packing), ("--instance-out", instance_out)):
        if json_file is not None and json_file.suffix != ".json":
            raise ArgumentError(f"{option} {json_file} is not possible: choose a .json file")
    types, container = _read(instance, rotations)
    files = [file.absolute() for file, _ in outputs if file is not None]
    if len(set(files)) < len(files):
        raise ArgumentError("two outputs have the same name: choose a name for each")
    for file in files:
        core_files.require_replaceable(file, [each.file for each in types if each.file is not None])
    if instance_out is not None:
        instances.require_free_instance(types, instance_out)
    if packing is not None:
        packing_files.require_free_meshes(types, packing)
    settings = packit_sim.NestSettings(workers, backend, address, iterations)
    start = clock.perf_counter()
    with stoppable(NOTHING_WRITTEN), terminal.progress_bars() as progress:
        bar = progress.add_task("nesting", total=None, note="")

        last: deque[packit_sim.Packing] = deque(maxlen=_SEPARATED)

        def show(better: packit_sim.Packing, _: float) -> None:
            last.appendleft(better)
            note = f"height {better.height:.6g}, density {better.density:.3f}"
            progress.update(bar, advance=1, note=note)

        found = packit_sim.nest(
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
    table = output.simple_table("height", "density", "items", "seconds", "valid")
    table.add_row(
        f"{found.height:.6g}",
        f"{found.density:.4f}",
        f"{len(found.placements)}",
        f"{clock.perf_counter() - start:.1f}",
        "no" if found.problems() else "yes",
    )
    terminal.console.print(table)
    terminal.console.print(
        f"linked pairs: {separability.links_of_items(found)}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    solved = found
    if instance_out is not None:
        instances.write_instance(types, container, instance_out)
        output.print_written(instance_out)
        # a solution has its names of meshes
        named, _ = instances.read_instance(instance_out, rotations)
        solved = replace(found, types=named)
    if out is not None:
        name = f"{instance}.json"  # of a built-in one that is not written
        if instance_out is not None or instance not in BUILTIN_NAMES:
            name = _instance_path(instance_out or Path(instance), out)
        instances.write_solution(solved, out, name)
        output.print_written(out)
    if packing is not None:
        found.write(packing)
        output.print_written(packing)


def _read(
    instance: str, rotations: str
) -> tuple[tuple[packit_sim.ItemType, ...], packit_sim.BoxContainer]:
    """Read an instance: a path, or the name of a built-in one."""
    if instance in BUILTIN_NAMES:
        built_in = builtin_instances.builtin_instance(instance, rotations)
        return built_in.types, built_in.container
    path = Path(instance)
    if path.is_dir():
        found = instances.instances_in(path)
        if not found:
            raise ArgumentError(f"{path} is a folder without a strip-packing instance")
        names = ", ".join(repr(file.relative_to(path).as_posix()) for file in found)
        raise ArgumentError(
            f"{path} is a folder: choose an instance in it, such as {str(found[0])!r}; there are "
            f"{len(found)}: {names}"
        )
    if path.suffix != ".json":
        raise ArgumentError(
            f"no instance {instance!r}: {did_you_mean(instance, BUILTIN_NAMES)}"
            f"choose a .json file, or a built-in instance: {', '.join(BUILTIN_NAMES)}"
        )
    return instances.read_instance(path, rotations)


def _lowest_separated(packings: Iterable[packit_sim.Packing]) -> packit_sim.Packing:
    """Separate packings, the lowest first, until no other can be lower; return the lowest."""
    best: packit_sim.Packing | None = None
    for each in packings:
        found = restacking.separated(each)
        if best is None or found.height < best.height:
            best = found
        if found is each:  # the others are higher
            break
    assert best is not None
    return best


def _instance_path(path: Path, out: Path) -> str:
    """Return the path of an instance as its solution stores it."""
    folders = out.absolute().parents[: mesh_paths.MAX_LEVELS + 1]
    near = (folder for folder in folders if path.absolute().is_relative_to(folder))
    folder = next(near, path.absolute().parent)
    return path.absolute().relative_to(folder).as_posix()
