"""The workbench: what its page may ask for, and what it packs."""

import contextlib
import errno
import http.client
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from trimesh import creation

from packit_sim.core.errors import RenderError
from packit_sim.parts.results import exports
from packit_sim.parts.workbench import uploads as uploads_module
from packit_sim.parts.workbench import workbench as workbench_module
from packit_sim.parts.workbench.page_state import volume_text
from packit_sim.parts.workbench.workbench import Workbench
from tests.read_3mf import bodies
from tests.workbench_client import ORDER, ask, is_done, post, send, state, stl, wait


@pytest.fixture(name="bench")
def _bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Workbench]:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    with Workbench() as bench:
        yield bench


def centres(data: bytes, folder: Path) -> dict[str, Any]:
    """The middle of each part in a 3MF file, by its name."""
    (folder / "packing.3mf").write_bytes(data)
    corners = {name: own.reshape(-1, 3) for name, own in bodies(folder / "packing.3mf").items()}
    return {name: (own.min(axis=0) + own.max(axis=0)) / 2 for name, own in corners.items()}


@pytest.mark.slow
def test_parts_are_packed_and_stay_where_they_are_locked(bench, tmp_path) -> None:
    number = send(bench, "folder/cube.stl", creation.box((6, 6, 6)))
    other = send(bench, "cube.stl", creation.box((2, 4, 6)))
    assert [each["name"] for each in state(bench)["files"]] == ["cube.stl", "cube.stl"]
    files = [
        {"number": number, "count": 2, "rotations": "cube"},
        {"number": other, "count": 1, "rotations": "upright"},
    ]
    assert post(bench, "/pack", {**ORDER, "files": files}) == (200, {})
    found = wait(bench, is_done)
    assert sorted(found["result"]["boxes"][0]["parts"]) == ["cube", "cube", "cube-2"]
    assert found["result"]["problems"] == [] and "packing.3mf" in found["result"]["downloads"]
    assert len(found["result"]["models"]["boxes"][0]["items"]) == 3
    status, data = ask(bench, "GET", "/files/packing.3mf")
    before = centres(data, tmp_path)
    assert status == 200 and len(before) == 3
    assert "size" not in state(bench, found["version"])  # nothing new
    assert "result" not in state(bench, found["version"])

    kept = found["result"]["boxes"][0]["parts"].index("cube")
    files[0]["count"] = 3
    order = {**ORDER, "files": files, "seed": 1, "instructions": True}
    assert post(bench, "/lock", {"part": kept, "locked": True}) == (200, {})
    assert post(bench, "/pack", order)[0] == 200
    found = wait(bench, lambda one: is_done(one) and one["locked"])
    assert found["result"]["problems"] == []
    assert sorted(found["result"]["boxes"][0]["parts"]) == ["cube", "cube", "cube", "cube-2"]
    assert "instructions.html" in found["result"]["downloads"]
    assert found["message"].endswith("before, with another order, 3 of 3 parts")
    after = centres(ask(bench, "GET", "/files/packing.3mf")[1], tmp_path)
    name = f"{found['locked'][0] + 1:02d} cube"
    assert np.abs(after[name] - before[f"{kept + 1:02d} cube"]).max() < 1e-3
    with zipfile.ZipFile(io.BytesIO(ask(bench, "GET", "/packing.zip")[1])) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == found["result"]["downloads"]

    for n in range(4):
        post(bench, "/lock", {"part": n, "locked": True})
    assert post(bench, "/pack", order)[0] == 200
    found = wait(bench, is_done)
    assert found["locked"] == [0, 1, 2, 3]
    assert "nothing better was found" in found["message"]


