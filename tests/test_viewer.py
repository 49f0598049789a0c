"""The viewer with a fake browser: what it shows, its address, and its clean-up."""

from __future__ import annotations

import importlib.util
import logging
import math
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import numpy as np
import pytest
from msgspec.msgpack import encode

from packit_sim.box import Box
from packit_sim.core.errors import PackItError, RenderError
from packit_sim.geometry.shapes import Item
from packit_sim.web.viewer import Viewer
from tests.zoo import BALL, BOWL, CUBE, RING, ZOO, cube_of

viser = pytest.importorskip("viser")
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import ClientConnection, connect  # noqa: E402

from packit_sim.web import connections  # noqa: E402
from packit_sim.web.origins import is_own_page  # noqa: E402

CAMERA = (
    *("wxyz", "position", "fov", "near", "far"),
    *("image_height", "image_width", "look_at", "up_direction"),
)
"""Fields of the message in which a browser reports its camera."""

BYTES = 4
"""Of a coordinate on its way to a browser."""

LEFT_OPEN = """
from packit_sim.box import Box
from packit_sim.web.viewer import Viewer
print(Viewer(Box()).address)
"""


def three_items() -> Box:
    box = Box()
    box.place(cube_of(30), (0, 0, 0))
    box.place(Item(BALL, 0.1), (10, 12, 0))
    box.place(Item(RING, 0.1, 4), (0, 10, 12))
    return box


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with Viewer(three_items()) as viewer:
        yield viewer


def status(address: str) -> int:
    with urllib.request.urlopen(address, timeout=5) as answer:
        return answer.status


def port_of(viewer: Viewer) -> int:
    return int(viewer.address.rpartition(":")[2])


def browser(viewer: Viewer) -> ClientConnection:
    """What a browser keeps open while it shows the page."""
    address = viewer.address.replace("http", "ws")
    return connect(address, subprotocols=[f"viser-v{viser.__version__}"], compression=None)


def opened_by(viewer: Viewer, origin: str | None, host: str | None = None) -> bool:
    """Whether the page of an origin can open a connection and read from it."""
    port = port_of(viewer)
    headers = {} if host is None else {"Host": host.format(port=port)}
    try:
        with connect(
            viewer.address.replace("http", "ws"),
            origin=None if origin is None else origin.format(port=port),
            additional_headers=headers,
            subprotocols=[f"viser-v{viser.__version__}"],
            compression=None,
        ) as page:
            return len(page.recv(timeout=5)) > 0
    except InvalidStatus:
        return False


def receive(page: ClientConnection, size: int) -> None:
    """Waits for so many bytes. Raises TimeoutError where nothing comes for five seconds."""
    while size > 0:
        size -= len(page.recv(timeout=5))


def poses(viewer: Viewer) -> list[np.ndarray]:
    """(4, 4) of each handle: what viser makes of its position, turn and scale."""
    matrices = []
    for handle in viewer.items:
        matrix = np.eye(4)
        matrix[:3, :3] = viser.transforms.SO3(handle.wxyz).as_matrix() * handle.scale
        matrix[:3, 3] = handle.position
        matrices.append(matrix)
    return matrices


def test_the_page_answers_at_its_address(viewer: Viewer) -> None:
    assert viewer.address.startswith("http://127.0.0.1:")
    assert status(viewer.address) == 200


def test_the_page_follows_the_scheme_of_the_system(viewer: Viewer) -> None:
    request = urllib.request.Request(viewer.address, headers={"Accept-Encoding": "gzip"})
    with urllib.request.urlopen(request, timeout=5) as answer:
        page = answer.read()
    assert 0 < page.index(b"prefers-color-scheme: dark") < page.index(b"<title>Viser</title>")
    assert page.rstrip().endswith(b"</html>")
    with pytest.raises(urllib.error.HTTPError, match="404"):
        status(f"{viewer.address}/nothing.js")


def test_items_stand_where_they_are_placed() -> None:
    for rotation in range(24):
        box = Box()
        box.place(Item(BOWL, 0.05, rotation), (rotation % 5, 3, 7))
        box.place(Item(CUBE, 0.02, rotation), (0, 15, rotation % 3))
        with Viewer(box) as viewer:
            assert np.allclose(poses(viewer), [placed.matrix for placed in box.placed], atol=1e-6)


