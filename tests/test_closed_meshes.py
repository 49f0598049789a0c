"""Meshes that are nearly closed are solid, and open ones are named, everywhere alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.repair import repair_mesh
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.prepared import prepare
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import write_record

QUICK = PackSettings(workers=1, iterations=20)

BLOCK = creation.box((100, 100, 100))

FINE = BLOCK.subdivide().subdivide().subdivide().subdivide()


def of(mesh: trimesh.Trimesh, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def flipped(faces: np.ndarray, every: int) -> np.ndarray:
    faces = faces.copy()
    faces[::every] = faces[::every, ::-1]
    return faces


def without_lid(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return of(mesh, mesh.faces[mesh.face_normals[:, 2] < 0.5])


def cube(side: float, name: str = "cube", count: int = 1) -> Part:
    return Part(name, creation.box((side, side, side)), count=count)


NEARLY_CLOSED = {
    "one of 12 triangles": of(BLOCK, BLOCK.faces[1:]),
    "one of 3072 triangles": of(FINE, FINE.faces[1:]),
    "inverted": of(BLOCK, BLOCK.faces[:, ::-1]),
    "inverted, with a hole": of(BLOCK, BLOCK.faces[1:, ::-1]),
    "mixed winding": of(BLOCK, flipped(BLOCK.faces, 2)),
    "mixed winding, with a hole": of(BLOCK, flipped(BLOCK.faces[1:], 3)),
    "doubled": of(BLOCK, np.concatenate([BLOCK.faces, BLOCK.faces])),
    "degenerate triangles": of(BLOCK, np.concatenate([BLOCK.faces, BLOCK.faces[:4, [0, 0, 1]]])),
    "two holes that meet at a corner": of(
        FINE, np.delete(FINE.faces, np.flatnonzero((FINE.faces == 8).any(axis=1))[:3:2], axis=0)
    ),
}


HOLED = [name for name in NEARLY_CLOSED if "hole" in name or "one of" in name]


def placed(parts: list[Part], *places: tuple[float, float, float]) -> PackedParts:
    """Return parts in a box, one of each, unturned, by their low corners."""
    task = prepared_task(parts, (142, 101, 101), "volume", QUICK)
    placements = tuple(
        Placement(n, Motion.shift(np.array(place) - own.low))
        for n, (place, own) in enumerate(zip(places, task.types, strict=True))
    )
    container = task.container(task.boxes[0])
    return PackedParts(task, (Packing(task.types, container, placements, 0.0, "knapsack"),))


def faults(packed: PackedParts, folder: Path) -> list[bool]:
    """Return whether the nester's check, the check of files, and that of the record complain."""
    found = check(packed)
    folder.mkdir(exist_ok=True)
    write_record(packed, found, folder, {})
    report = verify_packing(folder / "packing.json")
    assert report.volume == pytest.approx(packed.volume)
    return [bool(each) for each in (packed.packings[0].problems(), found.problems, report.problems)]


@pytest.mark.parametrize("name", NEARLY_CLOSED)
def test_a_nearly_closed_block_is_a_block(name: str, tmp_path: Path) -> None:
    part = Part("block", NEARLY_CLOSED[name])
    prepared = prepare(part, "mm")
    assert prepared.volume == pytest.approx(1e6, rel=1e-6)
    assert prepared.is_closed and not prepared.is_shell
    assert (prepared.filled_holes > 0) == (name in HOLED)
    beside = placed([part, cube(10)], (0.5, 0.5, 0.5), (101, 45, 45))
    assert not any(faults(beside, tmp_path))
    inside = placed([part, cube(10)], (0.5, 0.5, 0.5), (40, 45, 50))
    assert all(faults(inside, tmp_path))


def test_nothing_is_packed_into_a_block_that_fills_its_box() -> None:
    for name in ("one of 12 triangles", "one of 3072 triangles"):
        parts = [Part("block", NEARLY_CLOSED[name]), cube(10, count=20)]
        packed = pack(parts, (101, 101, 101), settings=QUICK)
        assert packed.counts == {0: 1}
        assert "holes in the surface that were closed: block (1)" in packed.notes


