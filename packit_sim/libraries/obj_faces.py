"""OBJ text in which trimesh reads every face: no comments behind faces, no folded fans."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.polygons import cut_into_triangles, folded

MAX_CORNERS = 500
"""Maximum number of corners of a polygon that is cut: the time may grow with their cube."""

_COMMENT = re.compile(rb"^([ \t]*f[ \t][^#\n]*)#.*$", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]+(.*)$", re.MULTILINE)
_POLYGON = re.compile(rb"^[ \t]*f(?:[ \t]+\S+){4}", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)


def simple_faces(content: bytes) -> bytes:
    """Drop comments behind faces, and cut polygons that a fan of triangles does not fill.

    trimesh takes the words of a comment for corners, and reads every polygon as a fan, which
    reaches beyond the outline of many polygons that are not convex.

    Parameters
    ----------
    content : bytes
        The text of an OBJ file.

    Returns
    -------
    bytes
        The text of the same surface. Polygons stay as they are if the vertices or faces can't be
        read, and those of more than `MAX_CORNERS`.
    """
    content = _COMMENT.sub(rb"\1", content)
    if not _POLYGON.search(content):
        return content
    text = content.replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    faces = [corners.split() for corners in _FACE.findall(text)]
    try:
        found = _VERTEX.findall(text)
        vertices = _numbers(chain.from_iterable(found), 3 * len(found), float).reshape(-1, 3)
        cut = _cut(vertices, faces)
    except (ValueError, IndexError):
        return content
    if not cut:
        return content
    numbers = iter(range(len(faces)))

    def lines(match: re.Match[bytes]) -> bytes:
        return cut.get(next(numbers), match[0])

    return _FACE.sub(lines, text)


def _cut(vertices: Floats, faces: list[list[bytes]]) -> dict[int, bytes]:
    """Return the new lines of each polygon that is cut, by its number among the faces."""
    by_length = defaultdict(list)
    for number, corners in enumerate(faces):
        if 3 < len(corners) <= MAX_CORNERS:
            by_length[len(corners)].append(number)
    cut = {}
    for length, numbers in by_length.items():
        tokens = (corner.partition(b"/")[0] for number in numbers for corner in faces[number])
        indices = _numbers(tokens, len(numbers) * length, np.int64).reshape(-1, length)
        points = vertices[np.where(indices > 0, indices - 1, indices)]
        for n in np.flatnonzero(folded(points)).tolist():
            names = faces[numbers[n]]
            cut[numbers[n]] = b"\n".join(
                b"f " + b" ".join(names[corner] for corner in triangle)
                for triangle in cut_into_triangles(points[n]).tolist()
            )
    return cut


def _numbers(tokens: Iterable[bytes], count: int, kind: type) -> npt.NDArray[Any]:
    """Read numbers; raise ValueError if a word is not one."""
    text = b" ".join(tokens).decode("ascii", "replace")
    found: npt.NDArray[Any] = np.fromstring(text, sep=" ", dtype=kind)
    if len(found) != count:
        raise ValueError("not all are numbers")
    return found
