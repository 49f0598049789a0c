"""The explorer without a browser: its models, its panel and its responses."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import structs

from packit_sim.box import Box
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.execution_checks import trajectories_folder
from packit_sim.game.datasets.pack_files import dataset_file, read_packs, write_packs
from packit_sim.game.datasets.packs import ItemRecord, Pack, PackedItem
from packit_sim.game.datasets.provenance import Other, Played
from packit_sim.game.evaluation.results import ResultsError, Rollout
from packit_sim.game.explorer import panels
from packit_sim.game.explorer.collection import PackCollection
from packit_sim.game.explorer.controls import NOTHING
from packit_sim.game.explorer.query import FitQuery
from packit_sim.game.explorer.redraw_thread import RedrawThread
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.placement import PosedItem
from packit_sim.render.coloring import PALETTE, ColorKey, ColorScale, by_category
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import Outcome
from packit_sim.robot.recording import Recording
from packit_sim.robot.trajectory import Attempt, Trajectory
from packit_sim.rules import End
from packit_sim.web.box_view import corners, reach
from packit_sim.web.surfaces import MAX_TRIANGLES, surface
from packit_sim.web.web_page import aim_camera, camera_of
from tests.runs import run_packit
from tests.zoo import BALL, CUBE, cube_of

pytest.importorskip("viser")
from packit_sim.game.explorer.explorer import Explorer

GLASS = 0.12


@pytest.fixture(name="library", scope="module")
def _library() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


@pytest.fixture(name="packs", scope="module")
def _packs() -> list[Pack]:
    return read_packs(dataset_file("starter"))[:3]


def result(pack: Pack, library: ShapeLibrary, number: int, kept: int, agent: str) -> Pack:
    """What an agent would leave that places the first so many items where they were."""
    task = pack.task(library)
    items = pack.items[:kept]
    volume = sum(library[i.shape].volume * i.scale for i in items)
    played = Played(
        agent=agent,
        task=number,
        task_digest=task.digest,
        seed=0,
        total=volume / task.volume,
        end=str(End.NO_LOCATION),
        seconds=1.0,
    )
    return Rollout(replace(pack, items=items, density=volume, provenance=played)).pack


@pytest.fixture(name="opened", scope="module")
def _opened(packs: list[Pack], library: ShapeLibrary) -> Iterator[Explorer]:
    with Explorer(PackCollection(packs, library)) as explorer:
        yield explorer


@pytest.fixture(name="explorer")
def _explorer(opened: Explorer) -> Explorer:
    """One for all tests, as it was at first: to draw a pack takes a second."""
    controls = opened.controls
    controls.item.value = controls.axis.value = controls.wanted.value = NOTHING
    controls.explode.value = 0.0
    controls.set_step(len(opened.views[0].placed))
    opened.wait()
    return opened


def shown(explorer: Explorer, box: int = 0) -> int:
    """How many whole items can be seen."""
    return sum(handle.visible for handle in explorer.boxes[box].items)


def test_items_that_settled_are_shown_where_they_rest(packs, library) -> None:
    placed = packs[0].placed(library)
    settled = tuple(PackedItem.of(PosedItem.of(one)) for one in placed)
    view = PackCollection([replace(packs[0], items=settled)], library)
    with Explorer(view) as explorer:
        for handle, one in zip(explorer.boxes[0].items, placed, strict=True):
            assert handle.position == pytest.approx(one.center)
        controls = explorer.controls
        assert controls.axis.disabled and controls.wanted.options == (NOTHING,)
        controls.axis.value = "y"
        explorer.wait()
        assert shown(explorer) == len(placed) and not controls.notice.visible
        assert "settled" in controls.answer.content


def test_a_pack_is_shown_whole_at_first(explorer: Explorer, packs: list[Pack]) -> None:
    assert explorer.address.startswith("http://127.0.0.1:")
    assert shown(explorer) == len(packs[0].items)
    asked = explorer.controls.request
    assert (asked.pack, asked.second, asked.step) == (0, None, len(packs[0].items))


def test_the_step_says_how_many_items_are_seen(explorer: Explorer) -> None:
    explorer.controls.set_step(4)
    explorer.wait()
    assert [handle.visible for handle in explorer.boxes[0].items[:6]] == [True] * 4 + [False] * 2
    assert shown(explorer) == 4


def test_the_sequence_plays_to_its_end(
    explorer: Explorer, packs: list[Pack], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("packit_sim.game.explorer.explorer.PACE", 0.01)
    explorer.controls.set_step(2)
    explorer.wait()
    explorer.play()
    while explorer.controls.play.label != "Pause":
        time.sleep(0.005)
    while explorer.controls.play.label != "Play":
        time.sleep(0.01)
    assert explorer.controls.request.step == shown(explorer) == len(packs[0].items)


def test_another_pack_takes_the_place_of_the_first(explorer: Explorer, packs: list[Pack]) -> None:
    explorer.controls.switch_pack(-1)
    explorer.wait()
    assert explorer.controls.request.pack == 2
    assert shown(explorer) == len(packs[2].items)
    explorer.controls.switch_pack(1)
    explorer.wait()
    assert explorer.controls.request.pack == 0


def test_items_move_apart(explorer: Explorer, packs: list[Pack], library: ShapeLibrary) -> None:
    explorer.controls.explode.value = 0.5
    explorer.wait()
    middle = np.array((0.5, 0.5, 0.0))
    for handle, placed in zip(explorer.boxes[0].items, packs[0].placed(library), strict=True):
        assert handle.position == pytest.approx(placed.center + 0.5 * (placed.center - middle))


def test_a_cut_takes_away_what_is_beyond(
    explorer: Explorer, packs: list[Pack], library: ShapeLibrary
) -> None:
    explorer.controls.axis.value = "y"
    explorer.wait()
    scene = explorer.page.server.scene
    for n, placed in enumerate(packs[0].placed(library)):
        low, high = placed.center[1] + np.array((-0.5, 0.5)) * placed.item.extents[1]
        handle = explorer.boxes[0].items[n]
        cap = scene.get_handle_by_name(f"/first/parts/{n}/cap")
        if low < 0.5 < high:
            assert not handle.visible and cap.visible
            assert (cap.vertices + cap.position)[:, 1] == pytest.approx(0.5)
        else:
            assert handle.visible == (high <= 0.5) and cap is None
    explorer.controls.axis.value = NOTHING
    explorer.wait()
    assert shown(explorer) == len(packs[0].items)
    assert scene.get_handle_by_name("/first/parts/0/cap") is None


def test_a_chosen_item_stays_solid_while_the_others_turn_to_glass(explorer: Explorer) -> None:
    explorer.choose(0, 3)
    explorer.wait()
    opacities = [handle.opacity for handle in explorer.boxes[0].items]
    assert opacities[3] is None and set(opacities) == {None, GLASS}
    assert explorer.page.server.scene.get_handle_by_name("/first/label").text.startswith("3 ")
    explorer.choose(0, 3)
    explorer.wait()
    assert {handle.opacity for handle in explorer.boxes[0].items} == {None}
    assert explorer.page.server.scene.get_handle_by_name("/first/label") is None


def test_why_not_here_shows_where_and_names_what_blocks(
    explorer: Explorer, packs: list[Pack], library: ShapeLibrary
) -> None:
    controls = explorer.controls
    controls.set_step(6)
    explorer.wait()
    controls.wanted.value = controls.wanted.options[1]
    explorer.wait()
    wanted = packs[0].placed(library)[6]
    assert (controls.request.wanted, controls.request.location) == (6, wanted.location)
    assert f"{wanted.location} it fits" in controls.answer.content
    box = Box()
    for placed in packs[0].placed(library)[:6]:
        box.place(placed.item, placed.location)
    mask = box.feasible(wanted.item)
    assert f"{np.count_nonzero(mask):,} of 15,625" in controls.answer.content
    scene = explorer.page.server.scene
    assert len(scene.get_handle_by_name("/markers/dots").points) == np.count_nonzero(mask)
    blocked = next(tuple(n.tolist()) for n in np.argwhere(~mask) if box.why_not(wanted.item, n))
    controls.set_query(wanted.item.rotation, blocked)
    explorer.wait()
    found = box.why_not(wanted.item, blocked)
    for n in found.items:
        assert f"{n} ({packs[0].items[n].shape})" in controls.answer.content
        assert explorer.boxes[0].items[n].opacity == 0.35
    nodes = mask[:, :, blocked[2]]
    assert len(scene.get_handle_by_name("/markers/level").points) == np.count_nonzero(nodes)
    explorer.to_first()
    explorer.wait()
    assert controls.request.location == box.blbf(wanted.item)
    controls.set_step(7)
    explorer.wait()
    assert controls.request.wanted is None
    assert scene.get_handle_by_name("/markers/item") is None


def test_places_are_asked_about_where_items_are_in_theirs(
    explorer: Explorer, packs: list[Pack], library: ShapeLibrary
) -> None:
    controls = explorer.controls
    controls.explode.value = 0.5
    controls.set_step(6)
    explorer.wait()
    placed = packs[0].placed(library)[5]
    assert not np.allclose(explorer.boxes[0].items[5].position, placed.center)
    controls.wanted.value = controls.wanted.options[1]
    explorer.wait()
    assert explorer.boxes[0].items[5].position == pytest.approx(placed.center)
    assert controls.explode.disabled
    controls.wanted.value = NOTHING
    explorer.wait()
    assert controls.request.explode == 0.5 and not controls.explode.disabled


@pytest.mark.parametrize("way", [(1.0, 2.0, 0.5), (-3.0, 0.1, -1.0), (0.0, 0.0, 1.0)])
def test_a_camera_goes_to_what_it_is_to_see_on_the_side_where_it_is(way: Floats) -> None:
    camera = SimpleNamespace(position=np.array(way) + 7, look_at=np.full(3, 7.0))
    points = corners((300, 100, 50)) + np.array((1.0, -2.0, 3.0))
    aim_camera(camera, points, 1.5, camera_of(camera))
    toward = camera.position - camera.look_at
    toward /= np.linalg.norm(toward)
    assert toward == pytest.approx(np.array(way) / np.linalg.norm(way), abs=2e-3)
    view = camera_of(camera)
    rays = points - camera.position
    reach = math.tan(math.radians(view.fov) / 2) * -(rays @ toward)
    assert (np.abs(rays @ view.right) < 1.5 * reach).all()
    assert (np.abs(rays @ view.up) < reach).all()


def test_a_camera_shows_points_above_the_panel_of_a_telephone() -> None:
    camera = SimpleNamespace(position=np.zeros(3), look_at=np.ones(3))
    points = corners((100, 100, 100))
    aim_camera(camera, points, 390 / 844, top=0.4)
    view = camera_of(camera)
    rays = points - camera.position
    reach = math.tan(math.radians(view.fov) / 2) * -(rays @ view.toward)
    assert (np.abs(rays @ view.right) < 390 / 844 * reach).all()
    heights = rays @ view.up / reach  # 1 at the upper edge of the window, -1 at the lower one
    assert (heights > 1 - 2 * 0.4).all() and (heights < 1).all() and heights.max() > 0.8


def test_two_boxes_that_are_moved_apart_are_clear_of_each_other(
    packs: list[Pack], library: ShapeLibrary
) -> None:
    with Explorer(PackCollection(packs, library), 0, 1) as explorer:
        scene = explorer.page.server.scene
        for explode in (0.0, 1.5):
            explorer.controls.explode.value = explode
            explorer.wait()
            spans, tops = [], []
            for name, view in zip(("/first", "/second"), explorer.views, strict=True):
                x, _, _ = scene.get_handle_by_name(name).position
                points = reach(view.contents(), explode)
                spans.append((x + points[:, 0].min(), x + points[:, 0].max()))
                tops.append(points[:, 2].max())
                assert scene.get_handle_by_name(f"{name}/title").position[2] > tops[-1]
            assert spans[0][0] - spans[1][1] >= 0.2


def test_two_agents_stand_side_by_side(packs: list[Pack], library: ShapeLibrary) -> None:
    played = [
        result(packs[0], library, 0, 5, "one/of/them"),
        result(packs[1], library, 1, 4, "one/of/them"),
        result(packs[0], library, 0, 9, "the/other/one"),
    ]
    collection = PackCollection(played, library, packs)
    assert [collection.rivals(0), collection.rivals(1)] == [(2, 3), (4,)]
    with Explorer(collection, 0, 2) as explorer:
        assert [shown(explorer, n) for n in (0, 1)] == [5, 9]
        explorer.choose(1, 2)
        explorer.wait()
        for box in explorer.boxes:
            assert box.items[2].opacity is None and box.items[0].opacity == GLASS
        explorer.controls.switch_pack(1)
        explorer.wait()
        assert len(explorer.boxes) == 1 and explorer.controls.request.second is None


def test_what_an_agent_left_outside_is_known_from_the_tasks(
    packs: list[Pack], library: ShapeLibrary
) -> None:
    task = packs[0].task(library)
    view = PackCollection([result(packs[0], library, 0, 5, "a/b/c")], library, packs)[0]
    assert sorted(i.shape.id for i in view.items) == sorted(i.shape.id for i in task.items)
    assert sum(map(view.reward, range(len(view.items)))) == pytest.approx(1)
    without = PackCollection([result(packs[0], library, 0, 5, "a/b/c")], library)[0]
    assert without.outside == ()
    assert without.reward(2) == pytest.approx(view.reward(2))


def test_tasks_that_were_not_played_are_refused(packs: list[Pack], library: ShapeLibrary) -> None:
    played = [result(packs[0], library, 0, 5, "a/b/c")]
    with pytest.raises(ResultsError, match="another task 0"):
        _ = PackCollection(played, library, [packs[1]])[0]
    with pytest.raises(ResultsError, match=r"of task 2.*0 to 0"):
        PackCollection([result(packs[2], library, 2, 1, "a/b/c")], library, packs[:1])
    with pytest.raises(PackItError, match="no pack 9: choose 0 to 0"):
        _ = PackCollection(packs[:1], library)[9]


def test_a_pack_that_cant_be_shown_is_reported_and_the_page_works_on(
    packs: list[Pack], library: ShapeLibrary
) -> None:
    broken = replace(packs[1], outside=(ItemRecord("no-such-shape", 1.0),))
    with Explorer(PackCollection([packs[0], broken], library)) as explorer:
        explorer.controls.switch_pack(1)
        explorer.wait()
        assert "no-such-shape" in explorer.controls.notice.content
        explorer.controls.switch_pack(1)
        explorer.wait()
        assert explorer.controls.notice.content == "" and shown(explorer) == len(packs[0].items)


def test_an_empty_box_and_one_without_neighbours_are_shown(
    packs: list[Pack], library: ShapeLibrary
) -> None:
    empty = replace(packs[0], items=(), density=0.0)
    with Explorer(PackCollection([empty], library)) as explorer:
        assert explorer.boxes[0].items == ()


def executed(packs, library, folder: Path, moving: bool = True) -> Path:
    """Store a result whose only item an arm moves up after a second."""
    pack = result(packs[0], library, 0, 1, "a/b/c")
    (placed,) = pack.placed(library)
    start = PosedItem.of(placed)
    poses = [[*start.pose.shifted((0, 0, up)).translation, *start.pose.wxyz] for up in (0, 0.5)]
    own = Recording(
        np.zeros((481, 4)), (1, 2), 0.004, np.array([[0, 0], [240, 0]]), np.array(poses)
    )
    outcome = Outcome.PLACED if moving else Outcome.NO_PATH
    own = own if moving else Recording(np.zeros((0, 4)))
    arm = Trajectory(RobotCell(), pack.cells, (Attempt(placed, start, outcome, own),))
    data = arm.to_bytes()
    digest = hashlib.sha256(data).hexdigest()
    file = folder / "executed.jsonl"
    trajectories_folder(file).mkdir()
    (trajectories_folder(file) / f"{digest}.npz").write_bytes(data)
    played = structs.replace(pack.provenance, trajectory=digest)
    write_packs(file, [replace(pack, provenance=played)])
    return file


def test_the_arm_is_shown_with_items_where_they_are_meanwhile(packs, library, tmp_path) -> None:
    with Explorer(PackCollection.read(executed(packs, library, tmp_path), library)) as explorer:
        controls, (box,) = explorer.controls, explorer.boxes
        assert controls.arm.visible and len(box.items) == 1
        controls.arm.value = True
        explorer.wait()
        item, *bodies = box.items
        assert len(bodies) > 3 and all(body.visible for body in bodies)
        low = item.position[2]
        controls.set_seconds(1.5)
        explorer.wait()
        assert box.items[0].position[2] == pytest.approx(low + 0.5)
        explorer.choose(0, len(bodies))  # a click on the arm
        assert controls.item.value == NOTHING
        explorer.play()
        deadline = time.monotonic() + 30
        while controls.request.seconds < 2.0:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        controls.arm.value = False
        explorer.wait()
        assert len(box.items) == 1


def test_packs_without_an_arm_offer_none(explorer: Explorer) -> None:
    assert not explorer.controls.arm.visible and explorer.controls.request.seconds is None


@pytest.mark.parametrize("gone", ["file", "movement"])
def test_an_arm_that_cant_be_shown_is_reported(packs, library, tmp_path, gone: str) -> None:
    file = executed(packs, library, tmp_path, moving=gone != "movement")
    if gone == "file":
        shutil.rmtree(trajectories_folder(file))
    with Explorer(PackCollection.read(file, library)) as explorer:
        explorer.controls.arm.value = True
        explorer.wait()
        said = "the arm moved nothing" if gone == "movement" else "executed.jsonl.trajectories"
        assert said in explorer.controls.notice.content
        explorer.controls.arm.value = False
        explorer.wait()
        assert explorer.controls.notice.content == "" and len(explorer.boxes[0].items) == 1


def test_a_trajectory_in_another_folder_is_refused(packs, library, tmp_path) -> None:
    file = executed(packs, library, tmp_path)
    (arm,) = trajectories_folder(file).iterdir()
    file.write_text(file.read_text().replace(arm.stem, "../elsewhere"))
    with pytest.raises(PackItError, match=r"executed\.jsonl, line 1: .*'../elsewhere'"):
        PackCollection.read(file, library)


def test_names_in_lists_are_no_markup(packs: list[Pack], library: ShapeLibrary) -> None:
    pack = replace(packs[0], provenance=Other(author="<script>alert(1)</script>"))
    view = PackCollection([pack], library)[0]
    assert "<script" not in panels.facts(view)
    assert "&lt;b" in panels.legend(ColorKey("", (("<b>", PALETTE[0]),)))
    assert "&lt;b" in panels.legend(ColorScale("<b>", "0", "1")) and panels.legend(None) == ""


def test_the_list_has_every_item_with_its_volume_and_reward(
    packs: list[Pack], library: ShapeLibrary
) -> None:
    view = PackCollection(packs, library)[0]
    text = panels.items(view, by_category(view.items).of, 3, 1)
    assert text.count("<tr") == len(view.items) + 1
    assert text.count("opacity:0.5") == len(view.items) - 3
    for n, item in enumerate(view.items):
        assert f"{item.volume:.2%}" in text and f"{view.reward(n):.1%}" in text


def test_a_question_by_hand() -> None:
    box = Box()
    box.place(cube_of(60), (0, 0, 0))
    question = FitQuery(box, cube_of(40))
    assert question.first == (0, 15, 0)
    assert question.answer((15, 0, 0)) == "At (15, 0, 0) it fits."
    assert "0 (cube) is in its way" in question.answer((0, 0, 0))
    assert "sticks out at the right and top" in question.answer((20, 15, 20))
    assert (
        question.mask[15, 3, 2]
        and question.mask[0, 15, 0]
        and len(question.centers) == question.mask.sum()
    )
    assert question.centers.min(axis=0) == pytest.approx((0.2, 0.2, 0.2))
    nowhere = FitQuery(box, cube_of(48))
    assert nowhere.first is None and "none of 15,625" in nowhere.summary()


def test_what_bars_the_way_down_is_named_where_items_come_from_above() -> None:
    box = Box(kinematic=True)
    box.place(Item(CUBE, cube_of(100).scale * 0.125), (0, 0, 12))
    assert "0 (cube) is above it" in FitQuery(box, cube_of(20)).answer((2, 2, 0))


def test_large_meshes_are_reduced_and_small_ones_are_not() -> None:
    from trimesh import creation

    from packit_sim.geometry.shapes import Shape

    fine = Shape.from_mesh(creation.icosphere(subdivisions=5), "fine")
    assert len(fine.mesh.faces) > 4 * MAX_TRIANGLES
    shown = surface(fine)
    assert MAX_TRIANGLES / 2 < len(shown.faces) <= MAX_TRIANGLES
    assert np.linalg.norm(shown.vertices, axis=1) == pytest.approx(3**-0.5 / 2, rel=0.02)
    assert len(surface(BALL).faces) == len(BALL.mesh.faces)


def test_a_worker_does_once_what_was_asked_often() -> None:
    done: list[int] = []
    worker = RedrawThread(lambda: (time.sleep(0.05), done.append(1))[1])
    worker.start()
    for _ in range(50):
        worker.wake()
    worker.wait()
    worker.close()
    assert 1 <= len(done) <= 4


def test_work_that_fails_is_logged_and_the_worker_continues(
    caplog: pytest.LogCaptureFixture,
) -> None:
    calls: list[int] = []

    def work() -> None:
        calls.append(1)
        if len(calls) == 1:
            raise ZeroDivisionError

    worker = RedrawThread(work)
    worker.start()
    worker.wait()
    worker.wake()
    worker.wait()
    worker.close()
    assert "could not be drawn" in caplog.text and len(calls) == 2


@pytest.fixture(name="packit")
def _packit(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `packit view` without a screen; ends it at last."""
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str, **variables: str) -> subprocess.Popen[str]:
        without = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
        command = [sys.executable, "-u", "-m", "packit_sim", "view", *arguments]
        environment = {**without, "COLUMNS": "400", **variables}
        pipe = subprocess.PIPE
        started.append(
            subprocess.Popen(command, env=environment, text=True, stdout=pipe, stderr=pipe)
        )
        return started[-1]

    yield run
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_without_a_screen_the_address_is_printed_and_ctrl_c_ends_it(packit) -> None:
    process = packit("starter")
    assert "is shown at http://127.0.0.1:" in process.stdout.readline()
    assert "no screen" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    last = out.splitlines()[-1]  # what was being printed just then comes before it
    assert (process.returncode, last, err) == (0, "the viewer is closed", "")


