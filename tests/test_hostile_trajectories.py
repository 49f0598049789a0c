"""Trajectories and arms of strangers are read exactly, or refused: no crash, no error of another
kind, no memory beyond what is stated.
"""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim import Item, Shape
from packit_sim.core.errors import ArgumentError, PackFormatError, PackItError
from packit_sim.core.files import replace_text
from packit_sim.game.explorer.arm_replay import ArmReplay
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.robot.arms import arm_of
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import Outcome
from packit_sim.robot.gantry import GANTRY
from packit_sim.robot.measures import measures
from packit_sim.robot.recording import Recording
from packit_sim.robot.replays import write_replay
from packit_sim.robot.trajectory import MAX_STEPS, Attempt, Trajectory

CELLS = (100, 100, 100)
SHAPE = Shape.from_mesh(creation.box((1, 2, 3)), "box/a")
ITEM = PosedItem.at(Item(SHAPE, 0.02), Motion.shift((0.5, 0.5, 0.2)))
POSES = np.array([[0.5, 0.5, 0.2, 1.0, 0, 0, 0]] * 2)

Arrays = dict[str, Any]


def trajectory() -> Trajectory:
    """One item that a cup holds from step 1 to 3 of 5."""
    own = Recording(np.zeros((5, 4)), (1, 3), 0.004, np.array([[0, 0], [2, 0]]), POSES)
    return Trajectory(RobotCell(), CELLS, (Attempt(ITEM, ITEM, Outcome.PLACED, own),))


def changed(change: Callable[[Arrays, Any], None]) -> bytes:
    """Return the file of a trajectory whose arrays and head were changed."""
    with np.load(io.BytesIO(trajectory().to_bytes())) as file:
        arrays = dict(file)
    head = json.loads(arrays["head"].tobytes())
    change(arrays, head)
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    np.savez_compressed(out := io.BytesIO(), **arrays)
    return out.getvalue()


def put(name: str, value: Any) -> Callable[[Arrays, Any], None]:
    """Replace an array, or a field of the attempt."""

    def change(arrays: Arrays, head: Any) -> None:
        if name in arrays:
            arrays[name] = value
        else:
            head["attempts"][0][name] = value

    return change


