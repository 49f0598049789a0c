"""Packed boxes on HTML pages: poses, each shape once, and the files that draw them.

Shapes are simplified and quantized.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from packit_sim.core.assets import assets_folder
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import ItemInBox
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import reduced, triangle_limit
from packit_sim.render.coloring import COLORINGS, ByShare, Color, Coloring, hexadecimal
from packit_sim.render.export import names
from packit_sim.web.surfaces import MAX_TRIANGLES

ALL_TRIANGLES = 2**18
"""Maximum number of triangles of all shapes of a page: 5 MB."""

VERTEX_TYPE = np.dtype("<u2")
"""The type of coordinates on the lattice of a shape's bounding box."""

FACE_TYPE = np.dtype("<u4")
"""The type of vertex indices: a shape that cannot be simplified may have more than 65,536."""


def page_files() -> dict[str, Path]:
    """Return the files that every page with boxes needs, by their names in templates.

    Returns
    -------
    dict of str to Path
        "style", CSS; "three", three.js, with its "licence"; "scene", which draws a box of `Models`
        by it; and "viewer", which shows the boxes of a finished page.

    Raises
    ------
    LibraryError
        If the installation is incomplete.
    """
    here, three = Path(__file__).parent, assets_folder() / "three"
    return {
        "style": here / "pages.css",
        "three": three / "three.min.js",
        "licence": three / "LICENSE",
        "scene": here / "box_scene.js",
        "viewer": here / "viewer.js",
    }


def page_texts() -> dict[str, str]:
    """Return the content of `page_files`, for a page that is one file."""
    return {name: file.read_text(encoding="utf-8") for name, file in page_files().items()}


class Models:
    """The boxes that a page shows, added one by one."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._shapes: list[Shape] = []
        self._boxes: list[dict[str, Any]] = []

    def add(
        self,
        cells: Triple,
        placed: Sequence[ItemInBox],
        total: float,
        own_colors: Sequence[Color] | None = None,
        outline: Floats | None = None,
    ) -> int:
        """Add a box.

        Parameters
        ----------
        cells : Triple
            Cells along each axis.
        placed : Sequence[ItemInBox]
            Its items, in the order of placing.
        total : float
            Volume of all items of its task, in box units cubed.
        own_colors : sequence of Color, optional
            The colour "by item" of each item; by default that of its shape.
        outline : ndarray of float64, shape (n, 2, 3), optional
            The lines to draw instead of the box's edges and its floor.

        Returns
        -------
        int
            The number of the box.
        """
        items = [one.item for one in placed]
        rules: dict[str, Coloring] = {**COLORINGS, "share": ByShare(total)}
        chosen = {name: rule(items).of for name, rule in rules.items()}
        if own_colors is not None:
            chosen["item"] = tuple(own_colors)
        colors = {name: ["#" + hexadecimal(c) for c in own] for name, own in chosen.items()}
        self._boxes.append(
            {
                "size": [round(n * CELL, 6) for n in cells],
                "outline": [] if outline is None else np.round(outline, 4).ravel().tolist(),
                "items": [
                    {
                        "shape": self._number(one.item.shape),
                        "name": name,
                        "pose": np.round(one.matrix[:3], 6).ravel().tolist(),
                        "share": round(one.item.volume / total, 6),
                        "colors": {rule: found[n] for rule, found in colors.items()},
                    }
                    for n, (name, one) in enumerate(zip(names(placed), placed, strict=True))
                ],
            }
        )
        return len(self._boxes) - 1

    def to_json(self) -> dict[str, Any]:
        """Return the shapes and boxes in JSON's types, as `box_scene.js` reads them.

        Returns
        -------
        dict[str, Any]
            "shapes" and "boxes". A shape: extents (3,) of its bounding box, which is centred;
            vertices, base64 of (n, 3) uint16 on the lattice of that box; faces, base64 of (m, 3)
            uint32. A box: size (3,) in box units; items, each with the number of its shape, a name,
            a (3, 4) shape-to-box matrix by rows, its share of the reward, and a colour by each
            rule; outline, six coordinates of each line that replaces its edges.
        """
        counts = [min(len(each.mesh.faces), MAX_TRIANGLES) for each in self._shapes]
        limit = triangle_limit(counts, ALL_TRIANGLES)
        return {"shapes": [_compact(each, limit) for each in self._shapes], "boxes": self._boxes}

    def _number(self, shape: Shape) -> int:
        if shape.digest not in self._numbers:
            self._numbers[shape.digest] = len(self._shapes)
            self._shapes.append(shape)
        return self._numbers[shape.digest]


@lru_cache(maxsize=512)
def _compact(shape: Shape, triangles: int) -> dict[str, Any]:
    mesh = QuantizedMesh.of(reduced(shape, triangles))
    return {
        "extents": np.round(mesh.extents, 6).tolist(),
        "vertices": b64encode(mesh.vertices.astype(VERTEX_TYPE).tobytes()).decode(),
        "faces": b64encode(mesh.faces.astype(FACE_TYPE).tobytes()).decode(),
    }
