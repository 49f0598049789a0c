"""A box on a local web page, to be turned and looked into, that follows as the box fills."""

from __future__ import annotations

from typing import TYPE_CHECKING

from packit_sim.geometry.lattice import Triple
from packit_sim.placement import Contents, ItemInBox
from packit_sim.viewer.box_view import BoxView, corners
from packit_sim.viewer.web_page import LOOPBACK, WebPage

if TYPE_CHECKING:
    import viser


class Viewer:
    """A box and its items on a web page of their own, in box units, z up.

    The page follows each `update`, in every browser that has it open. host, port: where it listens
    (see `WebPage`). Close it, or use it in a `with`; one left open ends with the process. Raises
    RenderError where viser is not installed, and where host and port can't be had.
    """

    address: str
    """Where a browser on this machine finds the page."""

    def __init__(
        self, box: Contents[ItemInBox], *, host: str = LOOPBACK, port: int | None = None
    ) -> None:
        self._page = WebPage(host, port)
        self.address = self._page.address
        self._cells: Triple | None = None
        try:
            self._page.server.gui.main_panel.minimize()
            self._shown = BoxView(self._page.server)
            self.update(box)
        except BaseException:
            self.close()
            raise

    @property
    def items(self) -> tuple[viser.MeshHandle, ...]:
        """Viser's handle of each item that is shown, in the order of placing; none when closed."""
        return self._shown.items if self._page.is_open else ()

    def update(self, box: Contents[ItemInBox]) -> None:
        """Shows the box as it stands; items that stayed are left alone.

        Raises RenderError after `close`.
        """
        server = self._page.server
        with server.atomic():
            self._shown.show(box)
            if box.cells != self._cells:
                self._page.frame(corners(box.cells))
                self._cells = box.cells

    def close(self) -> None:
        """Ends the page, its server and its threads, and frees the port; once more does nothing."""
        self._page.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
