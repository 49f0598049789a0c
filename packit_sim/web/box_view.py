"""A box and its items in the scene of a web page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import Contents, ItemInBox, PlacedItem
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.motions import IDENTITY, Motion
from packit_sim.render.coloring import Color, by_item
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import Cut
from packit_sim.render.sections import BRIGHTNESS, is_beyond, section
from packit_sim.web.surfaces import surface

if TYPE_CHECKING:
    from packit_sim.web.web_page import MeshHandle, ViserServer


EDGE_COLOR = (0.30, 0.32, 0.36)
_FLOOR_COLOR = (0.90, 0.91, 0.93)
_EDGE = 0.004
"""Thickness of the box's edges and of its floor, as a share of its longest side."""

_ABOVE = 0.2
"""Height of a title above a box and its items, as a share of the box's longest side: it does not
hide the far corner in the default view."""

_TITLE = 1.2
"""Size of a title, as a share of other text in the scene."""

_GLASS = 0.12
"""Opacity of items that are not in focus."""


@dataclass(frozen=True)
class DisplaySettings:
    """The display options of a box on a page.

    Parameters
    ----------
    step : int | None
        The number of items that are shown, from the first on; None for all.
    explode : float
        The distance by which items are moved apart, as a share of that to the middle of the floor.
    cut : Cut | None
        The plane that cuts the box open, whose items must be on the grid.
    colors : tuple[Color, ...] | None
        The colour of each item; None for each shape's own.
    focus : frozenset[int] | None
        Numbers of the items with opacity `solid`, while others look like glass; None for all.
    solid : float
        Opacity, 0 to 1.
    layout : Layout | None
        Where the items are shown, whatever `explode` is; None in their places.
    """

    step: int | None = None
    explode: float = 0.0
    cut: Cut | None = None
    colors: tuple[Color, ...] | None = None
    focus: frozenset[int] | None = None
    solid: float = 1.0
    layout: Layout | None = None


DEFAULT_DISPLAY = DisplaySettings()