def test_no_worse_packing_replaces_a_better_one_and_locked_parts_count(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    files = [{"number": number, "count": 12, "rotations": "fixed"}]
    order = {
        **ORDER,
        "box": [{"size": "19x19x7"}],
        "clearance": "0",
        "seconds": 0.2,
        "files": files,
    }
    assert post(bench, "/pack", order)[0] == 200
    before = wait(bench, is_done)
    assert len(before["result"]["boxes"][0]["parts"]) == 9
    for part in (0, 4):
        assert post(bench, "/lock", {"part": part, "locked": True})[0] == 200
    assert post(bench, "/lock", {"part": 9, "locked": True})[0] == 400
    send(bench, "other.stl", creation.box((6, 6, 6)))  # locks survive another file,
    assert state(bench)["locked"] == [0, 4]
    post(bench, "/pack", {**order, "box": [{"size": "7x7x7"}]})  # an error,
    failed = wait(bench, lambda one: not one["busy"])
    assert "cube is locked, but it reaches" in failed["message"] and failed["locked"] == [0, 4]
    assert post(bench, "/pack", order)[0] == 200  # and another search
    after = wait(bench, is_done)
    parts = after["result"]["boxes"][0]["parts"]
    assert parts == ["cube"] * 9 and len(after["locked"]) == 2
    assert after["result"]["summary"]["packed"] == "9 of 12 parts"
    for part in after["locked"]:
        assert post(bench, "/lock", {"part": part, "locked": False})[0] == 200
    assert post(bench, "/pack", order)[0] == 200
    assert len(wait(bench, is_done)["result"]["boxes"][0]["parts"]) == 9


def test_results_are_undone_with_their_locks_and_the_order_stays(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    order = {**ORDER, "files": [{"number": number, "count": 1, "rotations": "cube"}]}
    assert post(bench, "/undo", {})[0] == 413 and ask(bench, "POST", "/undo")[0] == 400
    assert post(bench, "/pack", order)[0] == 200
    first = wait(bench, is_done)
    assert (first["undo"], first["redo"]) == (False, False)
    assert post(bench, "/lock", {"part": 0, "locked": True})[0] == 200
    more = {**order, "files": [{**order["files"][0], "count": 2}]}
    assert post(bench, "/pack", more)[0] == 200
    second = wait(bench, lambda one: is_done(one) and one["undo"])
    assert len(second["result"]["boxes"][0]["parts"]) == 2
    assert (
        second["order"]["files"][0]["count"] == 2
        and second["order"]["box"][0]["size"] == "20x10x15"
    )

    assert ask(bench, "POST", "/undo")[0] == 200
    undone = state(bench)
    assert undone["result"]["boxes"][0]["parts"] == ["cube"] and undone["locked"] == [0]
    assert undone["result"]["downloads"] == [] and undone["redo"]
    assert ask(bench, "GET", "/packing.zip")[0] == 404
    assert len(list(bench.folder.glob("packing-*"))) == 0
    assert post(bench, "/write", {})[0] == 200
    assert wait(bench, is_done)["message"] == "done: the files are written"
    assert ask(bench, "POST", "/redo")[0] == 200
    assert len(state(bench)["result"]["boxes"][0]["parts"]) == 2
    assert post(bench, "/order", {**more, "box": [{"size": "1x2x3"}]})[0] == 200
    assert state(bench)["order"]["box"][0]["size"] == "1x2x3"


def test_an_order_is_shown_before_it_is_packed(bench) -> None:
    number = send(bench, "rod.stl", creation.box((6, 2, 2)))
    order = {**ORDER, "files": [{"number": number, "count": 9, "rotations": "cube"}]}
    status, found = post(bench, "/order", order)
    assert status == 200 and found["boxes"][0]["parts"] == ["rod"] * 9
    side = found["models"]["boxes"][0]["size"][0] / 20  # of a millimetre
    places = np.array([one["pose"] for one in found["models"]["boxes"][0]["items"]])[:, 3::4] / side
    low, high = (places + sign * np.array((3, 1, 1)) for sign in (-1, 1))
    assert low.min() > -1e-6 and low[:, 1].min() > 10  # next to the box
    assert (high <= np.array(found["reach"]) / side + 1e-6).all()
    apart = np.maximum(low[:, None], low) - np.minimum(high[:, None], high)
    assert (apart.max(axis=2)[np.triu_indices(9, 1)] > 0).all()
    many = [{**order["files"][0], "count": 10_000}]
    assert len(post(bench, "/order", {**order, "files": many})[1]["boxes"][0]["parts"]) == 100
    faults = post(bench, "/order", {**order, "box": [{"size": "0x1x1"}]})[1]["faults"]
    assert "is not possible" in faults["box"]


def test_volumes_are_as_people_write_them() -> None:
    assert volume_text(1_090_710.4, "mm") == "1,090,710 mm³ (1.09 l)"
    assert volume_text(24.94, "in") == "24.94 in³ (0.409 l)"
    assert volume_text(8.0, "mm") == "8 mm³"


def test_the_unit_of_a_file_can_be_changed(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    assert post(bench, "/unit", {"number": number, "unit": "in"}) == (200, {})
    (file,) = state(bench)["files"]
    assert (file["unit"], file["size"], file["own unit"]) == ("in", "6 x 6 x 6 in", False)
    files = [{"number": number, "count": 1, "rotations": "cube"}]
    assert (
        post(bench, "/pack", {**ORDER, "box": [{"size": "160x160x160"}], "files": files})[0] == 200
    )
    assert wait(bench, is_done)["result"]["summary"]["height"].startswith("152")
    assert post(bench, "/unit", {"number": number, "unit": "ell"})[0] == 400
    assert post(bench, "/unit", {"number": 99, "unit": "mm"})[0] == 400


def test_a_search_can_be_ended_and_only_one_runs(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    order = {
        **ORDER,
        "seconds": 3600,
        "files": [{"number": number, "count": 90, "rotations": "cube"}],
    }
    assert post(bench, "/pack", order)[0] == 200
    wait(bench, lambda one: one["busy"] and "result" in one)
    status, answer = post(bench, "/pack", order)
    assert status == 409 and "stop it first" in answer["error"]
    assert ask(bench, "POST", "/stop")[0] == 200
    found = wait(bench, is_done)
    assert "no space was found" in found["result"]["left out"][0]


def test_an_order_that_is_not_possible_gets_one_sentence(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    files = [{"number": number, "count": 1, "rotations": "cube"}]
    for change, sentence in (
        ({"box": [{"size": "0x10x15"}]}, "0"),
        ({"box": [{"size": "nonsense"}]}, "nonsense"),
        ({"box": [{"size": "5x5x5"}]}, "larger than the box"),
        ({"box": [{"size": "A:/somewhere/trunk.stl"}]}, "is a file of this machine: send it"),
        ({"unit": "ell"}, "unit 'ell' is not known"),
        ({"clearance": "-1"}, "clearance"),
        ({"files": []}, "there are no parts"),
        ({"files": [{**files[0], "number": 7}]}, "there is no file 7"),
        ({"files": [{**files[0], "rotations": "none"}]}, "none"),
        ({"seconds": 0}, "seconds"),
        ({"more": 1}, "more"),
    ):
        status, answer = post(bench, "/pack", {**ORDER, "files": files, **change})
        found = answer.get("error") or wait(bench, lambda one: not one["busy"])["message"]
        assert sentence in found and status in (200, 400), (change, found)
    assert post(bench, "/remove", {"number": number}) == (200, {})
    assert post(bench, "/remove", {"number": number})[0] == 400
    assert state(bench)["files"] == []


def test_files_that_can_not_be_packed_are_refused_and_not_kept(bench, monkeypatch) -> None:
    monkeypatch.setattr(uploads_module, "MAX_BYTES_TOGETHER", 1000)
    for name, data, sentence in (
        ("bad.stl", b"solid", "bad.stl"),
        ("notes.txt", b"", "choose a mesh file"),
        ("..", b"", "choose a mesh file"),
        ("large.stl", stl(creation.icosphere()), "too large"),
    ):
        status, answer = ask(bench, "POST", f"/parts?name={quote(name)}", data)
        assert status == 422 and sentence in json.loads(answer)["error"]
        assert "packit-workbench" not in answer.decode()
    assert state(bench)["files"] == []
    assert not list((bench.folder / "parts").glob("*"))


@pytest.mark.parametrize("limit", ["MAX_FILES", "MAX_BYTES_TOGETHER"])
def test_limits_hold_for_files_that_are_sent_at_once(bench, monkeypatch, limit) -> None:
    data = stl(creation.box((6, 6, 6)))
    monkeypatch.setattr(uploads_module, limit, 3 if limit == "MAX_FILES" else 3 * len(data))
    senders = [_Sender(bench, data, number) for number in range(12)]
    answers = [sender.finish() for sender in senders]
    assert sorted(answers) == [200] * 3 + [422] * 9
    names = [each["name"] for each in state(bench)["files"]]
    assert len(names) == 3 and len(list((bench.folder / "parts").iterdir())) == 3
    assert post(bench, "/remove", {"number": state(bench)["files"][0]["number"]})[0] == 200
    send(bench, "again.stl", creation.box((6, 6, 6)))


class _Sender:
    """Sends a file in two pieces, so that all requests are open at a time."""

    def __init__(self, bench: Workbench, data: bytes, number: int) -> None:
        host = bench.address.removeprefix("http://")
        self._rest = data[80:]
        self._connection = http.client.HTTPConnection(host, timeout=60)
        self._connection.putrequest("POST", f"/parts?name=cube{number}.stl")
        self._connection.putheader("Content-Length", str(len(data)))
        self._connection.endheaders(data[:80])

    def finish(self) -> int:
        with contextlib.suppress(ConnectionError):
            self._connection.send(self._rest)
        answer = self._connection.getresponse()
        answer.read()
        self._connection.close()
        return answer.status


def test_files_with_one_name_that_are_sent_at_once_are_parts_with_different_names(bench) -> None:
    data = stl(creation.box((6, 6, 6)))
    threads = [
        threading.Thread(target=ask, args=(bench, "POST", "/parts?name=a.stl", data))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    numbers = [each["number"] for each in state(bench)["files"]]
    files = [{"number": number, "count": 1, "rotations": "cube"} for number in numbers]
    assert post(bench, "/pack", {**ORDER, "box": [{"size": "60x60x60"}], "files": files})[0] == 200
    found = wait(bench, is_done)
    assert len(set(found["result"]["boxes"][0]["parts"])) == 8


def test_a_file_that_arrives_while_the_page_asks_is_in_its_next_state(bench, monkeypatch) -> None:
    sizes, arriving = workbench_module.lengths_text, ["plate.stl"]

    def slow_sizes(lengths: Any) -> str:
        if arriving:
            send(bench, arriving.pop(), creation.box((9, 6, 1)))
        return sizes(lengths)

    send(bench, "cube.stl", creation.box((6, 6, 6)))
    monkeypatch.setattr(workbench_module, "lengths_text", slow_sizes)
    first = state(bench)
    assert not arriving
    names = [each["name"] for each in (first | state(bench, first["version"]))["files"]]
    assert names == ["cube.stl", "plate.stl"]


def test_files_that_are_removed_during_a_search_stay_until_it_ends(bench, monkeypatch) -> None:
    monkeypatch.setattr(uploads_module, "MAX_FILES", 1)
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    files = [{"number": number, "count": 90, "rotations": "cube"}]
    assert post(bench, "/pack", {**ORDER, "seconds": 3600, "files": files})[0] == 200
    wait(bench, lambda one: one["busy"] and "result" in one)
    assert post(bench, "/remove", {"number": number}) == (200, {})
    assert state(bench)["files"] == [] and list(bench.folder.rglob("cube.stl"))
    status, data = ask(bench, "POST", "/parts?name=b.stl", stl(creation.box((6, 6, 6))))
    assert status == 422 and "1 files already" in data.decode()
    assert ask(bench, "POST", "/stop")[0] == 200
    found = wait(bench, is_done)
    assert found["message"].startswith("done in") and found["result"]["problems"] == []
    assert ask(bench, "GET", "/files/packing.3mf")[0] == 200
    assert not list((bench.folder / "parts").iterdir())
    send(bench, "b.stl", creation.box((6, 6, 6)))


def test_an_earlier_result_stays_when_a_later_search_fails(bench, monkeypatch, caplog) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    files = [{"number": number, "count": 2, "rotations": "cube"}]
    assert post(bench, "/pack", {**ORDER, "files": files})[0] == 200
    found = wait(bench, is_done)["result"]
    data = ask(bench, "GET", "/files/packing.3mf")
    full = "error: out/packing.3mf: No space left on device"
    for change, sentence in (
        ({"box": [{"size": "5x5x5"}]}, "larger than the box"),
        ({"seconds": 0.5}, full),
    ):
        if sentence == full:
            monkeypatch.setattr(workbench_module, "export", _full)
        post(bench, "/pack", {**ORDER, "files": files, **change})
        after = wait(bench, lambda one: not one["busy"])
        assert sentence in after["message"] and after["result"] == found
        assert ask(bench, "GET", "/files/packing.3mf") == data
    assert not [each for each in caplog.records if each.levelname in ("WARNING", "ERROR")]
    assert post(bench, "/lock", {"part": 0, "locked": True})[0] == 200


def _full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device", "out/packing.3mf")


def test_a_full_disk_refuses_a_file_with_one_sentence(bench, monkeypatch) -> None:
    shutil.rmtree(bench.folder / "parts")
    (bench.folder / "parts").symlink_to("/dev/full")
    status, data = ask(bench, "POST", "/parts?name=a.stl", stl(creation.box((6, 6, 6))))
    assert status == 422 and "a.stl: it can't be kept: " in data.decode()


def test_folders_that_killed_workbenches_left_are_removed(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    others = [tmp_path / "packit-workbench-abc", tmp_path / "packit-workbench-abcdefgh-mine"]
    left = tmp_path / "packit-workbench-abcdefgh"
    for folder in (left, *others):
        (folder / "parts").mkdir(parents=True)
    target = tmp_path / "mine"
    target.mkdir()
    link = tmp_path / "packit-workbench-abcdefg0"
    link.symlink_to(target)
    with Workbench() as one:
        assert not left.exists() and all(each.exists() for each in (*others, target, link))
        with Workbench() as two:
            assert one.folder.exists() and two.folder.exists()
    assert not one.folder.exists()


def test_only_requests_of_the_page_are_answered(bench) -> None:
    own = bench.address.removeprefix("http://")
    assert ask(bench, "GET", "/")[0] == 200
    assert ask(bench, "GET", "/state", Origin=bench.address)[0] == 200
    assert ask(bench, "GET", "/state", Host="evil.example")[0] == 403
    assert ask(bench, "POST", "/stop", Origin="http://evil.example")[0] == 403
    assert ask(bench, "POST", "/stop", Origin=f"http://{own}0")[0] == 403
    for method, path, status in (
        ("GET", "/nothing", 404),
        ("GET", "/files/../page.js", 404),
        ("GET", "/files/%2e%2e%2fparts", 404),
        ("GET", "/pack", 404),
        ("DELETE", "/state", 501),
    ):
        assert ask(bench, method, path)[0] == status, path
    assert ask(bench, "POST", "/pack", b"{}", **{"Content-Length": "9" * 9})[0] == 413
    assert ask(bench, "POST", "/pack", b"{}", **{"Content-Length": "-1"})[0] == 400
    assert ask(bench, "POST", "/pack", b"[" * 100_000)[0] == 400


@pytest.mark.slow
def test_the_command_serves_the_page_until_ctrl_c() -> None:
    command = [sys.executable, "-u", "-m", "packit_sim", "workbench", "--no-browser"]
    environment = {**os.environ, "COLUMNS": "400"}
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment, text=True, stdout=pipe, stderr=pipe) as process:
        assert process.stdout is not None
        address = process.stdout.readline().split()[5]
        connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=60)
        connection.request("GET", "/")
        assert b"<title>Pack your own parts</title>" in connection.getresponse().read()
        connection.close()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert (process.returncode, out.splitlines()[-1], err) == (0, "the workbench is closed", "")


def test_a_search_ends_when_the_page_is_closed() -> None:
    bench = Workbench()
    closing = threading.Thread(target=bench.close, daemon=True)
    try:
        number = send(bench, "cube.stl", creation.box((6, 6, 6)))
        file = {"number": number, "count": 90, "rotations": "cube"}
        assert post(bench, "/pack", {**ORDER, "seconds": 3600, "files": [file]})[0] == 200
        wait(bench, lambda one: one["busy"] and "result" in one)
        closing.start()
        closing.join(30)
        assert not closing.is_alive() and not bench.folder.exists()
    finally:
        bench._stop.set()
        bench.close()


def test_nothing_stays_when_it_is_closed() -> None:
    with Workbench() as bench:
        send(bench, "cube.stl", creation.box((6, 6, 6)))
        folder = bench.folder
        assert list(folder.rglob("cube.stl"))
    assert not folder.exists()
    bench.close()
    with pytest.raises(RenderError, match="port 99999"):
        Workbench(port=99999)
