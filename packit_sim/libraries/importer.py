"""Import of meshes into a stored library: repair, simplification, metadata, and a report.

Meshes are read in separate processes with limits on memory and time, so that no broken file stops
the import.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import TimeoutError
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pebble import ProcessExpired, ProcessPool

from packit_sim.core.checks import Range, check_settings
from packit_sim.core.errors import ArgumentError, MeshError, PackItError
from packit_sim.core.memory import limit_memory
from packit_sim.core.orphans import end_with, without_interrupts
from packit_sim.core.plain_text import plain_logger
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.repair import Repairs
from packit_sim.geometry.shapes import UP_AXES, Shape
from packit_sim.geometry.similarity import near_duplicates
from packit_sim.geometry.simplification import Simplification
from packit_sim.libraries import stored
from packit_sim.libraries.sources import Candidate, ShapeInfo

_log = plain_logger(__name__)


@dataclass(frozen=True)
class ImportSettings:
    """The settings of an import.

    Parameters
    ----------
    up : str, optional
        The axis that points up in all meshes, "x", "y" or "z"; by default as in their files.
    unit_cm : float, optional
        Centimetres in the unit of length of files that don't define it.
    simplification : Simplification
        The limits of the simplification.
    min_thickness : float
        The smallest possible extent, relative to the bounding box's diagonal.
    memory : int
        Bytes that a mesh may take, in addition to those of the process.
    timeout : float
        Seconds that a mesh may take.
    workers : int
        The number of processes.
    seed : int
        The seed of the splits, for sources that have none.

    Raises
    ------
    ArgumentError
        If a setting is out of range.
    """

    up: str | None = None
    unit_cm: float | None = None
    simplification: Simplification = field(default_factory=Simplification)
    min_thickness: float = 0.0
    memory: int = 4 * 2**30
    timeout: float = 300.0
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.up is not None and self.up not in UP_AXES:
            raise ArgumentError(
                f"up axis {self.up!r} is not known: choose from {', '.join(UP_AXES)}"
            )
        above_0 = Range(0, ends="(]")
        check_settings(
            self,
            min_thickness=Range(0, 1, "[)"),
            unit_cm=(self.unit_cm is None or self.unit_cm in above_0, str(above_0)),
            memory=above_0,
            timeout=above_0,
            workers=above_0,
        )


@dataclass(frozen=True)
class ImportOutcome:
    """The result for a candidate.

    Attributes
    ----------
    id : str
        The id in the library.
    name : str
        The candidate's own id.
    source : str
        The origin of the mesh.
    problem : str, optional
        Why it was refused; None if it was kept.
    triangles_read : int, optional
        The number of triangles before the import, if it was kept.
    repairs : Repairs, optional
        The repairs, if it was kept.
    info : ShapeInfo, optional
        The metadata, if it was kept.
    parts : int
        The number of meshes in its file's scene, which became one rigid shape.
    is_shell : bool
        Whether it is open, so that its volume is that of a sheet (see `Shape.is_shell`).
    """

    id: str
    name: str
    category: str
    source: str
    problem: str | None = None
    triangles_read: int | None = None
    repairs: Repairs | None = None
    info: ShapeInfo | None = None
    parts: int = 1
    is_shell: bool = False


def import_library(
    candidates: Sequence[Candidate],
    path: str | Path,
    name: str,
    version: str = "",
    settings: ImportSettings | None = None,
    splits: Mapping[str, Sequence[str]] | None = None,
    done: Callable[[ImportOutcome], None] | None = None,
    report: Callable[[list[ImportOutcome]], None] = lambda outcomes: None,
) -> list[ImportOutcome]:
    """Store the candidates that can be shapes as a library.

    Parameters
    ----------
    candidates : sequence of Candidate
        The meshes.
    path : str or Path
        The folder; a stored library there is replaced. If all candidates are refused, nothing is
        written.
    name : str
        The library's name.
    splits : mapping of str to sequence of str, optional
        The candidates' ids in each split. By default they are divided equally among all three, and
        near-duplicates stay together.
    done : callable, optional
        Called with the `ImportOutcome` of each candidate.
    report : callable
        Called with the result before the library is stored, so that none is without a report.

    Returns
    -------
    list of ImportOutcome
        The result for each candidate, in order.

    Raises
    ------
    LibraryError
        If the path has anything but a stored library.
    """
    settings = settings or ImportSettings()
    stored.require_replaceable(Path(path).absolute())
    outcomes: list[ImportOutcome] = []
    kept: list[tuple[QuantizedMesh, ShapeInfo]] = []
    _log.info("importing %d meshes with %d processes", len(candidates), settings.workers)
    started = time.monotonic()
    for outcome, mesh in _prepared(_with_ids(candidates), settings):
        outcomes.append(outcome)
        if outcome.problem is not None:
            _log.info("%s is skipped: %s", outcome.name, outcome.problem)
        if mesh is not None and outcome.info is not None:
            kept.append((mesh, outcome.info))
        if done is not None:
            done(outcome)
    if not kept:
        report(outcomes)
        return outcomes
    if skipped := len(outcomes) - len(kept):
        _log.warning("%d of %d meshes are skipped", skipped, len(outcomes))
    if any(candidate.group is None for candidate in candidates):
        kept = _grouped(kept)

    def split(infos: Mapping[str, ShapeInfo]) -> dict[str, tuple[str, ...]]:
        if splits is None:
            return stored.divide(infos, settings.seed)
        ids = {outcome.name: outcome.id for outcome in outcomes if outcome.info is not None}
        return {
            split: tuple(sorted(ids[name] for name in names if name in ids))
            for split, names in splits.items()
        }

    infos = {info.id: info for _, info in kept}
    outcomes = [replace(outcome, info=infos.get(outcome.id)) for outcome in outcomes]
    report(outcomes)
    stored.write(path, name, version, kept, split)
    _log.info("%s: %d shapes in %.1f s", path, len(kept), time.monotonic() - started)
    return outcomes


def _with_ids(candidates: Iterable[Candidate]) -> Iterator[tuple[str, Candidate]]:
    """Yield each candidate's own id, and the candidate with an id that can be stored."""
    taken: set[str] = set()
    for candidate in candidates:
        id = wanted = stored.as_id(candidate.id) or "shape"
        number = 1
        while id.casefold() in taken:
            number += 1
            id = f"{wanted}-{number}"
        taken.add(id.casefold())
        yield candidate.id, replace(candidate, id=id)


