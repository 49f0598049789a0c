"""Meshes of any source made into a stored library: repaired, reduced, measured, and reported.

Each mesh is read in a process of its own sort, with a limit to its memory and its time, so that no
file, however broken, takes the import down.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import TimeoutError
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pebble import ProcessExpired, ProcessPool

from packit_sim.core.errors import ArgumentError, MeshError, PackItError
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.repair import Repairs
from packit_sim.geometry.shapes import UP_AXES, Shape
from packit_sim.geometry.similarity import near_duplicates
from packit_sim.geometry.simplification import Simplification
from packit_sim.libraries import stored
from packit_sim.libraries.sources import Candidate, ShapeInfo

_log = logging.getLogger(__name__)

_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class ImportSettings:
    """How meshes become shapes.

    up: the axis that points up in all meshes, "x", "y" or "z"; None leaves it to their files.
    unit_cm: centimetres in their unit of length, where their files don't tell. simplification: how
    far they may be reduced. min_thickness: the least extent, of a diagonal of 1. memory: bytes that
    one mesh may take, beside what the process takes anyway; timeout: seconds. workers: processes.
    seed: of the splits, for sources that have none. Raises ValueError where one is out of range.
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
        if not 0 <= self.min_thickness < 1:
            raise ArgumentError(
                f"min_thickness {self.min_thickness!r} must be at least 0, and below 1"
            )
        for name in ("unit_cm", "memory", "timeout", "workers"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ArgumentError(f"{name} {value!r} is not possible: it must be more than 0")


@dataclass(frozen=True)
class Outcome:
    """What became of a candidate.

    id, category, source: as the library has them; name: the candidate's own id. problem: why it
    was refused, None where it was kept. triangles_read: of the mesh as it came. info, repairs: of
    the shape, where it was kept.
    """

    id: str
    name: str
    category: str
    source: str
    problem: str | None = None
    triangles_read: int | None = None
    repairs: Repairs | None = None
    info: ShapeInfo | None = None


def import_library(
    candidates: Sequence[Candidate],
    path: str | Path,
    name: str,
    version: str = "",
    settings: ImportSettings | None = None,
    splits: Mapping[str, Sequence[str]] | None = None,
    done: Callable[[Outcome], None] | None = None,
) -> list[Outcome]:
    """Stores the candidates that can be shapes as a library at path; returns what became of each.

    splits: the candidates' ids in each split; by default they are divided among all three alike,
    those that look the same together. done: called after each candidate. An older library at path
    is replaced; where all are refused nothing is written. Raises LibraryError where path holds
    anything else.
    """
    settings = settings or ImportSettings()
    stored.require_replaceable(Path(path).absolute())
    outcomes: list[Outcome] = []
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

    stored.write(path, name, version, kept, split)
    _log.info("%s: %d shapes in %.1f s", path, len(kept), time.monotonic() - started)
    infos = {info.id: info for _, info in kept}
    return [replace(outcome, info=infos.get(outcome.id)) for outcome in outcomes]


def _with_ids(candidates: Iterable[Candidate]) -> Iterator[tuple[str, Candidate]]:
    """Each candidate's own id, and the candidate with one that can be stored."""
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
) -> Iterator[tuple[Outcome, QuantizedMesh | None]]:
    """What became of each candidate, in order, and its mesh where it was kept."""
    with ProcessPool(
        max_workers=settings.workers,
        initializer=_limit_memory,
        initargs=(settings.memory,),
        context=multiprocessing.get_context("spawn"),
    ) as pool:
        futures = [
            (
                name,
                candidate,
                pool.schedule(_prepare, (candidate, settings), timeout=settings.timeout),
            )
            for name, candidate in candidates
        ]
        try:
            for name, candidate, future in futures:
                outcome = Outcome(candidate.id, name, candidate.category, candidate.source)
                try:
                    mesh, info, repairs, triangles = future.result()
                except PackItError as error:
                    yield replace(outcome, problem=str(error)), None
                except TimeoutError:
                    problem = f"took more than {settings.timeout:g} s"
                    yield replace(outcome, problem=problem), None
                except MemoryError:
                    problem = f"took more than {settings.memory / 2**30:.3g} GiB of memory"
                    yield replace(outcome, problem=problem), None
                except ProcessExpired as error:
                    problem = f"ended the process that read it, with status {error.exitcode}"
                    yield replace(outcome, problem=problem), None
                except Exception as error:  # no one mesh is worth losing the others
                    yield replace(outcome, problem=f"unexpected: {error!r:.200}"), None
                else:
                    kept = replace(outcome, triangles_read=triangles, repairs=repairs, info=info)
                    yield kept, mesh
        except BaseException:
            pool.stop()
            raise


def _prepare(
    candidate: Candidate, settings: ImportSettings
) -> tuple[QuantizedMesh, ShapeInfo, Repairs, int]:
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
    kept = Shape(mesh.mesh(), shape.id, shape.category)
    return mesh, candidate.info(kept, float(f"{error + 5e-6:.5f}")), repairs, len(raw.mesh.faces)


def _grouped(
    kept: Sequence[tuple[QuantizedMesh, ShapeInfo]],
) -> list[tuple[QuantizedMesh, ShapeInfo]]:
    """The same with a group for each that names the first id of those that look the same."""
    infos = [info for _, info in kept]
    numbers = near_duplicates([Shape(mesh.mesh(), info.id, info.category) for mesh, info in kept])
    first: dict[int, str] = {}
    for number, id in sorted(zip(numbers, (info.id for info in infos), strict=True)):
        first.setdefault(number, id)
    return [
        (mesh, replace(info, group=first[number]))
        for (mesh, info), number in zip(kept, numbers, strict=True)
    ]


def _limit_memory(memory: int) -> None:
    """Lets this process take so many bytes more than it has now."""
    with open("/proc/self/statm") as statm:
        has = int(statm.read().split()[0]) * _PAGE
    resource.setrlimit(resource.RLIMIT_AS, (has + memory, has + memory))
