"""A box on a local, interactive web page that follows as the box fills."""

from __future__ import annotations

from typing import TYPE_CHECKING

from packit_sim.geometry.items import Contents, ItemInBox
from packit_sim.geometry.lattice import Triple
from packit_sim.web.box_view import BoxView, corners
from packit_sim.web.origins import LOOPBACK
from packit_sim.web.web_page import WebPage

if TYPE_CHECKING:
    from packit_sim.web.web_page import MeshHandle


class Viewer:
    """A web page with a box and its items, in box units, z up.

    Each `update` appears in every browser that shows the page. Close it, or use it in a `with`
    statement; a page left open ends with the process.

    Parameters
    ----------
    host : str
        The address at which the page is served, see `WebPage`.
    port : int | None
        The same.

    Raises
    ------
    RenderError
        If viser is not installed, or the host and the port are not available.
    """

    address: str
    """The page's URL for a browser on this machine."""

    def __init__(
        self, box: Contents[ItemInBox], *, host: str = LOOPBACK, port: int | None = None
    ) -> None:
        self.page = WebPage(host, port)
        self.address = self.page.address
        self._cells: Triple | None = None
        try:
            self.page.server.gui.main_panel.minimize()
            self._shown = BoxView(self.page.server)
            self.update(box)
        except BaseException:
            self.close()
            raise

    @property
    def items(self) -> tuple[MeshHandle, ...]:
        """Viser's handle of each item in the order of placing; empty after `close`."""
        return self._shown.items if self.page.is_open else ()

    def update(self, box: Contents[ItemInBox]) -> None:
        """Show the box as it is now; raise RenderError after `close`."""
        server = self.page.server
        with server.atomic():
            self._shown.show(box)
            if box.cells != self._cells:
                self.page.frame(corners(box.cells))
                self._cells = box.cells

    def close(self) -> None:
        """End the page, its server and its threads; calling it again does nothing."""
        self.page.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
