"""Cases as small JSON files, so that a difference can be repeated anywhere."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.files import read_whole
from packit_sim.core.version import __version__
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import Triple, box_cells
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import is_inside
from packit_sim.selftest.cases import Case
from packit_sim.selftest.comparisons import CHECKS
from packit_sim.selftest.totals import SelftestError

_FRAME = 1e-6
"""Maximum distance of a shape from its canonical frame."""


@dataclass(frozen=True)
class _Shape:
    id: str
    vertices: list[tuple[float, float, float]]
    faces: list[Triple]


@dataclass(frozen=True)
class _Item:
    shape: int
    scale: float
    rotation: int
    location: Triple | None = None


@dataclass(frozen=True)
class _Replay:
    format: Literal[1]
    version: str
    check: str
    cells: Triple
    easy: bool
    kinematic: bool
    seed: list[int]
    placed: list[_Item]
    item: _Item
    shapes: list[_Shape]


def replay_text(check: str, case: Case) -> str:
    """Write a case as JSON.

    Parameters
    ----------
    check : str
        The name of the check in which answers differ.

    Returns
    -------
    str
        The text of a file for `read_replay`.
    """
    shapes: dict[str, Shape] = {}
    for item in (*(placed.item for placed in case.placed), case.item):
        shapes.setdefault(item.shape.digest, item.shape)
    numbers = {digest: number for number, digest in enumerate(shapes)}

    def recorded(item: Item, location: Triple | None = None) -> _Item:
        return _Item(numbers[item.shape.digest], item.scale, item.rotation, location)

    replay = _Replay(
        format=1,
        version=__version__,
        check=check,
        cells=case.cells,
        easy=case.easy,
        kinematic=case.kinematic,
        seed=list(case.seed),
        placed=[recorded(placed.item, placed.location) for placed in case.placed],
        item=recorded(case.item),
        shapes=[
            _Shape(shape.id, shape.mesh.vertices.tolist(), shape.mesh.faces.tolist())
            for shape in shapes.values()
        ],
    )
    return json.dumps(asdict(replay)) + "\n"


def read_replay(file: Path) -> tuple[str, Case]:
    """Read a case from a file.

    Parameters
    ----------
    file : Path
        The file, written by `packit selftest`.

    Returns
    -------
    check : str
        The name of the check in which answers differed.
    case : Case
        The case.

    Raises
    ------
    SelftestError
        If the file does not contain a case.
    """
    with located(file, SelftestError):
        replay = typed_json.decode(read_whole(file), _Replay, SelftestError, "a replay")
        if replay.check not in CHECKS:
            raise SelftestError(f"no check {replay.check!r}: choose from {', '.join(CHECKS)}")
        if min(replay.seed, default=-1) < 0:
            raise SelftestError(f"seed {replay.seed} is not possible: numbers from 0 on")
        shapes = [_shape(shape) for shape in replay.shapes]
        try:
            cells = box_cells(replay.cells)
            placed = tuple(_placed(recorded, shapes, cells) for recorded in replay.placed)
            item = _item(replay.item, shapes)
        except ArgumentError as error:
            raise SelftestError(str(error)) from None
    seed = tuple(replay.seed)
    return replay.check, Case(cells, placed, item, seed, replay.easy, replay.kinematic)


def _shape(recorded: _Shape) -> Shape:
    """Build a shape, bit for bit; its frame must be the canonical one already."""
    corners = list(chain.from_iterable(recorded.faces))
    if not corners or min(corners) < 0 or max(corners) >= len(recorded.vertices):
        raise SelftestError(f"shape {recorded.id!r} has no triangles, or some without vertices")
    vertices = np.clip(np.array(recorded.vertices, dtype=np.float64), -1, 1)
    faces = np.array(recorded.faces, dtype=np.int64)
    low, high = vertices[corners].min(axis=0), vertices[corners].max(axis=0)
    far = max(np.abs(low + high).max(), abs(np.linalg.norm(high - low) - 1))
    if not (far <= _FRAME and (high > low).all()):
        raise SelftestError(f"shape {recorded.id!r} is not centred, or its diagonal is not 1")
    return Shape(trimesh.Trimesh(vertices, faces, process=False), recorded.id, "")


def _item(recorded: _Item, shapes: list[Shape]) -> Item:
    if not 0 <= recorded.shape < len(shapes):
        raise SelftestError(f"there is no shape {recorded.shape}: the file has {len(shapes)}")
    return Item(shapes[recorded.shape], recorded.scale, recorded.rotation)


def _placed(recorded: _Item, shapes: list[Shape], cells: Triple) -> PlacedItem:
    location = recorded.location
    if location is None or min(location) < 0:
        raise SelftestError(f"location {location} is not possible: three numbers from 0 on")
    placed = PlacedItem(_item(recorded, shapes), location)
    if not is_inside(cells, placed):
        raise SelftestError(f"a placed item at {location} is not inside the box of {cells} cells")
    return placed
