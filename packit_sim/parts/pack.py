"""Packing of user-supplied parts into boxes at their real sizes."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from packit_sim.core.checks import as_integer, check_range
from packit_sim.core.choices import Goal
from packit_sim.core.errors import ArgumentError
from packit_sim.core.progress import Progress, unseen
from packit_sim.parts.filling.candidates import in_order
from packit_sim.parts.filling.evening import evened
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.search import PackingSearch
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.filling.task_checks import check_ways
from packit_sim.parts.nesting.rounds import forget_problem
from packit_sim.parts.packings.bounds import SECONDS, SEEDS
from packit_sim.parts.reading.boxes import Boxes
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.own_files import replaceable
from packit_sim.parts.results.record import own_folder
from packit_sim.parts.results.resuming import read_earlier

_AFTER = 1.5
"""Seconds of the check and the exports, as a share of those of reading and preparing."""

_EVENING = 0.15
"""Share of the time to even layers, of those settings that ask for it."""

_LEAST_SEARCH = 1 / 3
"""The share of the time that the search has at least, whatever the other steps take."""


def pack(
    parts: Sequence[Part | Path | str],
    box: Boxes,
    objective: Goal = "volume",
    time: float = 60.0,
    seed: int = 0,
    out: Path | str | None = None,
    callback: Callable[[PackedParts, float], object] | None = None,
    settings: PackSettings | None = None,
    progress: Progress = unseen,
    *,
    force: bool = False,
    instructions: bool = False,
    film: bool = False,
) -> PackedParts:
    """Pack parts into boxes at their real sizes.

    Parameters
    ----------
    parts : sequence of Part, Path or str
        Parts, mesh files ("bracket.stl=4" is four of it), folders, patterns of paths and manifests.
    box : str, BoxType, Container, or sequence of float, str, BoxType or Container
        A box, such as "300x200x150mm", (300, 200, 150), or another container, such as
        "cylinder:220x300mm", "trunk.stl" or a `MeshContainer`; or several of them.
    objective : str
        "volume", "count" or "value": most of it; "height": all parts, lowest; "boxes": all parts,
        fewest boxes.
    time : float
        Seconds, from the call on. The search gets what reading and preparing leave, less an
        estimate for the exports, but at least a third.
    out : Path or str, optional
        A folder to export to. If it has a packing of the same task, the search starts with it, and
        only a better one replaces it.
    callback : callable, optional
        Called with each better packing and the seconds since the call.
    settings : PackSettings, optional
        Clearances, how files are read, and how the search runs.
    progress : callable, optional
        Called with each step before and after the search, and how much of it is done.
    force : bool
        Whether files in the folder that `pack` did not write, or that were changed since, are
        replaced as well.
    instructions : bool
        Whether packing instructions are exported, too.
    film : bool
        The same for a film of each box.

    Returns
    -------
    PackedParts
        The best packing. Ctrl-C ends the search early.

    Raises
    ------
    ArgumentError
        If an argument is not possible, no part can be read or fits, or the folder has files of
        others that would be replaced.
    BusyError
        If another process packs into the same folder.
    NestingError
        If no valid packing was found.

    Examples
    --------
    >>> from trimesh import creation
    >>> from packit_sim import PackSettings, Part, pack
    >>> block = Part("block", creation.box((10, 10, 10)), count=6)
    >>> settings = PackSettings(workers=1, iterations=20)
    >>> packed = pack([block], "25x25x15mm", settings=settings)
    >>> packed.count
    4
    >>> packed.left_out
    (LeftOut(name='block', count=2, reason='no space was found'),)
    """
    start = clock.perf_counter()
    check_range("time", time, SECONDS)
    check_range("seed", as_integer("seed", seed), SEEDS)
    task = prepared_task(parts, box, objective, settings or PackSettings(), progress)
    check_ways(task, instructions, film)
    end = start + time
    now = clock.perf_counter()
    if out is not None:
        end -= _AFTER * (now - start)
    end = max(end, now + _LEAST_SEARCH * time)

    def better(packed: PackedParts) -> None:
        if callback is not None:
            callback(packed, clock.perf_counter() - start)

    def search(earlier: PackedParts | None = None) -> PackedParts:
        first = PackedParts(task)
        if earlier is not None:
            first = replace(earlier, searches=earlier.searches + 1)
            better(first)
        progress("packing", 0, 0)
        until = end - _EVENING * time if task.settings.even else end
        found = in_order(PackingSearch(first, until, seed + first.searches - 1, better).run())
        left = max(end - clock.perf_counter(), 0.0)
        return evened(found, left, seed) if task.settings.even else found

    if out is None:
        return search()
    out = Path(out)
    with own_folder(out):
        files = replaceable(out, task, force, instructions, film)  # refuses before the search
        try:
            earlier = read_earlier(out, task)
        except ArgumentError:  # a record of others
            if not force:
                raise
            earlier = None
        packed = search(earlier)
        forget_problem()
        from packit_sim.parts.results.exports import write_result  # the search need not wait for it

        write_result(packed, out, files, progress, instructions, film)
    return packed
