"""An arm executes plans: packings of parts at real sizes, stored packs, and replays elsewhere."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from PIL import Image
from trimesh import creation, load_mesh

from packit_sim import Box, Item, ItemType, ShapeLibrary
from packit_sim.core.errors import ArgumentError, PackFormatError
from packit_sim.game.datasets.pack_files import write_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.evaluation.executed import execute_pack
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.results.execution import execute_packing
from packit_sim.physics.convex import disk_cache
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell, SuctionGripper
from packit_sim.robot.executed_item import ExecutedItem, Outcome
from packit_sim.robot.plans import ExecutedPlan, execute_plan
from packit_sim.robot.replays import write_replay
from tests.runs import packit

CELL = RobotCell(decomposition=DecompositionSettings(method="bisection"), speed=2.0)

SIDES = (151.0, 90.0, 60.0)
"""Sides of the box in mm."""


@pytest.fixture(autouse=True, scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path_factory.mktemp("kept")))
        yield


def turned(angle: float, *at: float) -> Floats:
    """Return a pose: a turn about the vertical in degrees, and a place."""
    a = np.radians(angle)
    pose = np.eye(4)
    pose[:2, :2] = (np.cos(a), -np.sin(a)), (np.sin(a), np.cos(a))
    pose[:3, 3] = at
    return pose


def written(folder: Path, poses: dict[str, Floats], **changes: object) -> Path:
    """Write a packing of blocks of 40 x 30 x 20 mm with a unit."""
    folder.mkdir(exist_ok=True)
    mesh = creation.box((40, 30, 20))
    types = [ItemType(name, mesh.vertices, mesh.faces) for name in poses]
    placements = [Placement.from_matrix(n, pose, 0) for n, pose in enumerate(poses.values())]
    container = changes.pop("container", BoxContainer(SIDES))
    packing = Packing(types, container, placements, objective="bins")  # type: ignore[arg-type]
    file = folder / "packing.json"
    packing.write(file)
    file.write_text(json.dumps(json.loads(file.read_text()) | {"unit": "mm"} | changes))
    return file


POSES = {
    "first": turned(0, 22, 17, 10.5),
    "turned": turned(30, 80, 40, 12),
    "on top": turned(0, 23, 18, 31),
}


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> ExecutedPlan:
    (found,) = execute_packing(written(tmp_path_factory.mktemp("packing"), POSES), CELL)
    return found


def test_an_interrupted_plan_goes_on_to_the_same_trajectory() -> None:
    block = Item(ShapeLibrary.open("everyday")["open-cardboard-box"], scale=0.01)
    plan = [PosedItem.at(block, Motion.shift((x, 0.2, 0.2))) for x in (0.2, 0.5, 0.8)]
    kept: list[tuple[ExecutedItem, ...]] = []
    whole = execute_plan(plan, (100, 40, 40), CELL, callback=kept.append)
    assert [len(tried) for tried in kept] == [1, 2, 3]
    tried = pickle.loads(pickle.dumps(kept[1]))
    rest = execute_plan(plan, (100, 40, 40), CELL, tried=tried, callback=kept.append)
    assert [len(tried) for tried in kept] == [1, 2, 3, 3]
    assert rest.trajectory.digest == whole.trajectory.digest


def test_parts_are_put_in_at_real_sizes_and_in_any_rotation(box: ExecutedPlan) -> None:
    trajectory = box.trajectory
    assert np.allclose(trajectory.cell.size(trajectory.cells), np.array(SIDES) / 1000)
    assert box.inside == 3 and box.executed == pytest.approx(1)
    assert box.scores["planned"] == pytest.approx(1) and box.scores["collapses"] == 0
    assert box.scores["displacement"] < 0.002 and box.scores["penetration"] < 0.001
    for one, pose in zip(trajectory.attempts, POSES.values(), strict=True):
        assert one.outcome is Outcome.PLACED
        assert np.allclose(one.planned.center[:2] * 151, pose[:2, 3], atol=0.01)


def test_a_part_avoids_what_has_moved(tmp_path: Path) -> None:
    """The second one stands where the first falls to: 1 mm lower, and turned by its fall."""
    poses = {"tilted": turned(0, 22, 17, 10), "close": turned(0, 60, 17, 10)}
    (found,) = execute_packing(written(tmp_path, poses), CELL)  # they overlap by 2 mm
    planned = [one.planned.center * 151 for one in found.trajectory.attempts]
    assert found.inside == 2 and planned[1][2] == pytest.approx(10, abs=0.6)
    assert 62 <= planned[1][0] < 64.1


def test_a_part_without_a_place_is_set_aside(tmp_path: Path) -> None:
    poses = {f"{n}": turned(0, 22, 17, 10 + 20 * n) for n in range(3)}
    (found,) = execute_packing(written(tmp_path, poses, box=[44, 34, 40]), CELL)
    assert [str(one.outcome) for one in found.trajectory.attempts] == [
        "placed",
        "placed",
        "no path",
    ]
    assert found.inside == 2 and found.executed == pytest.approx(2 / 3)


def test_a_replay_has_all_that_other_simulators_need(box: ExecutedPlan, tmp_path: Path) -> None:
    replay = json.loads(write_replay(box.trajectory, tmp_path).read_text())
    assert replay["joints"] == ["x", "y", "z", "wrist"]
    assert replay["box"] == pytest.approx([0.151, 0.09, 0.06])
    for one, ours in zip(replay["attempts"], box.trajectory.attempts, strict=True):
        assert np.array_equal(one["joints"], ours.recording.joints)
        assert one["mass"] == pytest.approx(0.04 * 0.03 * 0.02 * 200)
        mesh = load_mesh(tmp_path / one["mesh"])
        assert np.allclose(mesh.extents, (0.04, 0.03, 0.02))
        assert etree.parse(tmp_path / one["urdf"]).findall("joint")
        position = one["poses"][-1][:3]
        assert np.allclose(position, ours.recording.poses[-1, :3] * 0.151)


def test_mujoco_reads_the_cell_with_all_parts_where_they_rest(
    box: ExecutedPlan, tmp_path: Path
) -> None:
    replay = json.loads(write_replay(box.trajectory, tmp_path).read_text())
    file = tmp_path / replay["mjcf"]
    model = etree.parse(file)
    bodies = model.findall("worldbody/body")
    last = box.trajectory.attempts[-1].recording
    ends = {int(item): pose for (_, item), pose in zip(last.rows, last.poses, strict=True)}
    assert [body.get("name") for body in bodies] == ["item 0", "item 1", "item 2"] and ends
    for n, pose in ends.items():
        place = [float(number) for number in bodies[n].get("pos", "").split()]
        assert place == pytest.approx(pose[:3] * 0.151)
    for mesh in model.findall("asset/mesh"):
        assert (tmp_path / mesh.get("file", "")).is_file()
    walls = {one.get("name"): one for one in model.findall("worldbody/geom[@type='box']")}
    right = [float(number) for number in walls["right"].get("pos", "").split()]
    assert right[0] - float(walls["right"].get("size", "").split()[0]) == pytest.approx(0.151)
    mujoco = pytest.importorskip("mujoco")
    read = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(read)
    before = data.qpos.copy()
    for _ in range(240):
        mujoco.mj_step(read, data)
    assert read.nbody == 4
    assert np.abs(data.qpos - before).max() < 0.003


def test_the_command_line_executes_packings(tmp_path: Path) -> None:
    file = written(tmp_path, {"first": POSES["first"]})
    out = tmp_path / "replay"
    film = tmp_path / "film.gif"
    options = ("--decomposition", "bisection", "--replay", str(out), "--film", str(film))
    shown = packit("execute", str(file), *options)
    assert "1.000" in shown and (out / "box-0" / "replay.json").is_file()
    with Image.open(film) as opened:
        assert opened.n_frames > 5


def test_packings_that_no_arm_packs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PackFormatError, match=r"field 'unit' is missing: an arm needs real sizes"):
        execute_packing(written(tmp_path, POSES, unit=""), CELL)
    with pytest.raises(ArgumentError, match=r"unit 'furlong' is not known"):
        execute_packing(written(tmp_path, POSES, unit="furlong"), CELL)
    round_box = written(tmp_path, POSES, container=CylinderContainer(151.0, 60.0))
    with pytest.raises(ArgumentError, match=r"choose boxes with nothing fixed in them"):
        execute_packing(round_box, CELL)
    weak = replace(CELL, density=20_000.0, gripper=SuctionGripper(cups=(0.004,)))
    in_inches = written(tmp_path / "in", POSES, unit="in")
    with pytest.raises(ArgumentError, match=r"weighs 0.48 kg: the largest cup lifts at most"):
        execute_packing(written(tmp_path, POSES), weak)
    with pytest.raises(ArgumentError, match=r"is higher than the reach of arm 'gantry'"):
        execute_packing(in_inches, CELL)


def test_stored_placements_are_executed(tmp_path: Path) -> None:
    library = ShapeLibrary.open("blockout")
    box = Box((40, 40, 20))
    for name in list(library)[:3]:
        item = Item(library[name], 0.02)
        box.place(item, box.blbf(item) or (0, 0, 0))
    write_packs(tmp_path / "packs.jsonl", [Pack.of(box, library)])
    found = execute_pack(Pack.of(box, library), library, CELL)
    assert found.inside == 3 and found.executed == pytest.approx(1)
    for one, chosen in zip(found.trajectory.attempts, box.placed, strict=True):
        assert np.allclose(one.planned.center[:2], PosedItem.of(chosen).center[:2])
    shown = packit(
        *("execute", tmp_path / "packs.jsonl", "--stored", "--decomposition", "bisection")
    )
    assert "1.000" in shown
