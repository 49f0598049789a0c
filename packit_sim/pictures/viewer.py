"""A box on a local web page, to be turned and looked into, by viser."""

from __future__ import annotations

import atexit
import contextlib
import logging
import math
import socket
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import rich
import trimesh

from packit_sim.errors import RenderError
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.occupancy import Load, Standing
from packit_sim.pictures.cameras import ISO
from packit_sim.pictures.coloring import color_of
from packit_sim.pictures.layouts import Pose
from packit_sim.pictures.looks import BACKGROUND

if TYPE_CHECKING:
    import viser

_LOOPBACK = "127.0.0.1"
_EVERYWHERE = "0.0.0.0"
_EDGE_COLOR = (0.30, 0.32, 0.36)
_FLOOR_COLOR = (0.90, 0.91, 0.93)
_EDGE = 0.004
"""Thickness of the box's edges and of its floor, as a share of its longest side."""

_CREASE = np.radians(35)
"""Edges sharper than this are shown as edges."""

_ASPECT = 4 / 3
"""Width to height of the smallest window in which the whole box is to be seen at first."""

_PRINTING = threading.Lock()


class Viewer:
    """A box and its items on a web page of their own, in box units, z up.

    The page follows each `update`, in every browser that has it open. It asks nothing from outside,
    and nothing is printed: tell the user the `address`. host: the IPv4 address or name to listen
    at; whoever reaches it can look, so it is this machine alone by default. port: 1 to 65535, by
    default a free one. Close it, or use it in a `with`; one left open ends with the process.
    Raises RenderError where viser is not installed, and where host and port can't be had.
    """

    address: str
    """Where a browser on this machine finds the page."""

    def __init__(self, box: Load, *, host: str = _LOOPBACK, port: int | None = None) -> None:
        self._server: viser.ViserServer | None = None
        self._cells: Triple | None = None
        self._items: dict[tuple[int, Standing], viser.MeshHandle] = {}
        self._server = _serve(host, port or 0)
        atexit.register(self.close)
        here = self._server.get_host().replace(_EVERYWHERE, _LOOPBACK)
        self.address = f"http://{here}:{self._server.get_port()}"
        try:
            _dress(self._server)
            self.update(box)
        except BaseException:
            self.close()
            raise

    @property
    def items(self) -> tuple[viser.MeshHandle, ...]:
        """Viser's handle of each item that is shown, in the order of placing."""
        return tuple(self._items[key] for key in sorted(self._items, key=lambda key: key[0]))

    def update(self, box: Load) -> None:
        """Shows the box as it stands; items that stayed are left alone.

        Raises RenderError after `close`.
        """
        if self._server is None:
            raise RenderError("the viewer is closed")
        with self._server.atomic():
            if box.cells != self._cells:
                _show_walls(self._server, box.cells)
                self._cells = box.cells
            placed = list(enumerate(box.placed))
            for key in self._items.keys() - set(placed):
                self._items.pop(key).remove()
            for key in placed:
                if key not in self._items:
                    self._items[key] = _show_item(self._server, *key)

    def close(self) -> None:
        """Ends the page, its server and its threads, and frees the port; once more does nothing."""
        server, self._server = self._server, None
        if server is not None:
            atexit.unregister(self.close)
            self._items.clear()
            with _silence():
                server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


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
    """What is the same for every box: light, background, a small panel, no way to share it."""
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.minimize()
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


def _show_walls(server: viser.ViserServer, cells: Triple) -> None:
    """The box's edges and its floor, and cameras that have it whole in view."""
    size = np.array(cells) * CELL
    thickness = _EDGE * float(size.max())
    corners = np.indices((2, 2, 2)).reshape(3, 8).T
    edges = [(a, b) for a in corners for b in corners if (b - a).sum() == 1 and (a <= b).all()]
    server.scene.add_line_segments(
        "/box/edges", np.array(edges) * size, _EDGE_COLOR, thickness=thickness
    )
    server.scene.add_box(
        "/box/floor",
        _FLOOR_COLOR,
        (size[0], size[1], thickness),
        cast_shadow=False,
        position=(size[0] / 2, size[1] / 2, -thickness),
    )
    cameras: list[viser.InitialCameraConfig | viser.CameraHandle] = [server.initial_camera]
    cameras += [client.camera for client in server.get_clients().values()]
    for camera in cameras:
        camera.position = ISO.eye(corners * size, _ASPECT, size / 2)
        camera.look_at = size / 2  # after the position, which takes it along


def _show_item(server: viser.ViserServer, number: int, placed: Standing) -> viser.MeshHandle:
    shape, pose = placed.item.shape, Pose.lying(placed.item, placed.pose)
    mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
    mesh = trimesh.graph.smooth_shade(mesh, angle=_CREASE, facet_minarea=None)
    return server.scene.add_mesh_simple(
        f"/items/{number}",
        mesh.vertices,
        mesh.faces,
        color=color_of(shape),
        side="double",
        receive_shadow=False,
        scale=float(np.cbrt(placed.item.scale)),
        wxyz=pose.turn,
        position=pose.center,
    )
