"""A local web page with a 3D scene, by viser: where it listens, its light, and how it ends."""

from __future__ import annotations

import atexit
import contextlib
import logging
import math
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import rich

from packit_sim.core.errors import RenderError
from packit_sim.render.cameras import ISO, TOP, Camera
from packit_sim.render.looks import BACKGROUND

if TYPE_CHECKING:
    import viser

LOOPBACK = "127.0.0.1"
_EVERYWHERE = "0.0.0.0"

_ASPECT = 4 / 3
"""Width to height of the smallest window in which all is to be seen at first."""

_PRINTING = threading.Lock()


class WebPage:
    """An empty scene on a web page of its own, z up.

    It asks nothing from outside, and nothing is printed: tell the user the `address`. host: the
    IPv4 address or name to listen at; whoever reaches it can look, so it is this machine alone by
    default. port: 1 to 65535, by default a free one. Close it; one left open ends with the process.
    Raises RenderError where viser is not installed, and where host and port can't be had.
    """

    address: str
    """Where a browser on this machine finds the page."""

    def __init__(self, host: str = LOOPBACK, port: int | None = None) -> None:
        self._server: viser.ViserServer | None = _serve(host, port or 0)
        atexit.register(self.close)
        here = self._server.get_host().replace(_EVERYWHERE, LOOPBACK)
        self._points: npt.NDArray[np.float64] | None = None
        self._aspects: dict[int, float] = {}
        self.address = f"http://{here}:{self._server.get_port()}"
        try:
            _dress(self._server)
            self._server.on_client_connect(self._follow)
        except BaseException:
            self.close()
            raise

    @property
    def is_open(self) -> bool:
        return self._server is not None

    @property
    def server(self) -> viser.ViserServer:
        """Viser's own. Raises RenderError after `close`."""
        if self._server is None:
            raise RenderError("the viewer is closed")
        return self._server

    def frame(self, points: npt.NDArray[np.float64]) -> None:
        """Has points (n, 3) in view in every browser, from the side that it looks from.

        Those that come later look from where pictures are taken, and so does each where its window
        gets another shape: what a new browser says of its camera may be of before it was placed.
        """
        self._points = points
        _look(self.server.initial_camera, points, _ASPECT)
        for client in self.server.get_clients().values():
            known = client.client_id in self._aspects
            view = _view(client.camera) if known else ISO
            _look(client.camera, points, client.camera.aspect, view)

    def _follow(self, client: viser.ClientHandle) -> None:
        """Keeps all in view of a browser whose window, or what a panel leaves of it, changes."""

        def changed(camera: viser.CameraHandle) -> None:
            aspect = camera.aspect
            if self._points is not None and self._aspects.get(client.client_id) != aspect:
                self._aspects[client.client_id] = aspect
                _look(camera, self._points, aspect)

        changed(client.camera)
        client.camera.on_update(changed)

    def close(self) -> None:
        """Ends the page, its server and its threads, and frees the port; once more does nothing."""
        server, self._server = self._server, None
        if server is not None:
            atexit.unregister(self.close)
            with _silence():
                server.stop()


def _look(
    camera: viser.InitialCameraConfig | viser.CameraHandle,
    points: npt.NDArray[np.float64],
    aspect: float,
    view: Camera = ISO,
) -> None:
    """Turns a camera to points (n, 3), from as near as has them whole on the side of a view."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    eye = view.eye(points, aspect, middle)
    camera.position = eye + view.toward  # viser keeps to itself what it takes for known, and a
    camera.position = eye  # browser's word on its way may be of before: twice is sent for certain
    camera.look_at = middle  # after the position, which takes it along


def _view(camera: viser.CameraHandle) -> Camera:
    """From which side a browser looks."""
    x, y, z = camera.position - camera.look_at
    elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
    steep = TOP.elevation
    return replace(
        ISO,
        azimuth=math.degrees(math.atan2(y, x)),
        elevation=min(max(elevation, -steep), steep),
    )


def _serve(host: str, port: int) -> viser.ViserServer:
    """A server at that port and no other; 0 stands for a free one."""
    try:
        import viser
    except ImportError as error:
        raise RenderError(
            "the viewer needs viser, which is not installed: pip install 'packit-sim[viewer]'"
        ) from error
    logging.getLogger("websockets.server").addFilter(_is_no_handshake)
    if not 0 <= port < 2**16:
        raise _refused(host, port, "ports are 1 to 65535")
    try:
        with socket.create_server((host, port)) as probe:  # viser would search, or wait for ever
            address = probe.getsockname()[0]
    except OSError as error:
        raise _refused(host, port, str(error)) from error
    with _silence():
        server = viser.ViserServer(address, port, label="PackIt-Sim", verbose=False)
        if port and server.get_port() != port:
            server.stop()
            raise _refused(host, port, "it was taken this moment")
    return server


def _refused(host: str, port: int, reason: str) -> RenderError:
    return RenderError(
        f"the viewer can't listen at host {host!r}, port {port}: {reason}; "
        f"choose another port, or none to get a free one, and a host of this machine's"
    )


def _is_no_handshake(record: logging.LogRecord) -> bool:
    """False for what browsers do all the time: connect in advance, and leave without a word."""
    return record.getMessage() != "opening handshake failed"


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keeps viser's banners, which it prints by rich's global console, off the terminal."""
    console = rich.get_console()
    with _PRINTING:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before


def _dress(server: viser.ViserServer) -> None:
    """What is the same for every page: light, background, no way to share it."""
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.initial_camera.fov = math.radians(ISO.fov)
    server.scene.set_background_image(np.full((1, 1, 3), BACKGROUND, dtype=np.uint8), "png")
    server.scene.configure_default_lights(False)
    server.scene.configure_environment_map(None)
    server.scene.add_light_hemisphere(
        "/light/sky", ground_color=(150, 150, 160), intensity=2.0, position=(0.0, 0.0, 1.0)
    )
    server.scene.add_light_directional(
        "/light/sun", intensity=2.0, position=(2.0, 6.0, 9.0), cast_shadow=True
    )
    server.scene.add_light_directional(
        "/light/side", intensity=0.8, position=(8.0, 1.0, 3.0), cast_shadow=False
    )