def test_every_triangle_is_shown() -> None:
    for shape in ZOO:
        box = Box()
        box.place(Item(shape, 0.02), (0, 0, 0))
        with Viewer(box) as viewer:
            (handle,) = viewer.items
            shown = handle.vertices[handle.faces].reshape(-1, 9)
        ours = shape.mesh.triangles.reshape(-1, 9)
        assert np.allclose(np.sort(shown, axis=None), np.sort(ours, axis=None), atol=1e-6)
        assert len(shown) == len(ours)


def test_update_changes_only_what_changed(viewer: Viewer) -> None:
    box = three_items()
    cube, ball, ring = viewer.items
    box.undo()
    box.place(Item(BOWL, 0.1), (15, 0, 0))
    box.place(Item(RING, 0.05, 9), (0, 10, 15))
    viewer.update(box)
    assert viewer.items[0] is cube and viewer.items[1] is ball
    assert viewer.items[2] is not ring
    assert len(viewer.items) == 4
    assert np.allclose(poses(viewer), [placed.matrix for placed in box.placed], atol=1e-6)
    viewer.update(Box())
    assert viewer.items == ()


def test_another_box_has_another_frame(viewer: Viewer) -> None:
    viewer.update(Box((200, 40, 80)))
    scene = viewer.page.server.scene
    assert scene.get_handle_by_name("/box/edges").points.max(axis=(0, 1)).tolist() == pytest.approx(
        [2.0, 0.4, 0.8]
    )
    assert scene.get_handle_by_name("/box/floor").dimensions[:2] == pytest.approx((2.0, 0.4))
    assert viewer.items == ()


def test_updates_reach_a_browser(viewer: Viewer) -> None:
    with browser(viewer) as page:
        receive(page, BALL.mesh.vertices.size * BYTES)
        box = three_items()
        box.place(Item(BOWL, 0.1), (15, 0, 0))
        viewer.update(box)
        receive(page, BOWL.mesh.vertices.size * BYTES)


def test_two_viewers_have_an_address_each(viewer: Viewer) -> None:
    with Viewer(Box()) as other:
        assert other.address != viewer.address
        assert (len(viewer.items), len(other.items)) == (3, 0)
        assert status(viewer.address) == status(other.address) == 200
    assert status(viewer.address) == 200


def test_a_port_that_is_taken_is_refused(viewer: Viewer) -> None:
    with pytest.raises(RenderError, match=f"port {port_of(viewer)}.*in use.*choose another"):
        Viewer(Box(), port=port_of(viewer))


def test_a_port_that_is_lost_at_the_last_moment_is_refused(
    viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = port_of(viewer)
    free = socket.create_server
    monkeypatch.setattr(socket, "create_server", lambda address: free((address[0], 0)))
    before = threading.active_count()
    with pytest.raises(RenderError, match=f"port {port}"):
        Viewer(Box(), port=port)
    assert threading.active_count() == before


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 70_000), ("host.invalid", None)])
def test_an_address_that_is_none_is_refused(host, port) -> None:
    with pytest.raises(RenderError, match=host):
        Viewer(Box(), host=host, port=port)


def test_a_port_is_free_again_after_close() -> None:
    with Viewer(Box()) as viewer:
        status(viewer.address)
    with Viewer(Box(), port=port_of(viewer)) as again:
        assert again.address == viewer.address


def test_a_host_by_name_is_listened_at() -> None:
    with Viewer(Box(), host="localhost") as viewer:
        assert status(viewer.address) == 200


def test_closing_leaves_no_thread_and_no_descriptor() -> None:
    def left() -> tuple[int, int]:
        return threading.active_count(), len(os.listdir("/proc/self/fd"))

    def open_and_close() -> None:
        with Viewer(three_items()) as viewer, browser(viewer) as page:
            status(viewer.address)
            page.recv(timeout=5)

    open_and_close()
    before = left()
    for _ in range(5):
        open_and_close()
    deadline = time.monotonic() + 5
    while left() > before and time.monotonic() < deadline:
        time.sleep(0.05)
    threads, descriptors = left()
    assert threads <= before[0] and descriptors <= before[1]


def test_a_browser_does_not_keep_it_from_closing() -> None:
    viewer = Viewer(Box())
    with browser(viewer) as page:
        page.recv(timeout=5)
        start = time.monotonic()
        viewer.close()
        assert time.monotonic() - start < 2


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with Viewer(three_items()) as viewer, browser(viewer) as page:
        page.recv(timeout=5)
    assert capfd.readouterr() == ("", "")