def declared(shape: str, kind: str = "<f8") -> bytes:
    """Return a trajectory whose joints have another header than content."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    joints = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(64)
    with zipfile.ZipFile(io.BytesIO(trajectory().to_bytes())) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(out := io.BytesIO(), "w") as archive:
        for name, content in (members | {"joints_0.npy": joints}).items():
            archive.writestr(name, content)
    return out.getvalue()


def read(data: bytes) -> Trajectory:
    return Trajectory.from_bytes(data, lambda _: SHAPE)


def poses(*row: float) -> Callable[[Arrays, Any], None]:
    return put("poses_0", np.array([row] * 2, float))


WRONG: dict[str, tuple[bytes, str]] = {
    "an array alone": (b"\x93NUMPY\x01\x00" + bytes(100), "not a zip file"),
    "no head": (changed(lambda arrays, _: arrays.pop("poses_0")), "no item named"),
    "another format": (changed(lambda _, head: head.update(format=2)), "format 2 is not known"),
    "joints of no length": (changed(put("joints_0", np.array(1.0))), r"of shape \(\)"),
    "objects": (declared("(2, 4)", "|O"), "is object of shape"),
    "petabytes": (declared("(100000000000000, 4)"), "would take 3,200,000,000,000,000 bytes"),
    "a negative length": (declared("(-1, 4)"), r"of shape \(-1, 4\)"),
    "a short array": (declared("(3, 4)"), "does not have the 96 bytes"),
    "another arm's joints": (changed(put("joints_0", np.zeros((5, 7)))), r"of shape \(5, 7\)"),
    "an item that is not there": (changed(put("rows_0", np.array([[0, 1]] * 2))), "none of the"),
    "a negative item": (changed(put("rows_0", np.array([[0, -1]] * 2))), "none of the first 1"),
    "steps backwards": (changed(put("rows_0", np.array([[2, 0], [0, 0]]))), "of its 5 steps"),
    "a step too far": (changed(put("rows_0", np.array([[0, 0], [5, 0]]))), "of its 5 steps"),
    "fewer rows": (changed(put("rows_0", np.array([[0, 0]]))), "1 rows and 2 poses"),
    "not there at first": (changed(put("rows_0", np.array([[1, 0]] * 2))), "is at first"),
    "joints that are no numbers": (changed(put("joints_0", np.full((5, 4), np.nan))), "a number"),
    "an infinite place": (changed(poses(np.inf, 0, 0, 1, 0, 0, 0)), "not a number up to 1e"),
    "a far place": (changed(poses(1e300, 0, 0, 1, 0, 0, 0)), "not a number up to 1e"),
    "no rotation": (changed(poses(0, 0, 0, 0, 0, 0, 0)), "length must be 1"),
    "a short pose": (changed(put("planned", [1.0])), "array of length 7"),
    "a plan without rotation": (changed(put("planned", [0.0] * 7)), "length must be 1"),
    "a location": (changed(put("location", [10**18] * 3)), "not a number up to 1e"),
    "held for ever": (changed(put("held", [0, 6])), "held from 0 to 6 of 5 steps"),
    "held backwards": (changed(put("held", [3, 1])), "held from 3 to 1 of 5 steps"),
    "a cup of no size": (changed(put("radius", 1e-320)), "none of the gripper's"),  # crashed FCL
    "a scale": (changed(put("scale", 0.0)), "scale 0.0 is not possible"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_trajectory_is_refused(name: str) -> None:
    data, message = WRONG[name]
    with pytest.raises(PackItError, match=message):
        read(data)


def test_a_right_trajectory_is_measured() -> None:
    found = read(trajectory().to_bytes())
    assert found.digest == trajectory().digest
    assert measures(found, [ITEM.item])["planned"] == 1


@pytest.mark.parametrize("seed", range(20))
def test_the_viewer_replays_a_damaged_trajectory_or_refuses_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = (0.0, -1.0, 3.0, 1e9, -1e9, 1e300, np.inf, np.nan, 1e-300)

    def damage(arrays: Arrays, _: Any) -> None:
        name = str(rng.choice(["joints_0", "poses_0", "rows_0"]))
        array = arrays[name].copy()
        value = rng.choice(values) if array.dtype == float else rng.integers(-1, 6)
        array.flat[rng.integers(array.size)] = value
        arrays[name] = array

    try:
        replay = ArmReplay.of(read(changed(damage)))
    except PackItError:
        return
    for moment in (0.0, replay.seconds):
        shown = [pose.matrix for pose in replay.at(moment).poses if pose is not None]
        assert shown and np.isfinite(shown).all()


def test_too_many_steps_are_refused_before_they_are_read() -> None:
    with pytest.raises(PackFormatError, match=f"at most {MAX_STEPS * 32:,} are possible"):
        read(declared(f"({MAX_STEPS + 1}, 4)"))


SIZE, PLACE = '"0.06 2.4 0.06"', 'xyz="0 0 1.56"'

ARMS = {
    "half a character": (b"\xff", "can't decode byte 0xff"),
    "an entity": (
        b'<!DOCTYPE r [<!ENTITY e SYSTEM "/etc/passwd">]>'
        + GANTRY.replace("</robot>", "<a>&e;</a></robot>").encode(),
        "has a DOCTYPE",
    ),
    "no number": (GANTRY.replace(SIZE, '"nan 1 1"').encode(), "is not 3 of numbers from 0.0001"),
    "no size": (GANTRY.replace(SIZE, '"0 0 0"').encode(), "is not 3 of numbers from 0.0001"),
    "two sides": (GANTRY.replace(SIZE, '"1 1"').encode(), "is not 3 of numbers from 0.0001"),
    "a far place": (GANTRY.replace(PLACE, 'xyz="1e308 0 0"').encode(), "from -1000 to 1000"),
    "a limit": (GANTRY.replace('lower="0.0"', 'lower="nan"').encode(), "from -1000 to 1000"),
    "no link": (GANTRY.replace('<link name="tool">', "<link>").encode(), "has no link 'tool'"),
    "many boxes": (
        GANTRY.replace("</robot>", "<collision/>" * 1000 + "</robot>").encode(),
        "more than 200 shapes",
    ),
}


@pytest.mark.parametrize("name", ARMS)
def test_a_wrong_arm_is_refused(tmp_path: Path, name: str) -> None:
    data, message = ARMS[name]
    file = tmp_path / "arm.urdf"
    file.write_bytes(data)
    with pytest.raises(ArgumentError, match=message) as raised:
        arm_of(RobotCell(arm=str(file)), CELLS)
    assert str(file) in str(raised.value)


def test_an_arm_is_no_device(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").symlink_to("/dev/zero")
    with pytest.raises(OSError, match="not a regular file"):
        arm_of(RobotCell(arm=str(tmp_path / "arm.urdf")), CELLS)


def test_a_replay_replaces_only_replays(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "replay.json").write_text('{"my": "own"}')
    with pytest.raises(ArgumentError, match="not a file that this command writes"):
        write_replay(trajectory(), mine)
    assert [each.name for each in mine.iterdir()] == ["replay.json"]
    file = write_replay(trajectory(), tmp_path / "ours")
    assert write_replay(trajectory(), tmp_path / "ours") == file
    mesh = file.parent / json.loads(file.read_text())["attempts"][0]["mesh"]
    mesh.write_text("mine")
    with pytest.raises(ArgumentError, match="exists with other content"):
        write_replay(trajectory(), tmp_path / "ours")
    assert mesh.read_text() == "mine"


def test_an_earlier_replay_holds_until_the_new_one_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_replay(trajectory(), tmp_path)
    attempt = json.loads(file.read_text())["attempts"][0]
    before = {name: (tmp_path / attempt[name]).read_bytes() for name in ("mesh", "urdf")}
    other = Item(Shape.from_mesh(creation.box((3, 2, 1)), "box/b"), 0.02)
    posed = PosedItem.at(other, Motion.shift((0.5, 0.5, 0.2)))
    own = trajectory().attempts[0].recording
    new = Trajectory(RobotCell(), CELLS, (Attempt(posed, posed, Outcome.PLACED, own),))

    for beginning in ("arm-0.004", "replay.json"):

        def killed(path: Path, text: str, beginning: str = beginning) -> None:
            if path.name.startswith(beginning):
                raise KeyboardInterrupt
            replace_text(path, text)

        monkeypatch.setattr("packit_sim.robot.replays.replace_text", killed)
        with pytest.raises(KeyboardInterrupt):
            write_replay(new, tmp_path)
        assert json.loads(file.read_text())["attempts"][0] == attempt
        assert {each: (tmp_path / attempt[each]).read_bytes() for each in before} == before
