"""OBJ text in which trimesh reads every face: no comments, no negative numbers, no folded fans."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import MeshError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.polygons import cut_into_triangles, folded

MAX_CORNERS = 500
"""Maximum number of corners of a polygon that is cut: the time may grow with their cube."""

_COMMENT = re.compile(rb"^([ \t]*f[ \t][^#\n]*)#.*$", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]+(.*)$", re.MULTILINE)
_LINE = re.compile(rb"^[ \t]*([vf])[ \t]+(.*)$", re.MULTILINE)
_NOT_POSITIVE = re.compile(rb"^[ \t]*f[ \t](?:[^\n]*[ \t])?(?:-|0[/\s])", re.MULTILINE)
_POLYGON = re.compile(rb"^[ \t]*f(?:[ \t]+\S+){4}", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)


def simple_faces(content: bytes) -> bytes:
    """Drop comments behind faces, count corners from the first vertex, and cut some polygons.

    trimesh takes the words of a comment for corners, and counts negative numbers back from the
    file's last vertex instead of the last one before the face. It reads every polygon as a fan of
    triangles, which reaches beyond the outline of many polygons that are not convex.

    Parameters
    ----------
    content : bytes
        The text of an OBJ file.

    Returns
    -------
    bytes
        The text of the same surface. Polygons stay as they are if the vertices or faces can't be
        read, and those of more than `MAX_CORNERS`.

    Raises
    ------
    MeshError
        If a face has a vertex that is none of those before it.
    """
    content = _COMMENT.sub(rb"\1", content)
    if _NOT_POSITIVE.search(content):
        content = _counted_from_the_first(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" "))
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


def _counted_from_the_first(content: bytes) -> bytes:
    """Replace the corners of all faces by the numbers of their vertices, from 1 on."""
    seen = 0

    def line(match: re.Match[bytes]) -> bytes:
        nonlocal seen
        if match[1] == b"v":
            seen += 1
            return match[0]
        corners = [int(corner.partition(b"/")[0]) for corner in match[2].split()]
        for corner in corners:
            if corner == 0 or corner < -seen:
                raise MeshError(f"a face has vertex {corner}, after {seen} vertices")
        return b"f " + b" ".join(b"%d" % (n if n > 0 else seen + 1 + n) for n in corners)

    return _LINE.sub(line, content)


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
        points = vertices[indices - 1]
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