class BoxView:
    """A box and its items as nodes of a scene.

    Parameters
    ----------
    name : str
        The name of the box's node in the scene, "" for the root.
    on_click : Callable[[int], None] | None
        Called with the number of an item that is clicked.
    """

    def __init__(
        self,
        server: ViserServer,
        name: str = "",
        on_click: Callable[[int], None] | None = None,
    ) -> None:
        self._server = server
        self._name = name
        self._on_click = on_click
        self._cells: Triple | None = None
        self._cut: Cut | None = None
        self._surfaces: dict[tuple[int, ItemInBox], trimesh.Trimesh] = {}
        self._items: dict[tuple[int, ItemInBox], MeshHandle] = {}
        self._parts: dict[tuple[int, ItemInBox], tuple[MeshHandle, ...]] = {}
        self._node = server.scene.add_frame(name, show_axes=False) if name else None

    @property
    def items(self) -> tuple[MeshHandle, ...]:
        """Viser's handle of each item, in the order of placing."""
        return tuple(self._items[key] for key in sorted(self._items, key=lambda key: key[0]))

    def show(self, box: Contents[ItemInBox], display: DisplaySettings = DEFAULT_DISPLAY) -> None:
        """Show the box as it is now; nodes of items that stayed are kept."""
        with self._server.atomic():
            if box.cells != self._cells:
                self._show_walls(box.cells)
                self._cells = box.cells
            rows = list(enumerate(box.placed))
            self._forget(set(rows), display.cut)
            layout = display.layout or Layout.packed(
                box.placed, np.array(box.cells) * CELL, display.explode
            )
            colors = display.colors or by_item([placed.item for placed in box.placed]).of
            for key, pose, color in zip(rows, layout.poses, colors, strict=True):
                if pose is not None:
                    self._show_item(key, pose, color, display)
                elif key in self._items:
                    self._items[key].visible = False

    def move(self, origin: Floats) -> None:
        """Move a box that has its own node: its origin is at a position (3,)."""
        assert self._node is not None
        self._node.position = origin

    def title(self, text: str, place: Floats) -> None:
        """Write a title at a position (3,), see `over`."""
        self._server.scene.add_label(
            f"{self._name}/title",
            text,
            position=place,
            anchor="bottom-center",
            font_screen_scale=_TITLE,
        )

    def label(self, number: int | None) -> None:
        """Show the name of one item above it; None for no name."""
        name = f"{self._name}/label"
        if number is None:
            self._server.scene.remove_by_name(name)
            return
        (placed,) = (placed for n, placed in self._items if n == number)
        top = np.array((0.0, 0.0, placed.item.extents[2] / 2))
        self._server.scene.add_label(
            name,
            f"{number} {placed.item.shape.id}",
            position=self.items[number].position + top,
            anchor="bottom-center",
        )

    def remove(self) -> None:
        """Remove the box from the scene."""
        self._server.scene.remove_by_name(self._name)

    def _forget(self, rows: set[tuple[int, ItemInBox]], cut: Cut | None) -> None:
        """Remove nodes of items that left the box, and the parts of another cut."""
        for key in self._items.keys() - rows:
            self._items.pop(key).remove()
            del self._surfaces[key]
        for key in list(self._parts) if cut != self._cut else self._parts.keys() - rows:
            for part in self._parts.pop(key):
                part.remove()
        self._cut = cut

    def _show_item(
        self, key: tuple[int, ItemInBox], pose: Motion, color: Color, display: DisplaySettings
    ) -> None:
        number, placed = key
        inside = display.step is None or number < display.step
        if key not in self._items:
            self._items[key] = self._add_item(key, pose, color)
        gone = display.cut is not None and is_beyond(_on_grid(placed), display.cut)
        parts = self._cut_open(key, color) if inside and not gone else ()
        self._items[key].visible = inside and not gone and not parts
        self._items[key].wxyz = pose.wxyz
        glass = display.focus is not None and number not in display.focus
        opacity = _GLASS if glass else display.solid
        for handle in (self._items[key], *self._parts.get(key, ())):
            handle.position = pose.translation
            handle.opacity = None if opacity >= 1 else opacity
            handle.cast_shadow = not glass
        for handle in self._parts.get(key, ()):
            handle.visible = inside
        for handle, light in zip((self._items[key], *parts), (1.0, 1.0, BRIGHTNESS), strict=False):
            handle.color = rgb(color, light)

    def _cut_open(self, key: tuple[int, ItemInBox], color: Color) -> tuple[MeshHandle, ...]:
        """Create the remaining part and the section of an item that is cut, if it is."""
        if self._cut is None:
            return ()
        if key not in self._parts:
            number, placed = key
            mesh = self._surfaces[key]
            own = trimesh.Trimesh(mesh.vertices @ placed.item.linear.T, mesh.faces, process=False)
            left = section(_on_grid(placed), self._cut, own)
            parts = () if left is None else (("rest", left.rest), ("cap", left.cap))
            self._parts[key] = tuple(
                self._add(f"parts/{number}/{name}", part, color, number) for name, part in parts
            )
        return self._parts[key]

    def _add_item(self, key: tuple[int, ItemInBox], pose: Motion, color: Color) -> MeshHandle:
        number, placed = key
        mesh = self._surfaces[key] = surface(placed.item.shape)
        scale = float(np.cbrt(placed.item.scale))
        return self._add(f"items/{number}", mesh, color, number, pose, scale)

    def _add(
        self,
        name: str,
        mesh: trimesh.Trimesh,
        color: Color,
        number: int,
        pose: Motion = IDENTITY,
        scale: float = 1.0,
    ) -> MeshHandle:
        handle = self._server.scene.add_mesh_simple(
            f"{self._name}/{name}",
            np.asarray(mesh.vertices),
            np.asarray(mesh.faces),
            color=rgb(color),
            side="double",
            receive_shadow=False,
            scale=scale,
            wxyz=pose.wxyz,
            position=pose.translation,
        )
        if self._on_click is not None:
            clicked = self._on_click
            handle.on_click(lambda event: clicked(number))
        return handle

    def _show_walls(self, cells: Triple) -> None:
        """Draw the box's edges and its floor."""
        size = np.array(cells) * CELL
        thickness = _EDGE * float(size.max())
        corners = np.indices((2, 2, 2)).reshape(3, 8).T
        edges = [(a, b) for a in corners for b in corners if (b - a).sum() == 1 and (a <= b).all()]
        self._server.scene.add_line_segments(
            f"{self._name}/box/edges", np.array(edges) * size, EDGE_COLOR, thickness=thickness
        )
        self._server.scene.add_box(
            f"{self._name}/box/floor",
            _FLOOR_COLOR,
            (size[0], size[1], thickness),
            cast_shadow=False,
            position=(size[0] / 2, size[1] / 2, -thickness),
        )


def _on_grid(placed: ItemInBox) -> PlacedItem:
    assert isinstance(placed, PlacedItem), "a box is cut open whose items are on the grid"
    return placed


def corners(cells: Triple) -> Floats:
    """Compute the corners (8, 3) of a box with these cells, in box units."""
    return np.indices((2, 2, 2)).reshape(3, 8).T * np.array(cells) * CELL


def reach(box: Contents[ItemInBox], explode: float = 0.0) -> Floats:
    """Compute the corners (n, 3) of a box and its items, which may be moved apart, in box units."""
    layout = Layout.packed(box.placed, np.array(box.cells) * CELL, explode)
    return np.concatenate((corners(box.cells), layout.points))


def over(cells: Triple, points: Floats) -> Floats:
    """Compute the position (3,) of a box's title above points (n, 3)."""
    x, y, z = np.array(cells) * CELL
    return np.array((x / 2, y / 2, points[:, 2].max() + _ABOVE * max(x, y, z)))


def rgb(color: Color, light: float = 1.0) -> tuple[int, int, int]:
    """Return a colour of 0 to 255, with a share of its brightness."""
    red, green, blue = (round(255 * light * channel) for channel in color)
    return red, green, blue