@pytest.mark.parametrize("mesh", [BLOCK, FINE], ids=["coarse", "fine"])
def test_a_box_of_sheets_takes_parts_with_a_warning(mesh: trimesh.Trimesh) -> None:
    sheets = without_lid(mesh)
    prepared = prepare(Part("box", sheets), "mm")
    assert prepared.is_shell and not prepared.is_closed and prepared.filled_holes == 0
    packed = pack([Part("box", sheets), cube(40)], (101, 101, 101), settings=QUICK)
    assert packed.count == 2 and check(packed).problems == ()
    opened, inside = packed.notes
    assert opened.startswith("open, so that other parts may be placed inside") and "box" in opened
    assert inside == "warning: box is open, and other parts are inside its hollow: cube (1)"
    beside = placed([Part("box", sheets), cube(40)], (0.5, 0.5, 0.5), (100.5, 0.5, 0.5))
    assert not beside.packings[0].problems()
    assert not any("warning" in note for note in beside.notes)


def test_a_cup_with_walls_takes_parts_without_a_warning() -> None:
    tube = creation.annulus(r_min=40, r_max=45, height=80)
    base = creation.cylinder(radius=45, height=5).apply_translation((0, 0, -42.5))
    cup = Part("cup", trimesh.util.concatenate([tube, base]), rotations="upright")
    packed = pack([cube(40), cup], (91, 91, 86), settings=replace(QUICK, iterations=60))
    assert packed.count == 2 and check(packed).problems == ()
    assert not any("warning" in note for note in packed.notes)


def test_sheets_and_shells_stay_as_they_are() -> None:
    across, up = np.meshgrid(np.linspace(0, 50, 9), np.linspace(0, 50, 9))
    wave = np.column_stack([across.ravel(), up.ravel(), 5 * np.sin(across.ravel() / 5)])
    n = np.arange(81).reshape(9, 9)
    a, b, c, d = (each.ravel() for each in (n[:-1, :-1], n[1:, :-1], n[:-1, 1:], n[1:, 1:]))
    sheet = trimesh.Trimesh(
        wave, np.concatenate([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    )
    for mesh in (
        sheet,
        without_lid(BLOCK),
        without_lid(creation.cylinder(20, 100)),  # a test tube: its mouth is small
        of(BLOCK, BLOCK.faces[np.abs(BLOCK.face_normals[:, 2]) < 0.5]),
    ):
        whole, repairs = repair_mesh(mesh)
        assert repairs.filled_holes == 0 and len(whole.faces) == len(mesh.faces)
        assert prepare(Part("it", mesh), "mm").is_shell


def test_nested_and_separate_shells_have_the_volumes_that_they_mean() -> None:
    inner, other = creation.box((50, 50, 50)), creation.box((50, 50, 50))
    other.apply_translation((100, 0, 0))
    cavity, inverted = inner.copy(), other.copy()
    cavity.invert()
    inverted.invert()
    for shell, volume in ((cavity, 1e6 - 50**3), (inner, 1e6), (inverted, 1e6 + 50**3)):
        part = Part("it", trimesh.util.concatenate([BLOCK, shell]))
        assert prepare(part, "mm").volume == pytest.approx(volume, rel=2e-3)


def test_every_triangle_may_be_the_one_that_is_missing() -> None:
    cylinder = creation.cylinder(radius=30, height=100, sections=24)
    for mesh in (BLOCK, cylinder, creation.icosphere(subdivisions=1)):
        for missing in range(len(mesh.faces)):
            whole, repairs = repair_mesh(of(mesh, np.delete(mesh.faces, missing, axis=0)))
            assert whole.is_volume and repairs.filled_holes == 1
            assert whole.volume == pytest.approx(mesh.volume, rel=0.03)


def test_many_holes_are_closed() -> None:
    ball = creation.icosphere(subdivisions=4, radius=50)
    rng = np.random.default_rng(0)
    holed = of(ball, ball.faces[rng.random(len(ball.faces)) > 0.03])
    prepared = prepare(Part("ball", holed), "mm")
    assert prepared.is_closed and prepared.filled_holes > 100
    assert prepared.volume == pytest.approx(ball.volume, rel=0.01)
