"""Readers of containers: as text, as meshes, and in the packings that `packit verify` checks."""

from __future__ import annotations

import shutil
from functools import cache

from trimesh import creation

from campaigns.fuzzing import file_changes, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.reading.boxes import box_types, box_unit, unit_note
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.reading.mesh_boxes import with_meshes
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import RECORD, write_record
from packit_sim.parts.results.verification import verify_record

_FOLDER = b"@FOLDER@"
"""Stands for the folder of the meshes that texts name."""

_TEXTS = (
    "A:30 x 2.5e1x.2in=2\nB:12x8x5cm",
    "cylinder:220x300mm\nbed:cylinder:22 x 30cm=3",
    "30x20x10\n@FOLDER@/case.obj\nC:@FOLDER@/case.obj=2",
)


def _read_texts(data: bytes) -> None:
    """Read a line for each box, as a command line has them."""
    case = world.written("boxes/case.obj", world.exported(creation.box((1, 2, 3)), "obj"))
    text = data.replace(_FOLDER, bytes(case.parent)).decode("utf-8", "surrogateescape")
    lines = text.split("\n")
    unit = box_unit(lines) or "mm"
    unit_note(lines)
    boxes, _ = with_meshes(lines, unit, ReadSettings(), 1)
    box_types(boxes, unit, 1)


def _meshes() -> list[bytes]:
    """Return a solid, a ring, and a case with a wall inside."""
    inner = creation.box((1, 1, 1))
    inner.invert()
    case = creation.box((4, 4, 4)) + inner
    ring = creation.annulus(1.0, 2.0, 3.0, sections=6)
    return [world.exported(mesh, "obj") for mesh in (creation.box((1, 2, 3)), ring, case)]


def _read_mesh(data: bytes) -> None:
    """Read a mesh as a container, and find what is around it."""
    file = world.written("container/case.obj", data)
    (box,) = box_types(with_meshes([str(file)], "mm", ReadSettings(), 1)[0], "mm", 1)
    assert isinstance(box.form, MeshContainer)
    box.form.walls(margin=0.02 * min(box.size))


@cache
def _records() -> list[bytes]:
    """Return the record of a packing in a cylinder, and that of one in a mesh.

    The meshes of both are in the folder of the reader.
    """
    ring = creation.annulus(3.0, 12.0, 10.0, sections=8)
    mesh = MeshContainer(ItemType("ring", ring.vertices, ring.faces))
    parts = [Part(f"cube {n}", creation.box((n, n, n)), count=2) for n in (2, 3)]
    records = []
    containers: list[Container] = [CylinderContainer(9.0, 8.0), mesh]
    for number, container in enumerate(containers):
        packed = pack(parts, container, settings=PackSettings(workers=1, iterations=50))
        folder = world.folder() / f"verified-{number}"
        write_record(packed, check(packed), folder, {})
        shutil.copytree(
            folder / "meshes", world.folder() / "verified" / "meshes", dirs_exist_ok=True
        )
        records.append((folder / RECORD).read_bytes())
    return records


def _verify(data: bytes) -> None:
    _records()
    report = verify_record(world.written(f"verified/{RECORD}", data))
    for problem in report.problems:
        world.require_clean(str(problem))
    for text in report.unchecked:
        world.require_clean(text)


READERS = (
    Reader(
        "boxes",
        "boxes and containers as text",
        lambda: [text.encode() for text in _TEXTS],
        _read_texts,
        file_changes.tokens,
    ),
    Reader("containers", "meshes of containers", _meshes, _read_mesh, file_changes.tokens, 20.0),
    Reader(
        "verified-records",
        "packings in containers, verified",
        lambda: list(_records()),
        _verify,
        json_tree,
        20.0,
    ),
)
"""The readers of this module."""