@pytest.mark.slow
def test_with_a_screen_the_browser_is_opened(packit, tmp_path) -> None:
    noted = tmp_path / "noted"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" > {noted}\n')
    browser.chmod(0o755)
    process = packit("starter", "--pack", "1", DISPLAY=":0", BROWSER=f"{browser} %s")
    address = process.stdout.readline().split()[4]
    while process.poll() is None and not (noted.exists() and noted.read_text()):
        time.sleep(0.05)
    assert noted.read_text().strip() == address


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("starter", "--pack", "99"), "no pack 99: choose 0 to"),
        (("nowhere",), "nowhere: No such file"),
        (("starter", "--dataset", "nowhere"), "nowhere: No such file"),
    ],
)
def test_what_cant_be_shown_is_one_line(arguments, message) -> None:
    error = run_packit("view", *arguments).stderr
    assert message in error and error.count("\n") == 1


def test_a_busy_port_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        ended = run_packit("view", "starter", "--port", port)
    assert ended.returncode == 2
    error = ended.stderr
    assert f"port {port}" in error and "choose another port" in error and error.count("\n") == 1


@pytest.mark.slow
def test_results_are_shown_with_their_tasks(packit, packs, library, tmp_path) -> None:
    path = tmp_path / "results.jsonl"
    write_packs(path, [result(packs[0], library, 0, 5, "a/b/c")])
    assert json.loads(path.read_text())["provenance"]["agent"] == "a/b/c"
    process = packit(str(path), "--dataset", "starter", "--second", "1")
    assert "results.jsonl is shown at" in process.stdout.readline()
