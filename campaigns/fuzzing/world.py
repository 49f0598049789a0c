"""The small files that readers of hostile files need around them: a library, a pack, meshes.

They are the same in every run, so that a file that was found once shows the same again.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from msgspec import structs
from trimesh import creation

from packit_sim.box import Box
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.packs import ItemRecord, Pack, PackedItem, PoseRecord
from packit_sim.game.datasets.provenance import (
    Densified,
    Drawn,
    Evolved,
    FromOriginal,
    Improvement,
    Other,
    Played,
    Provenance,
    Puzzle,
    Sampled,
)
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import PACKIT, End, Rules

SHAPES = {
    "box/model0": creation.box((1, 2, 3)),
    "box/model1": creation.box((2, 2, 1)),
    "wedge/model2": creation.cone(1.0, 2.0, sections=4),
}

CELLS = (20, 20, 20)

MAX_SEED = 16_000
"""The largest file to start from, in bytes."""

COMPUTED = b"@DIGEST@"
"""Stands for the digest that makes a forged library or manifest hold."""


@cache
def folder() -> Path:
    """Return a folder of this process, in memory where there is one for that."""
    memory = Path("/dev/shm")
    made = Path(tempfile.mkdtemp(prefix="packit-fuzzing-", dir=memory if memory.exists() else None))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


@cache
def library() -> ShapeLibrary:
    """Return a stored library of three shapes of a few triangles."""
    path = folder() / "library"
    shapes = (
        Shape.from_mesh(mesh, id, id.partition("/")[0]) for id, mesh in sorted(SHAPES.items())
    )
    stored.write(path, "tiny", "1", map(stored.entry, shapes))
    return ShapeLibrary.open(path)


def written(name: str, data: bytes) -> Path:
    """Write a file into the folder."""
    path = folder() / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def pack() -> Pack:
    """Return a pack of two items."""
    box = Box(CELLS)
    for number, id in enumerate(("box/model0", "wedge/model2")):
        box.place(Item(library()[id], 0.0002), (0, 0, 3 * number))
    return Pack.of(box, library())


def packs() -> list[Pack]:
    """Return a pack of each kind of provenance, and one with an item off the grid."""
    base = pack()
    records: tuple[Provenance, ...] = (
        Other(author="a tool", notes="by hand"),
        Sampled(size=0.9, split="train"),
        Evolved(seed=1, generation=2, size=1.0, settings=EvolutionSettings(cells=CELLS), after=3),
        Densified(seed=1, rounds=2, settings=DensificationSettings()),
        Drawn(seed=1),
        Puzzle(cuts="guillotine", pieces=2, seed=1),
        FromOriginal(file="2_tr", pack=0, efficiency=0.5, shape_scale=0.8, rotations=(0, 5)),
    )
    pose = PoseRecord((0.1, 0.1, 0.1), (1.0, 0.0, 0.0, 0.0))
    settled = PackedItem("box/model1", 0.0002, 4, None, pose, counted=False)
    outside = (ItemRecord("wedge/model2", 0.0001),)
    return [
        *(replace(base, provenance=record) for record in records),
        played(),
        replace(base, items=(settled,), density=0.0, outside=outside),
    ]


def played(rules: Rules = PACKIT) -> Pack:
    """Return a result: the whole task of `pack`, packed by an agent."""
    base = pack()
    record = Played(
        agent="random/aligned/blbf",
        task=0,
        task_digest=base.task(library()).digest,
        seed=3,
        total=1.0,
        end=End.COMPLETE,
        seconds=0.25,
        scores={"stable": 1.0},
        rules=rules,
        improvements=(Improvement(0.125, 0.5), Improvement(0.25, 1.0)),
    )
    return replace(base, provenance=record)


def valued() -> Pack:
    """Return a result whose return counts values."""
    pack = played(Rules(values=True))
    pack = pack.valued({item.kind: float(n + 1) for n, item in enumerate(pack.items)})
    digest = pack.task(library()).digest
    return replace(pack, provenance=structs.replace(pack.provenance, task_digest=digest))


class Unclean(Exception):
    """A text for people that could send commands to a terminal."""


def require_clean(text: str, lines: bool = False) -> None:
    if not (text.replace("\n", "") if lines else text).isprintable():
        raise Unclean(repr(text)[:300])


def exported(mesh: Any, kind: str, **options: str) -> bytes:
    """Return the content of a mesh file as trimesh writes it."""
    content = mesh.export(file_type=kind, **options)
    return content.encode() if isinstance(content, str) else bytes(content)
