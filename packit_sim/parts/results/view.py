"""A local, interactive page of one box of packed parts."""

from __future__ import annotations

from packit_sim.geometry.items import BoxState
from packit_sim.geometry.lattice import CELL
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.posed_parts import outline_items
from packit_sim.parts.results.pictures import shown
from packit_sim.web.viewer import Viewer


def view(packed: PackedParts, box: int = 0, port: int | None = None) -> Viewer:
    """Show a box on a local, interactive web page.

    Parameters
    ----------
    box : int
        The number of the box, from 0.
    port : int, optional
        The port; by default a free one.

    Returns
    -------
    Viewer
        The page, with its `address`; close it, or use it in a `with` statement.

    Raises
    ------
    RenderError
        If viser is not installed, or the port is not available.
    """
    contents = packed.contents[box]
    state = shown(contents)
    lines = outline_items(contents, max(state.cells) * CELL)
    return Viewer(BoxState(state.cells, (*state.placed, *lines)), port=port)
