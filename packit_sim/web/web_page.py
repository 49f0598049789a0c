"""A local web page with a 3D scene, by viser: server, light and camera."""

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
from packit_sim.core.extras import needed_for
from packit_sim.render.cameras import ISO, TOP, Camera
from packit_sim.render.defaults import BACKGROUND
from packit_sim.web.origins import EVERYWHERE, LOOPBACK, refused

if TYPE_CHECKING:  # the only module that imports viser: others take its types from here
    import viser
    from viser import GuiApi as GuiApi
    from viser import GuiInputHandle as GuiInputHandle
    from viser import MeshHandle as MeshHandle
    from viser import ViserServer as ViserServer


_ASPECT = 4 / 3
"""Width over height of the smallest window that shows everything at first."""

_NARROW, _HIGH = 480, 560
"""Most pixels of the width, and fewest of the height, of a telephone's window."""

_FREE = 0.4
"""The share of a telephone's window that viser's panel leaves free, above it."""

_PRINTING = threading.Lock()


class WebPage:
    """A web page with an empty scene, z up.

    It loads nothing from other servers and prints nothing: show the user its `address`. Close it; a
    page left open ends with the process.

    Parameters
    ----------
    host : str
        The IPv4 address or name to listen at; by default only this machine can reach it. Everyone
        who can reach it can see the page.
    port : int | None
        1 to 65535, by default a free one.

    Raises
    ------
    RenderError
        If viser is not installed, or the host and the port are not available.
    """

    address: str
    """The page's URL for a browser on this machine."""

    def __init__(self, host: str = LOOPBACK, port: int | None = None) -> None:
        self._server: viser.ViserServer | None = _serve(host, port or 0)
        atexit.register(self.close)
        here = self._server.get_host().replace(EVERYWHERE, LOOPBACK)
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
        """Viser's server. Raises RenderError after `close`."""
        if self._server is None:
            raise RenderError("the viewer is closed")
        return self._server

    def frame(self, points: npt.NDArray[np.float64]) -> None:
        """Move the camera of every browser so that points are in view.

        Parameters
        ----------
        points : ndarray of float64, shape (n, 3)
            The points.

        Notes
        -----
        Each camera keeps its direction. Browsers that connect later look in the direction of
        pictures, and so does one when its window changes shape: the camera that a new browser
        reports may be older than the camera's placement.
        """
        self._points = points
        aim_camera(self.server.initial_camera, points, _ASPECT)
        for client in self.server.get_clients().values():
            known = client.client_id in self._aspects
            view = camera_of(client.camera) if known else ISO
            aim_camera(
                client.camera, points, client.camera.aspect, view, _free_share(client.camera)
            )

    def _follow(self, client: viser.ClientHandle) -> None:
        """Keep the points in view of a browser when its window changes shape.

        A browser that loads slowly may move to the initial camera, of another window, after it was
        aimed, and does so at "Reset View": it is aimed again.
        """
        initial = self.server.initial_camera

        def changed(camera: viser.CameraHandle) -> None:
            if self._points is None or not camera.image_width * camera.image_height > 0:
                return  # of no window
            window = camera.aspect, _free_share(camera)
            is_other = window != (_ASPECT, 1.0) and _is_at(camera, initial)
            if is_other or self._aspects.get(client.client_id) != camera.aspect:
                self._aspects[client.client_id] = camera.aspect
                aim_camera(camera, self._points, camera.aspect, top=_free_share(camera))

        changed(client.camera)
        client.camera.on_update(changed)

    def close(self) -> None:
        """End the page, its server and its threads; calling it again does nothing."""
        server, self._server = self._server, None
        if server is not None:
            atexit.unregister(self.close)
            with _silence():
                server.stop()


def aim_camera(
    camera: viser.InitialCameraConfig | viser.CameraHandle,
    points: npt.NDArray[np.float64],
    aspect: float,
    view: Camera = ISO,
    top: float = 1.0,
) -> None:
    """Point a camera at points, as near as possible, in the direction of a view.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 3)
        The points.
    top : float
        The share of the window's height, from its upper edge on, in which they are.
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    half = math.tan(math.radians(view.fov) / 2)  # of the window's height, at distance 1
    own = replace(view, fov=math.degrees(2 * math.atan(top * half)))
    eye = own.eye(points, aspect / top, middle)
    down = -(1 - top) * half * float(np.linalg.norm(middle - eye)) * view.up
    eye, middle = eye + down, middle + down
    camera.position = eye + view.toward  # viser does not send a position that it believes to be
    camera.position = eye  # current, and a browser's late report can make it wrong: change it twice
    camera.look_at = middle  # after the position, which moves it as well


def _free_share(camera: viser.CameraHandle) -> float:
    """Return the share of a window's height, from its upper edge on, that no panel covers."""
    is_phone = camera.image_width <= _NARROW and camera.image_height >= _HIGH
    return _FREE if is_phone else 1.0


def _is_at(camera: viser.CameraHandle, other: viser.InitialCameraConfig) -> bool:
    is_there = np.allclose(camera.position, other.position)
    return bool(is_there and np.allclose(camera.look_at, other.look_at))


def camera_of(camera: viser.CameraHandle) -> Camera:
    """Return the direction in which a browser looks."""
    x, y, z = camera.position - camera.look_at
    elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
    steep = TOP.elevation
    return replace(
        ISO,
        azimuth=math.degrees(math.atan2(y, x)),
        elevation=min(max(elevation, -steep), steep),
    )


def _serve(host: str, port: int) -> viser.ViserServer:
    """Start a server at exactly this port; 0 stands for a free one."""
    with needed_for("interactive views"):
        import viser
    logging.getLogger("websockets.server").addFilter(_is_no_handshake)
    if not 0 <= port < 2**16:
        raise refused(host, port, "ports are 1 to 65535")
    try:
        with socket.create_server((host, port)) as probe:  # viser would try others, or hang
            address = probe.getsockname()[0]
    except OSError as error:
        raise refused(host, port, error) from error
    from packit_sim.web.connections import guarded

    with _silence():
        with guarded(host, f"viser-v{viser.__version__}") as started:
            server = viser.ViserServer(address, port, label="PackIt-Sim", verbose=False)
        if not started:
            server.stop()
            raise RenderError(
                f"viser {viser.__version__} serves pages in an unknown way: install 1.1"
            )
        if port and server.get_port() != port:
            server.stop()
            raise refused(host, port, "another program has just taken it")
    return server


def _is_no_handshake(record: logging.LogRecord) -> bool:
    """Return False for connections that browsers open in advance and close unused."""
    return record.getMessage() != "opening handshake failed"


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Hide viser's banners, which it prints with rich's global console."""
    console = rich.get_console()
    with _PRINTING:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before


def _dress(server: viser.ViserServer) -> None:
    """Set up all pages alike: light, background, and no share button."""
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