def test_a_connection_without_a_word_is_not_reported(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(logging.getLogger("websockets.server"), "filters", [])
    with Viewer(Box()) as viewer:
        socket.create_connection(("127.0.0.1", port_of(viewer))).close()
        time.sleep(0.2)
    assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == []


@pytest.mark.slow
def test_one_left_open_ends_quietly_with_the_process() -> None:
    run = subprocess.run([sys.executable, "-c", LEFT_OPEN], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("http://127.0.0.1:") and run.stdout.count("\n") == 1


def test_a_closed_viewer_says_so(viewer: Viewer) -> None:
    viewer.close()
    viewer.close()
    assert viewer.items == ()
    with pytest.raises(RuntimeError, match="closed"):
        viewer.update(Box())


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    spec = importlib.util.find_spec("packit_sim.web.viewer")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.raises(PackItError, match=r"packit-sim\[view\]"):
        module.Viewer(Box())


@pytest.mark.parametrize(
    ("origin", "own"),
    [
        (None, True),
        ("http://127.0.0.1:{port}", True),
        ("http://evil.example", False),
        ("http://evil.example:{port}", False),
        ("http://127.0.0.1:1", False),
        ("http://localhost:{port}", False),
        ("null", False),
        ("file://", False),
        ("http://[", False),
    ],
)
def test_only_the_servers_own_page_can_open_a_connection(viewer, origin, own) -> None:
    assert opened_by(viewer, origin) == own
    assert opened_by(viewer, viewer.address)


@pytest.mark.parametrize(
    ("origin", "host", "own"),
    [
        ("http://localhost:9000", "localhost:9000", True),  # through ssh
        ("http://LOCALHOST:9000", "localhost:9000", True),
        ("http://[::1]:80", "[::1]:80", True),
        ("http://192.168.1.5:8080", "192.168.1.5:8080", True),
        ("https://box.example", "box.example", True),
        ("http://evil.example:8080", "evil.example:8080", False),  # a name that points here
        ("http://localhost.evil.example", "localhost.evil.example", False),
        ("http://127.0.0.1:8080", "evil.example:8080", False),
        ("ftp://127.0.0.1", "127.0.0.1", False),
        ("", "", False),
    ],
)
def test_an_origin_is_the_host_and_a_name_of_this_machine(origin, host, own) -> None:
    assert is_own_page([origin], [host], "box.example") == own
    assert not is_own_page([origin, origin], [host], "box.example")


def test_clients_are_limited(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MAX_CONNECTIONS", 2)
    with browser(viewer), browser(viewer):
        assert not opened_by(viewer, None)
    deadline = time.monotonic() + 5
    while not opened_by(viewer, None):
        assert time.monotonic() < deadline


MALFORMED = {
    "nothing": b"",
    "text": "text",
    "another encoding": b"\xff\xff",
    "a number": encode(5),
    "no type": encode({}),
    "an unknown type": encode({"type": "Nope"}),
    "a type without fields": encode({"type": "ViewerCameraMessage"}),
    "deep": b"\x91" * 100_000,
    "a camera of texts": encode({"type": "ViewerCameraMessage", **dict.fromkeys(CAMERA, "x")}),
    "a camera of nothing": encode(
        {"type": "ViewerCameraMessage"}
        | {name: [math.nan] * 4 if name == "wxyz" else [math.nan] * 3 for name in CAMERA}
        | dict.fromkeys(("fov", "near", "far", "image_height", "image_width"), 0)
    ),
    "an unknown control": encode({"type": "GuiUpdateMessage", "uuid": "x", "updates": {"a": 5}}),
    "updates of no control": encode({"type": "GuiUpdateMessage", "uuid": "x", "updates": 5}),
}


def test_malformed_messages_print_no_traceback(viewer, capfd, caplog) -> None:
    for name, message in MALFORMED.items():
        with browser(viewer) as page:
            page.send(message)
            try:
                for _ in range(3):
                    page.recv(timeout=0.3)
            except (ConnectionClosed, TimeoutError):
                pass
        assert status(viewer.address) == 200, name
    with pytest.raises(ConnectionClosed), connect(viewer.address.replace("http", "ws")) as page:
        page.recv(timeout=5)
    assert opened_by(viewer, viewer.address)
    output = "".join(capfd.readouterr())
    assert "Traceback" not in output + caplog.text and "mismatch" not in output
    assert "closed a connection after a malformed message: KeyError('Nope')" in caplog.text
