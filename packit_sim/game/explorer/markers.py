"""The wanted item in the scene, and dots at its feasible locations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from packit_sim.game.explorer.query import FitQuery
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.render.coloring import PALETTE, Color
from packit_sim.web.box_view import rgb
from packit_sim.web.surfaces import surface

if TYPE_CHECKING:
    from packit_sim.web.web_page import MeshHandle, ViserServer

_FITS, _BLOCKED = PALETTE[0], PALETTE[5]
"""Blue and vermilion, which colour-blind readers can distinguish."""

_ELSEWHERE = (0.62, 0.78, 0.88)
"""The colour of dots above and below the item, a pale blue that does not hide it."""

_POINT, _SMALL = 0.007, 0.003
"""Sizes of dots, in box units: at the item's height, and elsewhere."""


class FitMarkers:
    """One item in a scene, blue where it fits and else vermilion, and dots where it fits.

    Dots at the item's own height are larger.

    Parameters
    ----------
    name : str
        The name of the node in the scene.
    """

    def __init__(self, server: ViserServer, name: str) -> None:
        self._server = server
        self._name = name
        self._query: FitQuery | None = None
        self._item: MeshHandle | None = None

    def show(self, query: FitQuery, location: Triple) -> None:
        """Show the item of the query at a location."""
        placed = PlacedItem(query.item, location)
        color = _BLOCKED if query.blockers(location) else _FITS
        if query is not self._query or self._item is None:
            self.remove()
            self._query = query
            self._item = self._add(placed)
        level = np.isclose(query.centers[:, 2], placed.center[2])
        self._add_dots("level", query.centers[level], _FITS, _POINT)
        self._item.position = placed.center
        self._item.color = rgb(color)

    def remove(self) -> None:
        """Remove the item and the dots from the scene."""
        if self._query is not None:
            self._server.scene.remove_by_name(self._name)
        self._query = self._item = None

    def _add(self, placed: PlacedItem) -> MeshHandle:
        assert self._query is not None
        self._server.scene.add_frame(self._name, show_axes=False)
        self._add_dots("dots", self._query.centers, _ELSEWHERE, _SMALL)
        mesh = surface(placed.item.shape)
        return self._server.scene.add_mesh_simple(
            f"{self._name}/item",
            np.asarray(mesh.vertices),
            np.asarray(mesh.faces),
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            scale=float(np.cbrt(placed.item.scale)),
            wxyz=placed.pose.wxyz,
        )

    def _add_dots(
        self, name: str, points: npt.NDArray[np.float64], color: Color, size: float
    ) -> None:
        self._server.scene.add_point_cloud(
            f"{self._name}/{name}",
            points,
            rgb(color),
            point_size=size,
            point_shape="circle",
            precision="float32",
        )