def _prepared(
    candidates: Iterable[tuple[str, Candidate]], settings: ImportSettings
) -> Iterator[tuple[ImportOutcome, QuantizedMesh | None]]:
    """Yield the outcome of each candidate, in order, and its mesh if it was kept."""
    with ProcessPool(
        max_workers=settings.workers,
        initializer=_begin,
        initargs=(settings.memory, os.getpid()),
        context=multiprocessing.get_context("spawn"),  # type: ignore[arg-type,unused-ignore]
    ) as pool:
        with without_interrupts():
            futures = [
                (
                    ImportOutcome(candidate.id, name, candidate.category, candidate.source),
                    pool.schedule(_prepare, (candidate, settings), timeout=settings.timeout),
                )
                for name, candidate in candidates
            ]
        try:
            for outcome, future in futures:
                try:
                    done: _Prepared = future.result()
                except Exception as error:  # one bad mesh must not stop the import of the others
                    yield replace(outcome, problem=_problem(error, settings)), None
                else:
                    kept = replace(
                        outcome,
                        triangles_read=done.triangles_read,
                        repairs=done.repairs,
                        info=done.info,
                        parts=done.parts,
                        is_shell=done.is_shell,
                    )
                    yield kept, done.mesh
        except BaseException:
            pool.stop()
            raise


def _problem(error: Exception, settings: ImportSettings) -> str:
    """Return why a candidate is refused."""
    match error:
        case PackItError():
            return str(error)
        case TimeoutError():
            return f"took more than {settings.timeout:g} s"
        case MemoryError():
            return f"took more than {settings.memory / 2**30:.3g} GiB of memory"
        case ProcessExpired():
            return f"ended the process that read it, with status {error.exitcode}"
        case _:
            return f"unexpected: {error!r:.200}"


@dataclass(frozen=True)
class _Prepared:
    """A mesh to store with its metadata, and what was read and repaired."""

    mesh: QuantizedMesh
    info: ShapeInfo
    repairs: Repairs
    triangles_read: int
    parts: int
    is_shell: bool


def _prepare(candidate: Candidate, settings: ImportSettings) -> _Prepared:
    """Read, repair and simplify a mesh."""
    raw = candidate.read()
    shape, repairs = Shape.repaired(
        raw.mesh, candidate.id, candidate.category, up=settings.up or raw.up
    )
    if shape.extents.min() < settings.min_thickness:
        raise MeshError(
            f"it is {shape.extents.min():.3f} of its diagonal thick: "
            f"at least {settings.min_thickness:g}"
        )
    unit = raw.unit_cm or settings.unit_cm
    if candidate.size_cm is None and unit is not None:
        x, y, z = (shape.extents * np.linalg.norm(raw.mesh.extents) * unit).tolist()
        candidate = replace(candidate, size_cm=(x, y, z))
    mesh, error = settings.simplification(shape)
    error += raw.deviation / float(np.linalg.norm(raw.mesh.extents))
    kept = Shape(mesh.mesh(), shape.id, shape.category)
    info = candidate.info(kept, float(f"{error + 5e-6:.5f}"))
    return _Prepared(mesh, info, repairs, len(raw.mesh.faces), raw.parts, kept.is_shell)


def _grouped(
    kept: Sequence[tuple[QuantizedMesh, ShapeInfo]],
) -> list[tuple[QuantizedMesh, ShapeInfo]]:
    """Set the group of each to the first id of its near-duplicates."""
    infos = [info for _, info in kept]
    numbers = near_duplicates([Shape(mesh.mesh(), info.id, info.category) for mesh, info in kept])
    first: dict[int, str] = {}
    for number, id in sorted(zip(numbers, (info.id for info in infos), strict=True)):
        first.setdefault(number, id)
    return [
        (mesh, replace(info, group=first[number]))
        for (mesh, info), number in zip(kept, numbers, strict=True)
    ]


def _begin(memory: int, parent: int) -> None:
    """Begin a worker: with a limit of its memory, and no longer than the process that needs it."""
    end_with(parent)
    limit_memory(memory)
